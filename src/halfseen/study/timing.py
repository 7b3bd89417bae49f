"""How long one decision takes on this machine."""

import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path

import numpy as np

from halfseen.arrays import mapped
from halfseen.shapes import Float
from halfseen.study.pipeline import Source
from halfseen.study.policies import FITTED_RULE, STRONGEST_RULE, Contender, Kind
from halfseen.study.setting import Setting
from halfseen.tables.assisted import AssistedPolicy, Excess
from halfseen.tables.features import NUM_FEATURES
from halfseen.tables.policy import LinearTablePolicy
from halfseen.world import random
from halfseen.world.actions import Verb
from halfseen.world.policy import Policy
from halfseen.world.state import TableState

MOST_TIMED_S = 0.25
"""Time that is spent on timing one policy, but for its last decision [s]."""
FEWEST_TIMED = 3


def decision_times_ms(
    policies: Mapping[str, Policy], states: Sequence[TableState]
) -> dict[str, Float[np.ndarray, " S"]]:
    """Time of a decision of each policy, on one core [ms].

    Each decides once on each state, the policies in turn, so that what slows the machine slows them alike; a policy
    stops once `MOST_TIMED_S` are spent on it.
    """
    key = random.key_of(0)
    times: dict[str, list[float]] = {name: [] for name in policies}
    with one_core():
        for state in states:
            for name, policy in policies.items():
                if sum(times[name]) < 1e3 * MOST_TIMED_S or len(times[name]) < FEWEST_TIMED:
                    times[name].append(1e3 * seconds(partial(policy.decide, state, key)))
    return {name: np.array(values) for name, values in times.items()}


def measured_times(setting: Setting, contenders: Iterable[Contender], num_states: int, laws: bool) -> dict[str, float]:
    """Median decision time of contenders [ms], on one state of each of many trajectories, early and late ones in turn.

    `laws` are those of the learned policy.
    """
    episodes = Source.of(setting).play(num_states)
    num_stages = np.asarray(episodes.is_taken).sum(axis=1)
    states = [mapped(lambda leaf, k=k: leaf[k, k % num_stages[k]], episodes.states) for k in range(num_states)]
    times = decision_times_ms({each.name: _timed_policy(setting, each, laws) for each in contenders}, states)
    return {name: float(np.median(values)) for name, values in times.items()}


def _timed_policy(setting: Setting, who: Contender, laws: bool) -> Policy:
    # The time of a decision does not depend on what was learned, or what laws are.
    world = setting.world
    if who.kind == Kind.LEARNED and laws:
        return AssistedPolicy(world, None, Excess.none(world.horizon))
    if who.kind in (Kind.LEARNED, Kind.LINEAR):
        return LinearTablePolicy(np.zeros((world.horizon, len(Verb), NUM_FEATURES + 1), dtype=np.float32))
    return STRONGEST_RULE.policy(world) if who == FITTED_RULE else who.policy(world)


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
        with suppress(ProcessLookupError):  # the thread has just ended
            os.sched_setaffinity(int(thread.name), cores)
