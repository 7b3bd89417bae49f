"""P(DIRTY) of an object before any label, as a log tells it."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from halfseen.arrays import expit
from halfseen.errors import LogError

if TYPE_CHECKING:
    from halfseen.logs import Logs
else:
    Logs = Any  # Who reads a policy loads no log.

COLUMN = "dirty_share"


class PriorFacts(NamedTuple):
    """What a log, or a part of it, tells of P(DIRTY)."""

    stated: tuple[float, float] | None
    """Least and largest of what its trajectories say; None where one does not."""
    total: float
    """Sum of P(DIRTY) over the objects of all first stages."""
    count: int


def logged_dirty_share(logs: Logs) -> float:
    """Read the prior that the log-odds of a log started from.

    Where the trajectories have a column ``dirty_share``, it is that. Else it is the mean of P(DIRTY) over the objects
    of all first stages: given right labels, E[P(DIRTY | label)] is the prior.

    Raises
    ------
    LogError
        The log has no objects, or its trajectories had different priors.
    """
    return dirty_share([prior_facts(logs)])


def prior_facts(logs: Logs) -> PriorFacts:
    """Look at a log, or a part of it.

    Raises
    ------
    LogError
        The log has no objects.
    """
    from halfseen.logs.columns import as_floats, require_columns

    stated = None
    if COLUMN in logs.trajectories.columns and not logs.trajectories[COLUMN].isna().to_numpy().any():
        values = logs.trajectories[COLUMN].to_numpy(dtype=np.float64)
        stated = float(values.min()), float(values.max())
    if logs.objects is None:
        if stated is not None:
            return PriorFacts(stated, 0.0, 0)
        raise LogError("objects: the log has none; a table is learned from logs with an objects table")
    require_columns("objects", logs.objects, ("stage", "log_odds"))
    log_odds = as_floats("objects", logs.objects, "log_odds").to_numpy()
    at_first = expit(log_odds[logs.objects["stage"].to_numpy() == 1])
    return PriorFacts(stated, float(at_first.sum()), len(at_first))


def dirty_share(parts: Sequence[PriorFacts]) -> float:
    """Tell the prior by what the parts of a log tell.

    Raises
    ------
    LogError
        Trajectories had different priors.
    """
    stated = [part.stated for part in parts if part.stated is not None]
    if len(stated) < len(parts):
        return sum(part.total for part in parts) / sum(part.count for part in parts)
    least, largest = min(low for low, _ in stated), max(high for _, high in stated)
    if largest > least or not 0.0 < least < 1.0:
        raise LogError(
            f"trajectories: {COLUMN} goes from {least:g} to {largest:g}; one policy has one prior between 0 "
            "and 1: select the trajectories that share it"
        )
    return least
