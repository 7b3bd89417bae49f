"""Explanations of a decision by a planner with a model of its own error.

`halfseen.world.explanation` derives an explanation from draws of Q; this module makes a planner's draws.

Q is estimated by rollouts that follow the myopic look-ahead (`rollout`). The estimate is noisy, and too low because the
rollouts do not improve on the rule after the first action. The distribution of the optimum is then

    Q*(a) = m(a) + μ + g (e(a) + κ ε + ω(a) ε_a),    Q*(FINISH) = m(FINISH),

with m the mean value of the rollouts, e its sampling error, correlated between actions, ε and ε_a standard normal, and
a common factor g that makes the errors Student's t with 5 degrees of freedom, as some states are harder than others.
μ = 0.0034 x^1.5, κ = 0.0092 x, and ω = 0.0117 x for WASH, 0.0037 x for LIFT [reward], with x = h √(1 + σ²), where h is
the number of steps to go and σ the standard deviation of the value of one rollout.

The four constants are fitted by maximum likelihood to exact optima of random tables of 3 cups over 6 steps and 2 cups
over 8, with the world's default parameters, and checked on other tables: ``benchmarks/calibration.py``. For other sizes
and parameters they are extrapolated. In that check, actions within 1e-9 of the largest value all count as best;
interchangeable objects are tied by construction (`halfseen.world.explanation.alike`).
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from halfseen.errors import ArgumentError
from halfseen.planners.rollout import sampled_values
from halfseen.shapes import Bool, Float, Int
from halfseen.world import random
from halfseen.world.actions import FINISH, ActionSpace, Verb
from halfseen.world.config import WorldConfig
from halfseen.world.explanation import Explanation, alike, explained
from halfseen.world.random import Key
from halfseen.world.state import TableState, check_goes_on

_NUM_DRAWS = 2000
DEGREES_OF_FREEDOM = 5.0
SHIFT_POWER = 1.5


class PlannerError(NamedTuple):
    """Error of the rollouts' values against the optimum, per unit of x (shift: of x^1.5) [reward]."""

    shift: float
    """Mean underestimation of WASH and LIFT."""
    common: float
    """Standard deviation of the error common to WASH and LIFT."""
    wash: float
    """Standard deviation of the individual error of a WASH."""
    lift: float
    """Standard deviation of the individual error of a LIFT."""


FITTED_ERROR = PlannerError(shift=0.0034, common=0.0092, wash=0.0117, lift=0.0037)
"""Printed by ``python benchmarks/calibration.py --fit --tables 12 --states 12``."""


@dataclass(frozen=True, eq=False)
class Rollouts:
    """Rollouts of the actions of one table, pooled over interchangeable objects.

    Attributes
    ----------
    worths
        Value of each rollout of each action [reward]; 0 if impossible.
    is_possible
        Which actions the state allows.
    first_alike
        For each action, the lowest action equivalent to it up to the numbering of the objects.
    steps_to_go
        Number of actions left.
    """

    worths: Float[np.ndarray, "S A"]
    is_possible: Bool[np.ndarray, " A"]
    first_alike: Int[np.ndarray, " A"]
    steps_to_go: int

    @property
    def is_uncertain(self) -> Bool[np.ndarray, " A"]:
        """Whether an action's value is not known exactly."""
        return self.is_possible & (np.arange(len(self.is_possible)) != FINISH)

    @property
    def difficulty(self) -> float:
        """Scale of the rollouts' uncertainty, x = h √(1 + σ²)."""
        variance = np.mean(np.var(self.worths[:, self.is_uncertain], axis=0))
        return self.steps_to_go * float(np.sqrt(1.0 + variance))


