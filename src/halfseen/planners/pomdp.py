"""Planning with a known model, h steps ahead in belief space: the planner of the table as a policy.

Q_1 is the myopic look-ahead of `one_step`. For larger h, Q_h(b, a) is the value, by rollouts (`rollout`), of action a
followed by h − 1 actions of that look-ahead; the last is valued by Q_1, which includes all later rewards. If h is the
full trajectory, only the number of rollouts limits the accuracy.

`POMDPPolicy` has a budget of rollouts per table; `plan`, for a single table, one of rollouts or of seconds. A time
budget is spent on the same rounds of sequential halving, each with its own deadline. Rollouts begin only if, at the
pace so far, they are expected to end in time, so a plan overruns by less than one slow chunk of rollouts. If not even
the first batch fits, the myopic look-ahead decides, and the plan reports this. Nothing is compiled, so the first call
is as fast as the others, except for Python imports.
"""

import math
import time
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from halfseen.arrays import STATIC, Array, library_of, mapped, record
from halfseen.errors import ArgumentError
from halfseen.planners.one_step import one_step_q
from halfseen.planners.rollout import Search, drawn, draws_of, halved, num_steps, opened, searched, searched_values
from halfseen.shapes import Float, Int
from halfseen.world import random
from halfseen.world.config import WorldConfig
from halfseen.world.policy import PolicyDraw
from halfseen.world.random import Key
from halfseen.world.state import TableState, check_goes_on

NUM_SIMULATIONS = 256


@record
class POMDPPolicy:
    """Takes the best action by a look-ahead of `planning_horizon` steps.

    Parameters
    ----------
    config
        Its model of the world.
    planning_horizon
        h, ≥ 1.
    num_simulations
        Approximate number of rollouts per decision, over all actions, ≥ 1; ignored if h is 1, which needs none.

    Raises
    ------
    ArgumentError
        A number is below 1, or the horizon is not a whole number.
    """

    config: WorldConfig
    planning_horizon: int | float = field(default=2, metadata=STATIC)
    num_simulations: int = field(default=NUM_SIMULATIONS, metadata=STATIC)

    num_robots: ClassVar[int] = 1

    def __post_init__(self) -> None:
        if not float(self.planning_horizon).is_integer():
            raise ArgumentError(f"planning_horizon is {self.planning_horizon}; give a whole number")
        if self.planning_horizon == 1:
            object.__setattr__(self, "num_simulations", 0)
            return
        for name in ("planning_horizon", "num_simulations"):
            if getattr(self, name) < 1:
                raise ArgumentError(f"{name} is {getattr(self, name)}; give at least 1")

    def decide(self, state: TableState, key: Key) -> PolicyDraw:
        """Choose for each table; the rollouts draw from `key` (the propensity is unknown)."""
        q = self.q_values(state, key)
        xp = library_of(q)
        return PolicyDraw(xp.argmax(q, axis=-1).astype(np.int32), xp.full(q.shape[:-1], np.nan, dtype=np.float32))

    def q_values(self, state: TableState, key: Key) -> Float[Array, "*B A"]:
        """Q_h of every action; −∞ if impossible."""
        if self.num_simulations == 0:
            return one_step_q(self.config, state)
        return searched_values(self.config, state, key, self.num_simulations, int(self.planning_horizon))


BATCH = 24
"""Least number of rollouts begun at once, as fewer are no faster; with more time, more batches run side by side."""
LOOKS_PER_STEP = 1.2
"""Initial estimate of the duration of one step of a batch, relative to that of opening the search."""
SHARE_OF_TIME_LEFT = 0.5
"""Expected duration of a chunk of batches, as a share of the time left to its round."""


@dataclass(frozen=True)
class Plan:
    """A decision with its action values and costs of computation.

    Attributes
    ----------
    action
        The best action.
    values
        Q of each action [reward]; −∞ if impossible.
    num_rollouts
        Number of rollouts of each action; 0 for FINISH, whose value is known.
    elapsed_s
        Wall-clock time of the call [s].
    """

    action: int
    values: Float[np.ndarray, " A"]
    num_rollouts: Int[np.ndarray, " A"]
    elapsed_s: float

    @property
    def was_searched(self) -> bool:
        """Whether there was a rollout; if not, `values` are those of the myopic look-ahead, exact at the last step."""
        return bool(self.num_rollouts.any())


