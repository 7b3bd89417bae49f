"""How many stages there are still to come: over so many the errors of Q add up."""

import numpy as np

from halfseen.logs import Logs


def stages_left(logs: Logs) -> list[float]:
    """Mean number of stages from each to the end of a path, by Kaplan and Meier: what a cut took away is made up for.

    Of the paths that completed a stage, some went on to the next; a cut within a stage tells nothing of that.

    Parameters
    ----------
    logs
        The log.

    Examples
    --------
    Of three paths one was cut in stage 1; of the two others one went on.

    >>> stages = {"path": [0, 1, 1, 2], "stage": [1, 1, 2, 1], "elapsed_s": [1.0, 1.0, 2.0, None], "action": ["A"] * 4}
    >>> paths = {"path": [0, 1, 2], "end_s": [1.0, 2.0, 0.5], "ending": ["finished", "finished", "cut"]}
    >>> stages_left(Logs(stages | {"reward": [1.0, 1.0, 1.0, None]}, paths))
    [1.5, 1.0]
    """
    stage = logs.stages["stage"].to_numpy(dtype=np.int64)
    is_done = logs.stages["elapsed_s"].notna().to_numpy(dtype=bool)
    begun, done = (np.bincount(one, minlength=logs.horizon + 2)[1:] for one in (stage, stage[is_done]))
    left = np.ones(logs.horizon)
    for k in range(logs.horizon - 2, -1, -1):
        left[k] += left[k + 1] * begun[k + 1] / max(int(done[k]), 1)
    return left.tolist()
