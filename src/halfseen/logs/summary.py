"""What a log holds, in numbers and in one sentence."""

from dataclasses import dataclass
from typing import Any

import pandas as pd

from halfseen.logs.columns import FINISHED


@dataclass(frozen=True)
class LogsSummary:
    """Counts of a log.

    Parameters
    ----------
    num_paths, num_finished, num_cut
        Paths, and how they ended.
    cut_share
        Proportion of the paths that were cut, in [0, 1].
    causes
        Number of paths for each cause of a cut, the most frequent first.
    num_stages, num_completed
        Stages of all paths, and those that were completed.
    horizon
        Stages of the longest path.
    shortest_s, longest_s
        The earliest and the latest observed end of a path [s].
    actions
        Number of completed stages for each action, the most frequent first.
    num_objects
        Number of different objects' names; 0 where the stages have none.
    """

    num_paths: int
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
        paths = "path" if self.num_paths == 1 else "paths"
        stages = "1 stage" if self.horizon == 1 else f"{self.horizon} stages"
        return (
            f"{self.num_paths} {paths} of up to {stages} and {self.longest_s:.4g} s: {self.num_finished} "
            f"finished, {self.num_cut} cut ({self.cut_share:.0%})."
        )


def summarise(paths: pd.DataFrame, stages: pd.DataFrame, objects: pd.DataFrame | None) -> LogsSummary:
    """Count checked tables."""
    num_finished = int((paths["ending"] == FINISHED).sum())
    completed = stages[stages["elapsed_s"].notna()]
    return LogsSummary(
        num_paths=len(paths),
        num_finished=num_finished,
        num_cut=len(paths) - num_finished,
        cut_share=1.0 - num_finished / len(paths),
        causes=_counts(paths["cause"]),
        num_stages=len(stages),
        num_completed=len(completed),
        horizon=int(stages["stage"].max()),
        shortest_s=float(paths["end_s"].min()),
        longest_s=float(paths["end_s"].max()),
        actions=_counts(completed["action"]),
        num_objects=0 if objects is None else int(objects["object"].nunique()),
    )


def _counts(values: Any) -> dict[str, int]:
    """Count each value; equal counts stand in the order of the names, so that the same log reads the same."""
    counts = [(str(value), int(count)) for value, count in values.value_counts(sort=False).items() if count]
    return dict(sorted(counts, key=lambda item: (-item[1], item[0])))