def rollouts_of(config: WorldConfig, state: TableState, key: Key, num_rollouts: int) -> Rollouts:
    """Draw rollouts of one table; see `explain`."""
    sampled = np.asarray(sampled_values(config, state, key, num_rollouts), dtype=np.float64)
    # A verb that the look-ahead does not know counts as impossible.
    is_possible, first_alike = np.isfinite(sampled[0]), alike(state)
    sampled = np.where(is_possible, sampled, 0.0)
    # Interchangeable objects have equal values, so their rollouts are pooled.
    is_equal = first_alike[:, None] == first_alike[None, :]
    worths = sampled @ (is_equal / is_equal.sum(axis=0))
    return Rollouts(worths, is_possible, first_alike, int(state.steps_to_go))


def explain(
    config: WorldConfig, state: TableState, key: Key, *, num_rollouts: int = 512, level: float = 0.9
) -> Explanation:
    """Explain one table: action values with intervals, probabilities of being best, and the worth of each LIFT.

    Parameters
    ----------
    config
        The planner's model of the world.
    state
        One table, with a step to go and an object on it.
    key
        Random key of the draws.
    num_rollouts
        Rollouts of each action; the time taken is proportional.
    level
        Coverage probability of the intervals.

    Returns
    -------
    Explanation
        Explanation of Q under the optimal policy. Equally good actions all count as best.

    Raises
    ------
    ArgumentError
        `num_rollouts` is below 2, `level` is out of range, or the trajectory is over.

    Examples
    --------
    >>> from halfseen.arrays import mapped
    >>> from halfseen.world import Scene, WorldConfig, random
    >>> from halfseen.world.state import initial_state, pad_scenes
    >>> config = WorldConfig()
    >>> layout = mapped(lambda leaf: leaf[0], pad_scenes([Scene(np.zeros((1, 1)))]))
    >>> found = explain(config, initial_state(config, layout), random.key_of(0))
    >>> found.actions[found.best]
    'LIFT 0'
    """
    if num_rollouts < 2:
        raise ArgumentError(f"num_rollouts is {num_rollouts}; at least 2 are needed to estimate their spread")
    check_goes_on(state)
    rollout_key, draw_key = random.split(key)
    rollouts = rollouts_of(config, state, rollout_key, num_rollouts)
    rng = np.random.default_rng(draw_key)
    values = expected_q(rollouts, FITTED_ERROR)
    return explained(values, drawn_q(rollouts, FITTED_ERROR, rng, _NUM_DRAWS), rollouts.is_possible, level)


def expected_q(rollouts: Rollouts, error: PlannerError) -> Float[np.ndarray, " A"]:
    """Mean of Q*, m + μ."""
    shift = error.shift * rollouts.difficulty**SHIFT_POWER
    return rollouts.worths.mean(axis=0) + np.where(rollouts.is_uncertain, shift, 0.0)


def drawn_q(
    rollouts: Rollouts, error: PlannerError, rng: np.random.Generator, num_draws: int
) -> Float[np.ndarray, "B A"]:
    """Draws of Q*, given rollouts of each action."""
    num_rollouts, num_actions = rollouts.worths.shape
    weights = rng.standard_normal((num_draws, num_rollouts)) / np.sqrt(num_rollouts * (num_rollouts - 1))
    sampling = weights @ (rollouts.worths - rollouts.worths.mean(axis=0))
    own = rng.standard_normal((num_draws, num_actions))[:, rollouts.first_alike] * own_error(num_actions, error)
    missed = rollouts.difficulty * (error.common * rng.standard_normal((num_draws, 1)) + own)
    wrong = np.where(rollouts.is_uncertain, sampling + missed, 0.0)
    # g: a normal variable times g is Student's t; its mean square is 1.
    of_each_state = np.sqrt((DEGREES_OF_FREEDOM - 2.0) / rng.chisquare(DEGREES_OF_FREEDOM, (num_draws, 1)))
    return expected_q(rollouts, error) + wrong * of_each_state


def own_error(num_actions: int, error: PlannerError) -> Float[np.ndarray, " A"]:
    """ω / x of each action; 0 for FINISH, which is exact, and for verbs that the look-ahead does not know."""
    of_verb = {Verb.WASH: error.wash, Verb.LIFT: error.lift}
    return np.array([of_verb.get(Verb(verb), 0.0) for verb in ActionSpace.of_size(num_actions).verbs])
