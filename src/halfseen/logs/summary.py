"""What a log holds, in numbers: as a whole, and by cause, action, robot and stage."""

import math
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import pandas as pd

from halfseen.logs.columns import FINISHED, ROBOT

if TYPE_CHECKING:
    from halfseen.logs.logs import Logs


@dataclass(frozen=True)
class LogsSummary:
    """Counts of a log.

    Parameters
    ----------
    num_trajectories, num_finished, num_cut
        Trajectories, and how they ended.
    cut_share
        Proportion of the trajectories that were cut, in [0, 1].
    causes
        Number of trajectories for each cause of a cut, the most frequent first.
    num_stages, num_completed
        Stages of all trajectories, and those that were completed.
    horizon
        Stages of the longest trajectory.
    shortest_s, longest_s
        The earliest and the latest observed end of a trajectory [s].
    actions
        Number of completed stages for each action, the most frequent first.
    num_objects
        Number of different objects' names; 0 where the stages have none.
    """

    num_trajectories: int
    num_finished: int
    num_cut: int
    cut_share: float
    causes: dict[str, int]
    num_stages: int
    num_completed: int
    horizon: int
    shortest_s: float
    longest_s: float
    actions: dict[str, int]
    num_objects: int

    def __str__(self) -> str:
        trajectories = "trajectory" if self.num_trajectories == 1 else "trajectories"
        stages = "1 stage" if self.horizon == 1 else f"{self.horizon} stages"
        return (
            f"{self.num_trajectories} {trajectories} of up to {stages} and {self.longest_s:.4g} s: {self.num_finished} "
            f"finished, {self.num_cut} cut ({self.cut_share:.0%})."
        )


class SummaryTally:
    """Counts a log that comes in parts."""

    def __init__(self) -> None:
        self._count: Counter[str] = Counter()
        self._horizon, self._shortest_s, self._longest_s = 0, math.inf, -math.inf
        self._causes: Counter[str] = Counter()
        self._actions: Counter[str] = Counter()
        self._objects: set[Any] = set()

    def add(self, trajectories: pd.DataFrame, stages: pd.DataFrame, objects: pd.DataFrame | None) -> None:
        """Count the checked tables of a part."""
        actions = stages["action"][stages["elapsed_s"].notna()]
        self._count["num_trajectories"] += len(trajectories)
        self._count["num_finished"] += int((trajectories["ending"] == FINISHED).sum())
        self._count["num_stages"] += len(stages)
        self._count["num_completed"] += len(actions)
        self._horizon = max(self._horizon, int(stages["stage"].max()))
        self._shortest_s = min(self._shortest_s, float(trajectories["end_s"].min()))
        self._longest_s = max(self._longest_s, float(trajectories["end_s"].max()))
        self._causes += _counts(trajectories["cause"])
        self._actions += _counts(actions)
        if objects is not None:
            self._objects.update(objects["object"].unique())

    def summary(self) -> LogsSummary:
        """What was counted."""
        num_cut = self._count["num_trajectories"] - self._count["num_finished"]
        return LogsSummary(
            **self._count,
            num_cut=num_cut,
            cut_share=1.0 - self._count["num_finished"] / self._count["num_trajectories"],
            causes=_ranked(self._causes),
            horizon=self._horizon,
            shortest_s=self._shortest_s,
            longest_s=self._longest_s,
            actions=_ranked(self._actions),
            num_objects=len(self._objects),
        )


def _counts(values: Any) -> Counter[str]:
    return Counter({str(value): int(count) for value, count in values.value_counts(sort=False).items() if count})


def _ranked(counts: Counter[str]) -> dict[str, int]:
    """Put the most frequent first; equal counts stand in the order of the names, so the same log reads the same."""
    return dict(sorted(counts.items(), key=lambda item: (-item[1], item[0])))


def by_cause(logs: "Logs") -> list[dict[str, Any]]:
    """Describe each cause of a cut, the most frequent first: its trajectories, when they were cut, in which stages.

    Returns
    -------
    list of dict
        cause, num_trajectories, share (proportion of the cuts), earliest, median and latest end [s], first and last
        stage.
    """
    last_stage: Any = logs.stages.groupby("trajectory")["stage"].max()
    cut: Any = logs.trajectories[~logs.is_finished]
    cut = cut.assign(stage=last_stage.reindex(cut["trajectory"]).to_numpy())
    table = cut.groupby("cause").agg(
        num_trajectories=("end_s", "size"),
        earliest_s=("end_s", "min"),
        median_s=("end_s", "median"),
        latest_s=("end_s", "max"),
        first_stage=("stage", "min"),
        last_stage=("stage", "max"),
    )
    return _ranked_rows(table)


def by_action(logs: "Logs") -> list[dict[str, Any]]:
    """Describe each action that was completed, the most frequent first: its stages, durations and rewards.

    Returns
    -------
    list of dict
        action, num_stages, share (a proportion of the completed stages), the median duration [s], the mean reward, and
        the mean and the smallest probability with which it was taken, None where that was not logged.
    """
    stages: Any = logs.stages.assign(duration_s=logs.durations_s())[logs.stages["elapsed_s"].notna()]
    table = stages.groupby("action", observed=True).agg(
        num_stages=("reward", "size"), median_s=("duration_s", "median"), mean_reward=("reward", "mean")
    )
    chance: Any = stages.groupby("action", observed=True)["probability"] if "probability" in stages.columns else None
    table["mean_probability"] = None if chance is None else chance.mean()
    table["smallest_probability"] = None if chance is None else chance.min()
    return _ranked_rows(table)


def _ranked_rows(table: Any) -> list[dict[str, Any]]:
    """Rows with their share, the most frequent first; equal ones stand in the order of the names."""
    count = table.columns[0]
    table.insert(1, "share", table[count] / table[count].sum())
    rows = table.set_axis(table.index.map(str)).reset_index().to_dict("records")
    return sorted(rows, key=lambda row: (-row[count], row[table.index.name]))


def by_robot(logs: "Logs") -> list[dict[str, Any]]:
    """Count the decisions of each robot of a log of several, in the order of their names.

    Returns
    -------
    list of dict
        robot, num_decisions, share (a proportion of the stages); none where stages do not say which robot decided.
    """
    made = logs.stages[ROBOT].value_counts().sort_index() if ROBOT in logs.stages.columns else pd.Series(dtype=int)
    return [
        {"robot": str(robot), "num_decisions": int(number), "share": int(number) / len(logs.stages)}
        for robot, number in made.items()
    ]


def by_stage(logs: "Logs") -> list[dict[str, Any]]:
    """Describe each stage: how many trajectories began and completed it, were cut in it, and how long it took.

    Returns
    -------
    list of dict
        stage, num_begun, num_completed, num_cut, and quantiles (5 %, 50 %, 95 %) of its duration [s], None where no
        trajectory completed it.
    """
    table: list[dict[str, Any]] = []
    stage: Any
    for stage, duration_s in pd.Series(logs.durations_s()).groupby(logs.stages["stage"].to_numpy()):
        took_s: Any = duration_s.dropna()
        low, middle, high = took_s.quantile([0.05, 0.5, 0.95]).tolist() if len(took_s) else (None, None, None)
        counts = {"num_begun": len(duration_s), "num_completed": len(took_s), "num_cut": len(duration_s) - len(took_s)}
        table.append({"stage": int(stage), **counts, "duration_5_s": low, "median_s": middle, "duration_95_s": high})
    return table
