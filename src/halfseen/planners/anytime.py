"""One decision at one table within a budget: a number of rollouts, or seconds.

A number of rollouts is spent as `POMDPPolicy` spends it. Seconds are spent on the same rounds of sequential halving
(`rollout.searched`), each of which ends by the clock. No more is begun than is expected to end in time, by the pace so
far; so a plan is late by less than the chunk of rollouts that was slower than those before it. Where not even the first
batch fits, the myopic look-ahead decides, and the plan says so.

The first call for a number of objects compiles, within its budget: call `warm_up` before the clock matters.
"""

import math
import time
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from halfseen.errors import ArgumentError
from halfseen.planners.rollout import Search, drawn, halved, most_promising, opened, searched, values
from halfseen.world.config import Number, WorldConfig
from halfseen.world.state import TableState, check_goes_on

BATCH = 8
"""Rollouts that are drawn side by side: on a processor, more gain nothing."""
LOOKS_PER_BATCH = 4.0
"""How many times as long as to open a search a batch takes, about, before one was timed."""
SHARE_OF_TIME_LEFT = 0.5
"""What a chunk of batches is expected to take of what is left to its round."""

_opened, _promising = jax.jit(opened), jax.jit(most_promising)
_counted = jax.jit(searched, static_argnames="num_rollouts")


@dataclass(frozen=True)
class Plan:
    """A decision, what it is worth, and what it took.

    Attributes
    ----------
    action
        The best action.
    values
        Q of each action [reward]; −∞ where it is impossible.
    num_rollouts
        Of each action; none of FINISH, whose worth is known.
    elapsed_s
        Time from call to answer [s].
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
    key: Array,
    *,
    num_simulations: int | None = None,
    seconds: float | None = None,
    planning_horizon: int | None = None,
) -> Plan:
    """Search for the best action of one table until rollouts or time are used up.

    Parameters
    ----------
    config
        The world that is believed in.
    state
        One table, with a step to go and an object on it.
    key
        What is drawn from: the same key and number of rollouts give the same values.
    num_simulations
        Rollouts of all actions together, about, ≥ 1. Give this or `seconds`.
    seconds
        Wall-clock time, above 0 [s]. What compiles counts; see `warm_up`.
    planning_horizon
        Actions of a rollout, ≥ 1, the last of which is valued by the myopic look-ahead; 1 draws nothing. By default,
        to the end of the path.

    Raises
    ------
    ArgumentError
        Neither or both budgets are given, a number is out of range, or the path is over.

    Examples
    --------
    >>> from halfseen.world import Scene, WorldConfig
    >>> from halfseen.world.state import initial_state, pad_scenes
    >>> config = WorldConfig()
    >>> layout = jax.tree.map(lambda leaf: leaf[0], pad_scenes([Scene(np.zeros((1, 1)))]))
    >>> found = plan(config, initial_state(config, layout), jax.random.key(0), num_simulations=64)
    >>> found.action, found.was_searched
    (2, True)
    """
    begin_s = time.perf_counter()
    horizon = config.horizon if planning_horizon is None else planning_horizon
    _check(state, num_simulations, seconds, horizon)
    search = jax.block_until_ready(_opened(config, state))
    if horizon > 1 and int(state.steps_to_go) > 1:
        if seconds is not None:
            search = _timed(search, key, horizon, begin_s, begin_s + seconds)
        else:
            search = _counted(search, key, num_simulations, horizon)
    return _read(search, begin_s)


def warm_up(config: WorldConfig, state: TableState) -> None:
    """Compile what `plan` needs to keep a time, for all tables with as many objects and steps as this one."""
    search = _opened(config, state)
    _told(_grown(search, jax.random.key(0), 0, _promising(search), 2, 0, 1, config.horizon))[0].block_until_ready()


@jax.jit
def _grown(
    search: Search,
    key: Array,
    stage: Number,
    promising: Int[Array, " K"],
    num_left: Number,
    begin: Number,
    end: Number,
    planning_horizon: Number,
) -> Search:
    """The search after batches `begin` to `end` of a round."""
    round_key = jax.random.fold_in(key, stage)

    def batch(k: Array, search: Search) -> Search:
        lane = BATCH * k + jnp.arange(BATCH)
        return drawn(search, promising, num_left, lane, round_key, planning_horizon)

    return jax.lax.fori_loop(begin, end, batch, search)


def _timed(search: Search, key: Array, planning_horizon: int, begin_s: float, end_s: float) -> Search:
    """Halve by the clock: a first batch for the pace, then as many rounds as that leaves time for."""
    opened_s = time.perf_counter()
    pace_s = LOOKS_PER_BATCH * (opened_s - begin_s)
    if opened_s + pace_s > end_s:
        return search
    search = jax.block_until_ready(_grown(search, key, 0, _promising(search), 2, 0, 1, planning_horizon))
    start_s = time.perf_counter()
    pace_s = start_s - opened_s
    sizes = halved(BATCH * max(0, int((end_s - start_s) / pace_s)), len(search.rule))
    for stage, num_left in enumerate(sizes, start=1):
        round_end_s = start_s + (end_s - start_s) * stage / len(sizes)
        search, pace_s = _round(search, key, stage, num_left, planning_horizon, round_end_s, pace_s)
    return search


def _round(
    search: Search, key: Array, stage: int, num_left: int, planning_horizon: int, end_s: float, pace_s: float
) -> tuple[Search, float]:
    """Draw from the actions that are left until no batch fits; the time that one takes."""
    promising, num_done = _promising(search), 0
    begin_s = time.perf_counter()
    while begin_s + pace_s <= end_s:
        num_next = num_done + max(1, int(SHARE_OF_TIME_LEFT * (end_s - begin_s) / pace_s))
        search = _grown(search, key, stage, promising, num_left, num_done, num_next, planning_horizon)
        jax.block_until_ready(search)
        now_s = time.perf_counter()
        pace_s, begin_s, num_done = (now_s - begin_s) / (num_next - num_done), now_s, num_next
    return search, pace_s


@jax.jit
def _told(search: Search) -> tuple[Float[Array, " A"], Float[Array, " A"]]:
    """Q of each action, and its number of rollouts; Q_1 where there was none at all."""
    return jnp.where(jnp.sum(search.count) > 0.0, values(search), search.rule), search.count


def _read(search: Search, begin_s: float) -> Plan:
    found, count = jax.device_get(_told(search))
    elapsed_s = time.perf_counter() - begin_s
    return Plan(int(np.argmax(found)), found.astype(np.float64), count.astype(np.int64), elapsed_s)


def _check(state: TableState, num_simulations: int | None, seconds: float | None, planning_horizon: int) -> None:
    if (seconds is None) == (num_simulations is None):
        raise ArgumentError(f"seconds is {seconds} and num_simulations is {num_simulations}; give one of the two")
    if seconds is not None and not 0.0 < seconds < math.inf:
        raise ArgumentError(f"seconds is {seconds}; it is a positive number of seconds")
    for name, number in (("num_simulations", num_simulations), ("planning_horizon", planning_horizon)):
        if number is not None and number < 1:
            raise ArgumentError(f"{name} is {number}; it is at least 1")
    check_goes_on(state)
