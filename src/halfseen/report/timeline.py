"""Trajectories along time: what was done when, and how each ended; of many, rows that stand for all."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from halfseen.logs import Logs
from halfseen.report.endings import endings
from halfseen.shapes import Bool, Float, Int

MOST_ROWS = 160
"""Trajectories that are drawn at most."""
UNKNOWN_ACTION = "not recorded"


@dataclass(frozen=True)
class TimelineEnding:
    """The trajectories that ended in one way.

    Parameters
    ----------
    name
        Of the way.
    num_trajectories, num_rows
        So many trajectories did, and so many of these are drawn.
    """

    name: str
    num_trajectories: int
    num_rows: int


@dataclass(frozen=True, eq=False)
class Timeline:
    """Rows of trajectories by how they ended, and then by length; the k-th row at height k."""

    num_trajectories: int
    endings: tuple[TimelineEnding, ...]
    end_s: Float[np.ndarray, " r"]
    """Of the trajectory of each row [s]."""
    row: Int[np.ndarray, " m"]
    """Of each stage that is drawn."""
    begin_s: Float[np.ndarray, " m"]
    until_s: Float[np.ndarray, " m"]
    """When it was completed or cut [s]."""
    action: np.ndarray
    """Its name."""
    is_completed: Bool[np.ndarray, " m"]

    @property
    def num_rows(self) -> int:
        """Trajectories that are drawn."""
        return len(self.end_s)


def timeline(logs: Logs) -> Timeline:
    """Lay out the trajectories of a log; where they are many, evenly spaced ones of each way to end."""
    groups, picked = [], []
    for name, is_own in endings(logs).items():
        trajectories = np.flatnonzero(is_own)
        trajectories = trajectories[np.argsort(logs.end_s[trajectories], kind="stable")]
        kept = _evenly(trajectories, _num_rows(len(trajectories), logs.num_trajectories))
        groups.append(TimelineEnding(name, len(trajectories), len(kept)))
        picked.append(kept)
    rows = np.concatenate(picked)
    stages = _stages_of(logs, rows)
    return Timeline(
        num_trajectories=logs.num_trajectories,
        endings=tuple(groups),
        end_s=logs.end_s[rows],
        row=stages["row"].to_numpy(dtype=np.int64),
        begin_s=stages["begin_s"].to_numpy(dtype=np.float64),
        until_s=stages["until_s"].to_numpy(dtype=np.float64),
        action=stages["action"].to_numpy(dtype=object),
        is_completed=stages["is_completed"].to_numpy(dtype=bool),
    )


def _num_rows(num_own: int, num_all: int) -> int:
    """Rows in proportion to the trajectories, at least one."""
    return num_own if num_all <= MOST_ROWS else max(1, round(MOST_ROWS * num_own / num_all))


def _evenly(trajectories: Int[np.ndarray, " k"], num: int) -> Int[np.ndarray, " r"]:
    """So many of them, from the first to the last; of one, the middle."""
    at = np.linspace(0, len(trajectories) - 1, num) if num > 1 else np.array([(len(trajectories) - 1) / 2])
    return trajectories[np.round(at).astype(np.int64)]


def _stages_of(logs: Logs, trajectories: Int[np.ndarray, " r"]) -> Any:
    """Stages of these trajectories, with the row of each, and when it began and ended [s]."""
    row = pd.Series(np.arange(len(trajectories)), index=logs.trajectory_ids[trajectories])
    is_drawn = logs.stages["trajectory"].isin(list(row.index))
    stages: Any = logs.stages[is_drawn]
    own = stages["trajectory"].map(row).to_numpy()
    end_s, is_completed = logs.end_s[trajectories][own], stages["elapsed_s"].notna().to_numpy()
    before_s = stages.groupby("trajectory")["elapsed_s"].shift(fill_value=0.0).to_numpy(dtype=np.float64)
    until_s = np.where(is_completed, stages["elapsed_s"].to_numpy(dtype=np.float64, na_value=np.nan), end_s)
    action = stages["action"].map(str, na_action="ignore").fillna(UNKNOWN_ACTION)
    columns = {"row": own, "begin_s": before_s, "until_s": until_s, "action": action, "is_completed": is_completed}
    return pd.DataFrame(columns).reset_index(drop=True)
