"""All that a log tells of the state of a stage, whether or not Q looks at it."""

from collections.abc import Sequence

import numpy as np

from halfseen.learning.covariates import Categories, Covariates, fit_covariates, learned_categories
from halfseen.learning.rows import TrajectoryArrays, stage_places
from halfseen.logs import Logs
from halfseen.shapes import Float


def states_of(
    logs: Logs,
    trajectories: TrajectoryArrays,
    known: Categories,
    left_out: Sequence[str] = (),
    added: Sequence[str] = (),
) -> Float[np.ndarray, "n T F"]:
    """Lay out the covariates that can be looked at; zeros where no stage was begun.

    Parameters
    ----------
    logs, trajectories
        The log, and the same laid out.
    known
        Categories that are given.
    left_out, added
        Covariates that are not wanted, and other columns that are.
    """
    names = [name for name in fit_covariates(logs) if name not in left_out]
    looked_at = Covariates((*names, *added), learned_categories([logs], names, known))
    return laid_out(looked_at.encode(logs.stages), logs, trajectories)


def laid_out(rows: Float[np.ndarray, "m F"], logs: Logs, trajectories: TrajectoryArrays) -> Float[np.ndarray, "n T F"]:
    """Put what is known of each row of a log where its stage is; zeros elsewhere."""
    found = np.zeros((*trajectories.is_begun.shape, rows.shape[1]))
    found[stage_places(logs)] = rows
    return found
