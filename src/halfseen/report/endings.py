"""How trajectories ended: finished, or cut by a cause; rare causes are one kind."""

import numpy as np

from halfseen.arrays import RowMask
from halfseen.logs import Logs
from halfseen.logs.breakdown import by_cause

MOST_CAUSES = 5
FINISHED_ROW = "finished"


def endings(logs: Logs) -> dict[str, RowMask]:
    """Which trajectories ended in each way: finished if any did, then by causes, the most frequent first."""
    causes = [row["cause"] for row in by_cause(logs)]
    told = causes if len(causes) <= MOST_CAUSES else causes[: MOST_CAUSES - 1]
    cause = logs.trajectories["cause"].astype(str).to_numpy()
    ways = {FINISHED_ROW: logs.is_finished} if logs.is_finished.any() else {}
    for name in told:
        ways[f"cut: {name}"] = ~logs.is_finished & (cause == name)
    if len(told) < len(causes):
        ways[f"cut: {len(causes) - len(told)} other causes"] = ~logs.is_finished & ~np.isin(cause, told)
    return ways
