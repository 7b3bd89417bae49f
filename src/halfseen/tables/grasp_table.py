"""A fitted grasp model as a table of probabilities, the form that a policy stores.

The effect of a visible grip is added to a grasp model that does not use it. A cell sees more of an object than its
hidden share: that it lies, that it is wide, that there is no room. The cell's law turns this into the mean of the
object's grip offset (`halfseen.world.state`). Its effect, given occlusion and past attempts, is learned from the
attempts themselves (`halfseen.tables.grasp_choice.fit_grip_effect`):

    P(held | p, grip) = expit(logit p + shift + per_grip · grip),

with p the model's probability without the grip. The offset varies about its mean with standard deviation σ, which
attenuates log-odds by about √(1 + 0.35 σ²) [ZegerLiangAlbert1988]_. So `per_grip` lies between 0 and 1.
"""

from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from halfseen.arrays import Array, Rows, library_of, mapped, record
from halfseen.errors import ArgumentError
from halfseen.shapes import Float
from halfseen.world.state import TableState, attempt_counts, occlusion

NUM_OCCLUSIONS = 33
SURE = 1e-9
"""Probabilities are clipped to this distance from 0 and 1."""


@record
class GraspTable:
    """P(success) by occlusion, past successes and past failures.

    Occlusions are interpolated; counts of successes or failures are capped at the largest in the table. The effect of
    the mean grip offset is added to the log-odds.

    Parameters
    ----------
    probabilities
        At grip offset 0: occlusions evenly spaced from 0 to 1, successes from 0, failures from 0.
    per_grip
        Log-odds for each unit of the mean grip offset; 1 for its full effect.
    """

    probabilities: Float[Array, "*B O K K"]
    per_grip: Float[Array, "*B"] | float = 1.0

    def probability(self, state: TableState) -> Float[Array, "*B N"]:
        """P(an attempt succeeds) for each object, from a table without batch axes."""
        xp = library_of(state.log_odds, self.probabilities)
        num_cells, most = self.probabilities.shape[-3] - 1, self.probabilities.shape[-1] - 1
        successes, failures = (xp.clip(counts, 0, most).astype(np.int32) for counts in attempt_counts(state))
        place = xp.clip(occlusion(state), 0.0, 1.0) * num_cells
        below = xp.clip(xp.floor(place), 0, num_cells - 1)
        cell = below.astype(np.int32)
        table, size = self.probabilities.reshape(-1), most + 1
        low, high = (xp.take(table, ((cell + step) * size + successes) * size + failures) for step in (0, 1))
        probability = low + (place - below) * (high - low)
        return probability / (1.0 + (1.0 - probability) * xp.expm1(-self.per_grip * state.grip))


@record
class GraspByRobot:
    """P(an attempt succeeds) for the whole team, and for each robot (a `GraspModel`).

    A team's prospects on a table are the same whichever robot decides, and use one model of all attempts. Features of
    one object use the model of the robot that is at it.

    Parameters
    ----------
    shared
        Learned from the attempts of all robots.
    own
        Learned from the attempts of each robot; axis K first.
    """

    shared: GraspTable
    own: GraspTable

    def probability(self, state: TableState) -> Float[Array, "*B N"]:
        """P(an attempt succeeds) for each object, by the shared model."""
        return self.shared.probability(state)

    def of(self, robot: int) -> GraspTable:
        """Return the table of one robot."""
        return mapped(lambda leaf: leaf[robot], self.own)


@runtime_checkable
class GraspEstimator(Protocol):
    """Interface of `BetaGrasp` and `SVMGrasp`: estimators of the probability of an attempt."""

    def fit(self, frame: Any) -> "GraspEstimator":
        """Learn from attempts."""
        ...

    def predict_proba(self, frame: Any) -> Float[np.ndarray, "m 2"]:
        """Probability that an attempt fails, and that it succeeds."""
        ...


class History(NamedTuple):
    """Covariates of an object before an attempt."""

    occlusion: Rows
    successes: Rows
    failures: Rows


class GripEffect(NamedTuple):
    """Effect of an object's mean grip offset on the log-odds of a grasp.

    Parameters
    ----------
    shift
        Constant: it accounts for the mean grip of the attempts that the model was fitted to.
    per_grip
        Slope for each unit of the grip.
    """

    shift: float = 0.0
    per_grip: float = 0.0

    def moved(self, probability: Rows, grip: Rows | float) -> Rows:
        """P(held) given the grip, from a model's probability without it."""
        from scipy.special import expit, logit

        return expit(logit(np.clip(probability, SURE, 1.0 - SURE)) + self.shift + self.per_grip * grip)


IN_FULL = GripEffect(per_grip=1.0)
"""The full effect of the grip."""


def tabulate(model: GraspEstimator, horizon: int, effect: GripEffect = IN_FULL) -> GraspTable:
    """Tabulate a fitted model for all histories possible in a trajectory of `horizon` stages.

    `effect` is the effect of the grip given the model.

    Raises
    ------
    ArgumentError
        `horizon` is below 1, or the model gives no probabilities.
    """
    if horizon < 1:
        raise ArgumentError(f"horizon is {horizon}; give at least 1 stage")
    asked = every_history(horizon)
    probabilities = model.predict_proba(asked._asdict())[:, 1]
    wrong = ~((probabilities >= 0) & (probabilities <= 1))
    if wrong.any():
        at = int(np.argmax(wrong))
        raise ArgumentError(
            f"{model!r} gives {probabilities[at]} at occlusion {asked.occlusion[at]:g}; a probability must lie "
            "in [0, 1]"
        )
    return table_of(probabilities, horizon, effect)


def every_history(horizon: int) -> History:
    """All histories of an object possible in a trajectory of `horizon` stages, with discrete occlusions."""
    level, successes, failures = (axis.ravel() for axis in np.indices(_shape(horizon)))
    return History(level / (NUM_OCCLUSIONS - 1), successes.astype(np.float64), failures.astype(np.float64))


def table_of(probabilities: Rows, horizon: int, effect: GripEffect) -> GraspTable:
    """Make the table from the probabilities of `every_history`."""
    moved = effect.moved(probabilities, 0.0) if effect.shift else probabilities
    return GraspTable(moved.reshape(_shape(horizon)).astype(np.float32), np.float32(effect.per_grip))


def _shape(horizon: int) -> tuple[int, int, int]:
    return NUM_OCCLUSIONS, horizon + 1, horizon + 1
