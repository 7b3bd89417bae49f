"""Slow policies on single episodes, and how long one decision takes on this machine.

An episode depends on its key and number alone, so one that is played by itself is the one that others play many at
once; here no decision is made after its end.
"""

import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from halfseen.study.experiment import Setting
from halfseen.study.pipeline import EVALUATION, Played, Source, random_key
from halfseen.study.policies import Contender
from halfseen.tables.features import NUM_FEATURES
from halfseen.tables.table_policy import LinearTablePolicy
from halfseen.world.action_space import Verb
from halfseen.world.config import Number, WorldConfig
from halfseen.world.dynamics import start, step
from halfseen.world.episodes import BATCH
from halfseen.world.policy import Policy
from halfseen.world.state import HiddenState, Layout, TableState

MOST_TIMED_S = 0.5
"""Time that is spent on timing one policy, but for its last decision [s]."""
FEWEST_TIMED = 3


@jax.jit
def decided(policy: Policy, state: TableState, key: jax.Array) -> jax.Array:
    """Decide for one table, compiled once for all policies of a kind."""
    return policy.decide(state, key).action


def play_singly(source: Source, policy: Policy, episodes: Sequence[int], purpose: int = EVALUATION) -> Played:
    """Play single episodes of those that `Source.evaluate` plays many at once."""
    key, world = random_key(source.seed, purpose, source.index), source.world
    totals = []
    for episode in episodes:
        state, hidden, world_key, policy_key = _begun(world, source.layouts, key, episode)
        earned, taken_s, t, is_over = 0.0, 0.0, 0, False
        while t < world.horizon and not is_over:
            action = decided(policy, state, jax.random.fold_in(policy_key, t))
            state, hidden, gained, duration_s, is_over = _stepped(world, state, hidden, action, world_key, t)
            earned, taken_s, t = earned + float(gained), taken_s + float(duration_s), t + 1
        totals.append((earned, taken_s))
    return Played(*np.array(totals).T)


@jax.jit
def _begun(
    world: WorldConfig, layouts: Layout, key: jax.Array, episode: Number
) -> tuple[TableState, HiddenState, jax.Array, jax.Array]:
    """The table as the episode begins, and the keys of the world and of the policy."""
    layout = jax.tree.map(lambda leaf: leaf[episode % leaf.shape[0]], layouts)
    start_key, world_key, policy_key = jax.random.split(jax.random.fold_in(key, episode), 3)
    return *start(world, layout, start_key), world_key, policy_key


@jax.jit
def _stepped(
    world: WorldConfig, state: TableState, hidden: HiddenState, action: jax.Array, world_key: jax.Array, t: Number
) -> tuple[TableState, HiddenState, jax.Array, jax.Array, jax.Array]:
    after, hidden, outcome = step(world, state, hidden, action, jax.random.fold_in(world_key, t))
    return after, hidden, outcome.reward, outcome.duration_s, outcome.is_over


def states_along_the_way(source: Source, num_states: int) -> list[TableState]:
    """One state from each of many paths of the logging policy, early and late ones in turn."""
    # As many as other paths are played at once: for these, the program is there.
    episodes = source.play(max(num_states, BATCH))
    num_stages = np.asarray(episodes.is_taken).sum(axis=1)
    return [jax.tree.map(lambda leaf, k=k: leaf[k, k % num_stages[k]], episodes.states) for k in range(num_states)]


def decision_times_ms(
    policies: Mapping[str, Policy], states: Sequence[TableState]
) -> dict[str, Float[np.ndarray, " S"]]:
    """Time of a decision of each policy, on one core, after compilation [ms].

    Each decides once on each state, the policies in turn, so that what slows the machine slows them alike; a policy
    stops once `MOST_TIMED_S` are spent on it.
    """
    key = jax.random.key(0)
    for policy in policies.values():
        decided(policy, states[0], key).block_until_ready()
    times: dict[str, list[float]] = {name: [] for name in policies}
    with one_core():
        for state in states:
            for name, policy in policies.items():
                if sum(times[name]) < 1e3 * MOST_TIMED_S or len(times[name]) < FEWEST_TIMED:
                    times[name].append(1e3 * seconds(partial(_decided, policy, state, key)))
    return {name: np.array(values) for name, values in times.items()}


def measured_times(setting: Setting, contenders: Iterable[Contender], num_states: int) -> dict[str, float]:
    """Median decision time of contenders on states of all tables [ms]."""
    # The time of a learned decision does not depend on what was learned.
    unlearned = jnp.zeros((setting.world.horizon, len(Verb), NUM_FEATURES + 1), dtype=jnp.float32)
    policies = {
        each.name: each.policy(setting.world) if each.make else LinearTablePolicy(unlearned) for each in contenders
    }
    times = decision_times_ms(policies, states_along_the_way(Source.of(setting), num_states))
    return {name: float(np.median(values)) for name, values in times.items()}


def _decided(policy: Policy, state: TableState, key: jax.Array) -> None:
    decided(policy, state, key).block_until_ready()


def seconds(function: Callable[[], object]) -> float:
    """Time that a call takes [s]."""
    begin = time.perf_counter()
    function()
    return time.perf_counter() - begin


@contextmanager
def one_core() -> Iterator[None]:
    """Keep every thread of this process on one core, where the system can do that (Linux)."""
    threads = Path("/proc/self/task")
    if not hasattr(os, "sched_setaffinity") or not threads.is_dir():
        yield
        return
    before = os.sched_getaffinity(0)
    _pin(threads, {min(before)})
    try:
        yield
    finally:
        _pin(threads, before)


def _pin(threads: Path, cores: set[int]) -> None:
    for thread in threads.iterdir():
        try:
            os.sched_setaffinity(int(thread.name), cores)
        except ProcessLookupError:
            continue  # the thread has just ended
