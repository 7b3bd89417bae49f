"""Endings that do not look like ends: called finished, they stop in mid-task, as a cut would stop them.

Where a task ends, something tells: the action that ends it, what it paid, or the number of stages. Stages of one action
that paid the same, with trajectories going on after them and trajectories ending, differ in nothing that is known; and
where no stage pays 0 but some that end trajectories do, that 0 may stand for what nobody saw. If those that end are
clearly shorter, too, somebody or something stopped them.
"""

from collections.abc import Iterator
from statistics import NormalDist
from typing import Any

import numpy as np

from halfseen.logs.logs import Logs
from halfseen.shapes import Float

FEWEST = 10
LEVEL = 1e-4


def cuts_called_finished(logs: Logs) -> Iterator[str]:
    """Tell of finished trajectories that look as if they had been cut."""
    stages: Any = logs.stages
    lasted_s = stages["elapsed_s"] - stages.groupby("trajectory")["elapsed_s"].shift(fill_value=0.0)
    is_last = ~stages.duplicated("trajectory", keep="last")
    finished = set(logs.trajectories["trajectory"][logs.is_finished])
    is_end = is_last & stages["trajectory"].isin(finished) & (stages["stage"] < logs.horizon)
    reward = stages["reward"].astype(float)
    for name, rows in stages.groupby(stages["action"].astype(str)).groups.items():
        of_action = reward.loc[rows].dropna()
        ends, goes_on = of_action[is_end.loc[of_action.index]], of_action[~is_last.loc[of_action.index]]
        for paid in {0.0, *goes_on.mode().iloc[:1]}:
            alike = ends.index[ends == paid]
            others, words = goes_on.index[goes_on == paid], "went on after one that paid the same"
            if len(others) < FEWEST:
                others, words = of_action.index[of_action != paid], "of the same action paid otherwise"
            if min(len(alike), len(others)) < FEWEST:
                continue
            if chance_of_shorter(lasted_s[alike].to_numpy(), lasted_s[others].to_numpy()) < LEVEL:
                ended_s, other_s = (float(np.median(lasted_s[each])) for each in (alike, others))
                yield (
                    f"{len(alike)} trajectories are called finished after a {name} that paid {paid:g} and lasted "
                    f"{ended_s:.2g} s, yet {len(others)} {words} and lasted {other_s:.2g} s: if something stopped "
                    "them, their ending is 'cut', and that stage has neither reward nor elapsed_s"
                )
                break


def chance_of_shorter(one: Float[np.ndarray, " n"], other: Float[np.ndarray, " m"]) -> float:
    """Chance that one sample is as much smaller than another if both are alike, by ranks [MannWhitney1947]_.

    By the normal approximation with ties and a correction for continuity, for ten of each or more.
    """
    _, place, ties = np.unique(np.concatenate([one, other]), return_inverse=True, return_counts=True)
    ranks = (ties.cumsum() - (ties - 1) / 2.0)[place]
    n, m = len(one), len(other)
    above = ranks[:n].sum() - n * (n + 1) / 2.0
    spread = np.sqrt(n * m / 12.0 * (n + m + 1.0 - float((ties**3 - ties).sum()) / ((n + m) * (n + m - 1.0))))
    return NormalDist().cdf((above - n * m / 2.0 + 0.5) / spread) if spread > 0.0 else 1.0
