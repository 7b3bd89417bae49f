"""Why an action, by a planner that knows its own error.

Q is estimated by futures in which the closed one-step rule decides (`rollout`): too low, as nobody improves on the rule
after the first action, and noisy. What is known of the optimum is then

    Q*(a) = m(a) + μ + g (e(a) + κ ε + ω(a) ε_a),    Q*(FINISH) = m(FINISH),

with m the mean worth of the futures, e its sampling error, of which all actions have their part together, ε and ε_a
standard normal, and one g for all that makes it Student's t with 5 degrees of freedom: some states are harder than
others. μ = 0.0034 x^1.5, κ = 0.0092 x, and ω = 0.0117 x for WASH, 0.0037 x for LIFT [reward], with x = h √(1 + σ²),
where h is the number of steps to go and σ the standard deviation of the worth of one future.

The four constants are fitted by maximum likelihood against exact optima of random tables of 3 cups over 6 steps and 2
cups over 8, in the world's default numbers, and checked on other tables: ``benchmarks/calibration.py``. Beyond such
sizes and numbers they are extrapolated. An action is best where none is worth more than 1e-9 more, so of actions that
tie all are; interchangeable objects are known to tie (`halfseen.world.explanation.alike`).
"""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from halfseen.errors import ArgumentError
from halfseen.planners.rollout import sampled_values
from halfseen.world.action_space import FINISH, possible_actions
from halfseen.world.config import WorldConfig
from halfseen.world.explanation import Explanation, alike, explained
from halfseen.world.state import TableState

_NUM_DRAWS = 2000
DEGREES_OF_FREEDOM = 5.0
SHIFT_POWER = 1.5


class PlannerError(NamedTuple):
    """How far the optimum is from what sampled futures say, for each unit of x (shift: of x^1.5) [reward]."""

    shift: float
    """Mean of what the futures miss of WASH and LIFT."""
    common: float
    """Standard deviation of the error that WASH and LIFT share."""
    wash: float
    """Standard deviation of the error of one WASH alone."""
    lift: float
    """Standard deviation of the error of one LIFT alone."""


FITTED_ERROR = PlannerError(shift=0.0034, common=0.0092, wash=0.0117, lift=0.0037)
"""Printed by ``python benchmarks/calibration.py --fit --tables 12 --states 12``."""


@dataclass(frozen=True, eq=False)
class Futures:
    """Sampled futures of the actions of one table, WASH and LIFT of interchangeable objects counted together.

    Attributes
    ----------
    worths
        Of each future by each action [reward]; 0 where impossible.
    is_possible
        Which actions the state allows.
    first_alike
        For each action the lowest that is its equal but for the numbering of the objects.
    steps_to_go
        Actions left.
    """

    worths: Float[np.ndarray, "S A"]
    is_possible: Bool[np.ndarray, " A"]
    first_alike: Int[np.ndarray, " A"]
    steps_to_go: int

    @property
    def is_uncertain(self) -> Bool[np.ndarray, " A"]:
        """Whether an action's worth is not known exactly."""
        return self.is_possible & (np.arange(len(self.is_possible)) != FINISH)

    @property
    def difficulty(self) -> float:
        """How uncertain the futures are, x = h √(1 + σ²)."""
        variance = np.mean(np.var(self.worths[:, self.is_uncertain], axis=0))
        return self.steps_to_go * float(np.sqrt(1.0 + variance))


def futures_of(config: WorldConfig, state: TableState, key: Array, num_futures: int) -> Futures:
    """Sample futures of one table; see `explain`."""
    is_possible, first_alike = np.asarray(possible_actions(state)), alike(state)
    sampled = np.asarray(sampled_values(config, state, key, num_futures), dtype=np.float64)
    sampled = np.where(is_possible, sampled, 0.0)
    # Interchangeable objects are worth the same, so what is learned of one is learned of all.
    is_equal = first_alike[:, None] == first_alike[None, :]
    worths = sampled @ (is_equal / is_equal.sum(axis=0))
    return Futures(worths, is_possible, first_alike, int(state.steps_to_go))


def explain(
    config: WorldConfig, state: TableState, key: Array, *, num_futures: int = 512, level: float = 0.9
) -> Explanation:
    """Explain what is best to do at one table: worths with intervals, chances of being best, worth of each LIFT.

    Parameters
    ----------
    config
        The world that is believed in.
    state
        One table, with a step to go and an object on it.
    key
        The only source of chance.
    num_futures
        Sampled futures of each action; the time taken is in proportion.
    level
        Probability with which the intervals are to hold.

    Returns
    -------
    Explanation
        Of Q under the best policy. Actions that are worth the same are all best.

    Raises
    ------
    ArgumentError
        `num_futures` is below 2, `level` is out of range, or the path is over.

    Examples
    --------
    >>> from halfseen.world import Scene, WorldConfig
    >>> from halfseen.world.state import initial_state, pad_scenes
    >>> config = WorldConfig()
    >>> layout = jax.tree.map(lambda leaf: leaf[0], pad_scenes([Scene(np.zeros((1, 1)))]))
    >>> told = explain(config, initial_state(config, layout), jax.random.key(0))
    >>> told.actions[told.best]
    'LIFT 0'
    """
    if num_futures < 2:
        raise ArgumentError(f"num_futures is {num_futures}; at least 2 are needed to tell their spread")
    if int(state.steps_to_go) < 1 or not np.asarray(state.is_on_table).any():
        raise ArgumentError("the path is over: no step to go or no object left; explain a state before its end")
    futures_key, draw_key = jax.random.split(key)
    futures = futures_of(config, state, futures_key, num_futures)
    rng = np.random.default_rng(np.asarray(jax.random.key_data(draw_key)))
    values = expected_q(futures, FITTED_ERROR)
    return explained(values, drawn_q(futures, FITTED_ERROR, rng, _NUM_DRAWS), futures.is_possible, level)


def expected_q(futures: Futures, error: PlannerError) -> Float[np.ndarray, " A"]:
    """Mean of what Q* may be, m + μ."""
    shift = error.shift * futures.difficulty**SHIFT_POWER
    return futures.worths.mean(axis=0) + np.where(futures.is_uncertain, shift, 0.0)


def drawn_q(
    futures: Futures, error: PlannerError, rng: np.random.Generator, num_draws: int
) -> Float[np.ndarray, "B A"]:
    """Draws from what Q* may be, given sampled futures of each action."""
    num_futures, num_actions = futures.worths.shape
    weights = rng.standard_normal((num_draws, num_futures)) / np.sqrt(num_futures * (num_futures - 1))
    sampling = weights @ (futures.worths - futures.worths.mean(axis=0))
    own = rng.standard_normal((num_draws, num_actions))[:, futures.first_alike] * own_error(num_actions, error)
    missed = futures.difficulty * (error.common * rng.standard_normal((num_draws, 1)) + own)
    wrong = np.where(futures.is_uncertain, sampling + missed, 0.0)
    return expected_q(futures, error) + wrong * _of_each_state(rng, num_draws)


def own_error(num_actions: int, error: PlannerError) -> Float[np.ndarray, " A"]:
    """ω / x of each action; 0 for FINISH, which is exact."""
    num_objects = (num_actions - 1) // 2
    return np.repeat([0.0, error.wash, error.lift], [1, num_objects, num_objects])


def _of_each_state(rng: np.random.Generator, num_draws: int) -> Float[np.ndarray, "B 1"]:
    """g: Student's t is a normal variable times it; its mean square is 1."""
    degrees = DEGREES_OF_FREEDOM
    return np.sqrt((degrees - 2.0) / rng.chisquare(degrees, (num_draws, 1)))
