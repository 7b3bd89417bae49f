"""What a log holds, in numbers."""

import math
from collections import Counter
from dataclasses import dataclass
from typing import Any

import pandas as pd

from halfseen.logs.columns import FINISHED


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