def plan(
    config: WorldConfig,
    state: TableState,
    key: Key,
    *,
    num_simulations: int | None = None,
    seconds: float | None = None,
    planning_horizon: int | None = None,
) -> Plan:
    """Search for the best action of one table within a budget of rollouts or time.

    Parameters
    ----------
    config
        The planner's model of the world.
    state
        One table, with a step to go and an object on it.
    key
        Random key: the same key and number of rollouts give the same values.
    num_simulations
        Approximate number of rollouts over all actions, ≥ 1. Give this or `seconds`.
    seconds
        Wall-clock time, positive [s].
    planning_horizon
        Number of actions of a rollout, ≥ 1, the last of which is valued by the myopic look-ahead; 1 draws nothing. By
        default, to the end of the trajectory.

    Raises
    ------
    ArgumentError
        Neither or both budgets are given, a number is out of range, or the trajectory is over.

    Examples
    --------
    >>> from halfseen.world import Scene, WorldConfig
    >>> from halfseen.world.state import initial_state, pad_scenes
    >>> config = WorldConfig()
    >>> from halfseen.world.random import key_of
    >>> layout = mapped(lambda leaf: leaf[0], pad_scenes([Scene(np.zeros((1, 1)))]))
    >>> found = plan(config, initial_state(config, layout), key_of(0), num_simulations=64)
    >>> found.action, found.was_searched
    (2, True)
    """
    begin_s = time.perf_counter()
    horizon = config.horizon if planning_horizon is None else planning_horizon
    _check(state, num_simulations, seconds, horizon)
    search = opened(config, mapped(lambda leaf: np.asarray(leaf)[None], state))
    steps_to_go = int(state.steps_to_go)
    if horizon > 1 and steps_to_go > 1:
        if seconds is None:
            search = searched(search, key[None], num_simulations or 1, horizon, steps_to_go)
        else:
            search = _timed(search, key, horizon, begin_s, begin_s + seconds)
    count = search.count[0]
    found = search.values[0] if count.any() else search.rule[0]
    elapsed_s = time.perf_counter() - begin_s
    return Plan(int(np.argmax(found)), found.astype(np.float64), count.astype(np.int64), elapsed_s)


def _grown(
    search: Search,
    round_key: Key,
    promising: Int[np.ndarray, "1 k"],
    size: int,
    batches: tuple[int, int],
    planning_horizon: int,
) -> Search:
    """Add some batches of a round to the search, with the `size` most promising actions left."""
    left, lane = search.num_left(size), np.arange(BATCH * batches[0], BATCH * batches[1])
    keys = random.fold_in(round_key, np.arange(lane[0] // left[0], lane[-1] // left[0] + 1))[None]
    steps = num_steps(planning_horizon, int(search.table.steps_to_go[0]))
    draws = draws_of(keys, steps, len(search.table.is_there))
    return drawn(search, promising, left, lane, draws, planning_horizon)


def _timed(search: Search, key: Key, planning_horizon: int, begin_s: float, end_s: float) -> Search:
    """Sequential halving by the clock: a first batch measures the pace, which sets the number of rounds.

    Each round draws rollouts of the remaining actions until no further batch fits.
    """
    opened_s = time.perf_counter()
    steps = num_steps(planning_horizon, int(search.table.steps_to_go[0]))
    pace_s = LOOKS_PER_STEP * steps * (opened_s - begin_s)
    if opened_s + pace_s > end_s:
        return search
    search = _grown(search, random.fold_in(key, 0), search.promising, 2, (0, 1), planning_horizon)
    now_s = start_s = time.perf_counter()
    pace_s = start_s - opened_s
    sizes = halved(BATCH * max(0, int((end_s - start_s) / pace_s)), search.rule.shape[-1])
    for stage, size in enumerate(sizes, start=1):
        round_key, promising, done = random.fold_in(key, stage), search.promising, 0
        round_end_s = start_s + (end_s - start_s) * stage / len(sizes)
        while now_s + pace_s <= round_end_s:
            num = max(1, int(SHARE_OF_TIME_LEFT * (round_end_s - now_s) / pace_s))
            search = _grown(search, round_key, promising, size, (done, done + num), planning_horizon)
            done, was_s, now_s = done + num, now_s, time.perf_counter()
            pace_s = (now_s - was_s) / num
    return search


def _check(state: TableState, num_simulations: int | None, seconds: float | None, planning_horizon: int) -> None:
    if (seconds is None) == (num_simulations is None):
        raise ArgumentError(f"seconds is {seconds} and num_simulations is {num_simulations}; give one of the two")
    if seconds is not None and not 0.0 < seconds < math.inf:
        raise ArgumentError(f"seconds is {seconds}; give a positive number of seconds")
    for name, number in (("num_simulations", num_simulations), ("planning_horizon", planning_horizon)):
        if number is not None and number < 1:
            raise ArgumentError(f"{name} is {number}; give at least 1")
    check_goes_on(state)
