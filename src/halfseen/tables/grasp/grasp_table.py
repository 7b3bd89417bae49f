"""A fitted grasp model as a table of probabilities: what a policy carries of it."""

from typing import Any

import numpy as np
from jaxtyping import Float

from halfseen.arrays import Array, Rows, library_of, record
from halfseen.censoring import is_fitted
from halfseen.errors import ArgumentError
from halfseen.logs import Logs
from halfseen.tables.grasp.attempts import attempts
from halfseen.tables.grasp.grip_effect import IN_FULL, GripEffect, fit_grip_effect
from halfseen.tables.grasp.inputs import History
from halfseen.tables.grasp.protocol import GraspEstimator
from halfseen.world.policy import GraspModel
from halfseen.world.state import TableState, attempt_counts, occlusion

NUM_OCCLUSIONS = 33


@record
class GraspTable:
    """P(success) by occlusion, past successes and past failures.

    Between occlusions it interpolates; more successes or failures than the table holds count as the most that it holds.
    What shows of an object's grip is added to the log-odds, as far as it counts (`halfseen.tables.grasp.grip_effect`).

    Parameters
    ----------
    probabilities
        Where no grip shows: occlusions evenly from 0 to 1, successes from 0, failures from 0.
    per_grip
        Log-odds for each unit of the mean grip offset; 1 where the probabilities are given it, whatever it is.
    """

    probabilities: Float[Array, "*B O K K"]
    per_grip: Float[Array, "*B"] | float = 1.0

    def probability(self, state: TableState) -> Float[Array, "*B N"]:
        """P(an attempt succeeds) for each object, by a table without axes in front."""
        xp = library_of(state.log_odds, self.probabilities)
        num_cells, most = self.probabilities.shape[-3] - 1, self.probabilities.shape[-1] - 1
        successes, failures = (xp.clip(counts, 0, most).astype(np.int32) for counts in attempt_counts(state))
        place = xp.clip(occlusion(state), 0.0, 1.0) * num_cells
        below = xp.clip(xp.floor(place), 0, num_cells - 1)
        cell = below.astype(np.int32)
        table = xp.asarray(self.probabilities)
        low, high = (table[cell + step, successes, failures] for step in (0, 1))
        probability = low + (place - below) * (high - low)
        return probability / (1.0 + (1.0 - probability) * xp.expm1(-self.per_grip * state.grip))


def tabulate(model: GraspEstimator, horizon: int, effect: GripEffect = IN_FULL) -> GraspTable:
    """Ask a fitted model for all probabilities that a path of `horizon` stages can need.

    Parameters
    ----------
    model
        The model.
    horizon
        T.
    effect
        How much a grip counts beside it.

    Raises
    ------
    ArgumentError
        `horizon` is below 1, or the model gives no probabilities.
    """
    if horizon < 1:
        raise ArgumentError(f"horizon is {horizon}; a path has at least 1 stage")
    asked = every_history(horizon)
    probabilities = model.predict_proba(asked._asdict())[:, 1]
    wrong = ~((probabilities >= 0) & (probabilities <= 1))
    if wrong.any():
        at = int(np.argmax(wrong))
        raise ArgumentError(
            f"{model!r} gives {probabilities[at]} at occlusion {asked.occlusion[at]:g}; a probability lies in [0, 1]"
        )
    return table_of(probabilities, horizon, effect)


def every_history(horizon: int) -> History:
    """All that a path of `horizon` stages can tell of an object, occlusions in steps."""
    level, successes, failures = (axis.ravel() for axis in np.indices(_shape(horizon)))
    return History(level / (NUM_OCCLUSIONS - 1), successes.astype(np.float64), failures.astype(np.float64))


def table_of(probabilities: Rows, horizon: int, effect: GripEffect) -> GraspTable:
    """Make a table of the probabilities of `every_history`."""
    moved = effect.moved(probabilities, 0.0) if effect.shift else probabilities
    table, per_grip = moved.reshape(_shape(horizon)).astype(np.float32), np.float32(effect.per_grip)
    return GraspTable(table, per_grip)


def _shape(horizon: int) -> tuple[int, int, int]:
    return NUM_OCCLUSIONS, horizon + 1, horizon + 1


def grasp_model_of(grasp: Any, logs: Logs, horizon: int) -> GraspModel | None:
    """Make a grasp model that a policy can carry.

    Parameters
    ----------
    grasp
        None; a `GraspModel`, which is taken as it is; or a grasp estimator, which is tabulated, and first fitted to the
        attempts of the log (as a copy) if it is not fitted.
    logs
        The log.
    horizon
        T.

    Raises
    ------
    ArgumentError
        `grasp` is none of these, or the attempts do not suffice to fit it.
    LogError
        The log does not tell what became of its attempts.
    """
    if grasp is None or (isinstance(grasp, GraspModel) and not isinstance(grasp, type)):
        return grasp
    if isinstance(grasp, type) or not isinstance(grasp, GraspEstimator):
        raise ArgumentError(
            f"grasp is {grasp!r}; it is None, BetaGrasp(), SVMGrasp(), either of them fitted, or a GraspTable"
        )
    if is_fitted(grasp):
        return tabulate(grasp, horizon)
    # It takes longer to import than a decision, which does not come here.
    from sklearn.base import clone

    estimator: Any = clone(grasp)
    tried = attempts(logs, horizon)
    model = estimator.fit(tried)
    return tabulate(model, horizon, fit_grip_effect(model, tried))
