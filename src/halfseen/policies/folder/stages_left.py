"""How many stages there are still to come: over so many the errors of Q add up."""

from typing import NamedTuple

import numpy as np

from halfseen.logs import Logs
from halfseen.shapes import Int


class StageCounts(NamedTuple):
    """How many trajectories began and completed each stage; those of parts of a log add up."""

    begun: Int[np.ndarray, " T"]
    done: Int[np.ndarray, " T"]

    def plus(self, other: "StageCounts") -> "StageCounts":
        """Join what another part has counted."""
        horizon = max(len(self.begun), len(other.begun))
        begun, done = (
            np.pad(one, (0, horizon - len(one))) + np.pad(more, (0, horizon - len(more)))
            for one, more in zip(self, other, strict=True)
        )
        return StageCounts(begun, done)


def stage_counts(logs: Logs) -> StageCounts:
    """Count the stages of a log."""
    stage = logs.stages["stage"].to_numpy(dtype=np.int64)
    is_done = logs.stages["elapsed_s"].notna().to_numpy(dtype=bool)
    return StageCounts(*(np.bincount(one, minlength=logs.horizon + 1)[1:] for one in (stage, stage[is_done])))


def stages_left(counts: StageCounts) -> list[float]:
    """Mean number of stages from each to the end, by Kaplan and Meier: what a cut took away is made up for.

    Of the trajectories that completed a stage, some went on to the next; a cut within a stage tells nothing of that.

    Parameters
    ----------
    counts
        Of the whole log.

    Examples
    --------
    Of three trajectories one was cut in stage 1; of the two others one went on.

    >>> stages = {"trajectory": [0, 1, 1, 2], "stage": [1, 1, 2, 1], "elapsed_s": [1.0, 1.0, 2.0, None]}
    >>> stages["action"] = ["A"] * 4
    >>> trajectories = {"trajectory": [0, 1, 2], "end_s": [1.0, 2.0, 0.5], "ending": ["finished", "finished", "cut"]}
    >>> stages_left(stage_counts(Logs(stages | {"reward": [1.0, 1.0, 1.0, None]}, trajectories)))
    [1.5, 1.0]
    """
    left = np.ones(len(counts.begun))
    for k in range(len(left) - 2, -1, -1):
        left[k] += left[k + 1] * counts.begun[k + 1] / max(int(counts.done[k]), 1)
    return left.tolist()
