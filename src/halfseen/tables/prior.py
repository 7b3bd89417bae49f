"""P(DIRTY) of an object before any label, as a log tells it."""

import numpy as np
from scipy.special import expit

from halfseen.errors import LogError
from halfseen.logs import Logs
from halfseen.logs.columns import as_floats, require_columns

COLUMN = "dirty_share"


def logged_dirty_share(logs: Logs) -> float:
    """Read the prior that the log-odds of a log started from.

    Where the paths have a column ``dirty_share``, it is that. Else it is the mean of P(DIRTY) over the objects of all
    first stages: given right labels, E[P(DIRTY | label)] is the prior.

    Raises
    ------
    LogError
        The log has no objects, or its paths had different priors.
    """
    if COLUMN in logs.paths.columns and not logs.paths[COLUMN].isna().to_numpy().any():
        values = logs.paths[COLUMN].to_numpy(dtype=np.float64)
        if np.ptp(values) > 0 or not 0.0 < values[0] < 1.0:
            raise LogError(
                f"paths: {COLUMN} goes from {values.min():g} to {values.max():g}; one policy has one prior between 0 "
                "and 1: select the paths that share it"
            )
        return float(values[0])
    if logs.objects is None:
        raise LogError("objects: the log has none; a table is learned from logs with an objects table")
    require_columns("objects", logs.objects, ("stage", "log_odds"))
    log_odds = as_floats("objects", logs.objects, "log_odds").to_numpy()
    return float(expit(log_odds[logs.objects["stage"].to_numpy() == 1]).mean())
