"""How long one decision takes: one table, one core, after compilation.

All policies decide on the same states, in turn, so that what slows the machine slows them alike.
"""

import os
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from halfseen.world.policy import Policy
from halfseen.world.state import TableState

NUM_CALLS = 15
"""Decisions on each state; their median counts."""


@jax.jit
def decided(policy: Policy, state: TableState, key: jax.Array) -> jax.Array:
    """Decide for one table, compiled once for all policies of a kind."""
    return policy.decide(state, key).action


def decision_times_ms(
    policies: Mapping[str, Policy], states: TableState, num_states: int
) -> dict[str, Float[np.ndarray, " S"]]:
    """Median time of a decision of each policy on each of the first states of a batch [ms]."""
    key = jax.random.key(0)
    singles = [jax.tree.map(lambda leaf, k=k: leaf[k], states) for k in range(num_states)]
    for policy in tqdm(policies.values(), desc="compile decisions", disable=None, leave=False):
        decided(policy, singles[0], key).block_until_ready()
    with one_core():
        times = [
            {name: _median_ms(policy, state, key) for name, policy in policies.items()}
            for state in tqdm(singles, desc="time decisions", disable=None, leave=False)
        ]
    return {name: np.array([of[name] for of in times]) for name in policies}


def _median_ms(policy: Policy, state: TableState, key: jax.Array) -> float:
    decided(policy, state, key).block_until_ready()
    taken = []
    for _ in range(NUM_CALLS):
        begin = time.perf_counter()
        decided(policy, state, key).block_until_ready()
        taken.append(time.perf_counter() - begin)
    return 1e3 * float(np.median(taken))


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
