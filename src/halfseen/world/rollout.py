"""Simulation of many tables to their end."""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np

from halfseen.arrays import Array, Tree, chosen, library_of, mapped, record, stacked
from halfseen.shapes import Bool, Float, Int
from halfseen.world import random
from halfseen.world.config import WorldConfig
from halfseen.world.policy import Policy, PolicyDraw
from halfseen.world.random import Key
from halfseen.world.state import HiddenState, Layout, TableState
from halfseen.world.transition import Outcome, start, step

BATCH = 512
"""Number of tables played at once, whose arrays stay in the cache of a core. It does not change the results."""
SIDE_BY_SIDE = 2048
"""Approximate number of tables of several policies played at once. It does not change the results."""


@record
class Episodes:
    """Uncut trajectories, stage by stage; `is_taken` is False after a trajectory's own end."""

    states: TableState
    """S_t, axes (B, T)."""
    action: Int[Array, "*B T"]
    probability: Float[Array, "*B T"]
    """Propensity of the logged action under the behaviour policy."""
    reward: Float[Array, "*B T"]
    duration_s: Float[Array, "*B T"]
    is_taken: Bool[Array, "*B T"]
    hidden: HiddenState
    """Initial hidden state, for tests and oracles; it never enters a log."""
    paid_alone: Float[Array, "*B T K"] | None = None
    out_s: Float[Array, "*B T K"] | None = None
    """As in `Outcome`."""

    @property
    def elapsed_s(self) -> Float[Array, "*B T"]:
        """U_t, the clock at the end of each stage [s]."""
        xp = library_of(self.is_taken)
        return xp.cumsum(xp.where(self.is_taken, self.duration_s, np.float32(0.0)), axis=-1)


@record
class Totals:
    """Total reward of a policy on each of B tables, with duration and number of steps."""

    reward: Float[Array, "*B"]
    robot_s: Float[Array, "*B"]
    """The table's clock at the trajectory's own end [s]."""
    num_steps: Int[Array, "*B"]


class Stage(NamedTuple):
    """Record of a stage, even if the trajectory was already over."""

    state: TableState
    decision: PolicyDraw
    outcome: Outcome
    is_taken: Bool[Array, "*B"]


def play(config: WorldConfig, layouts: Layout, policy: Policy, key: Key, num_episodes: int) -> Episodes:
    """Play tables and record every stage; episode k uses layout k modulo the number of layouts."""
    return in_parts(_recorded, config, layouts, policy, key, np.arange(num_episodes))


def evaluate(config: WorldConfig, layouts: Layout, policy: Policy, key: Key, num_episodes: int) -> Totals:
    """Play the same tables as `play`, but keep only the totals."""
    return evaluate_some(config, layouts, policy, key, np.arange(num_episodes))


def evaluate_some(config: WorldConfig, layouts: Layout, policy: Policy, key: Key, episode: Int[Array, " B"]) -> Totals:
    """Play some of the tables of `play`, by number, and keep only the totals."""
    return in_parts(_totals, config, layouts, policy, key, episode)


def evaluate_each(
    config: WorldConfig, layouts: Layout, policies: Sequence[Policy], key: Key, num_episodes: int
) -> list[Totals]:
    """Result of `evaluate` for each policy; playing them side by side is faster than one after another."""
    return side_by_side(_totals, config, layouts, policies, key, np.arange(num_episodes))


Measure: TypeAlias = Callable[[WorldConfig, Layout, Policy, Key, Int[Array, " B"]], Tree]
"""Plays some tables, by number, and returns a record with leading axis B."""


def in_parts(
    measure: Measure[Tree], config: WorldConfig, layouts: Layout, policy: Policy, key: Key, episode: Int[Array, " B"]
) -> Tree:
    """Apply a measure to a policy on tables, by number, in parts."""
    starts = range(0, max(len(episode), 1), BATCH)
    return _joined([measure(config, layouts, policy, key, episode[k : k + BATCH]) for k in starts])


def side_by_side(
    measure: Measure[Tree],
    config: WorldConfig,
    layouts: Layout,
    policies: Sequence[Policy],
    key: Key,
    episode: Int[Array, " B"],
) -> list[Tree]:
    """Apply a measure to several policies on the same tables, played side by side."""
    num, found = len(episode), []
    size = max(1, SIDE_BY_SIDE // max(num, 1))
    for first in range(0, len(policies), size):
        some = policies[first : first + size]
        together = measure(config, layouts, _SideBySide(some), key, np.tile(episode, len(some)))
        parts = (slice(k * num, (k + 1) * num) for k in range(len(some)))
        found += [mapped(lambda leaf, at=at: leaf[at], together) for at in parts]
    return found


def _joined(parts: list[Tree]) -> Tree:
    return mapped(lambda *leaves: library_of(*leaves).concatenate(leaves), *parts)


class _SideBySide:
    """Each policy decides for its own part of a batch; all parts have the same size."""

    def __init__(self, policies: Sequence[Policy]) -> None:
        self._policies = policies

    def decide(self, state: TableState, key: Key) -> PolicyDraw:
        """Let each policy choose for its part."""
        size = len(key) // len(self._policies)
        parts = [slice(k * size, (k + 1) * size) for k in range(len(self._policies))]
        each = [
            policy.decide(mapped(lambda leaf, at=at: leaf[at], state), key[at])
            for policy, at in zip(self._policies, parts, strict=True)
        ]
        return _joined(each)


def stages_of_play(
    config: WorldConfig, layouts: Layout, policy: Policy, key: Key, episode: Int[Array, " B"]
) -> tuple[HiddenState, Iterator[Stage]]:
    """Set some tables, by number, and play them stage by stage until all are over.

    World and policy draw from separate keys, so that all policies meet the same world.
    """
    layout, keys = mapped(lambda leaf: leaf[episode % len(leaf)], layouts), random.fold_in(key, episode)
    start_key, world_key, policy_key = random.split(keys, 3)
    state, hidden = start(config, layout, start_key)
    return hidden, _played(config, state, hidden, policy, world_key, policy_key)


def _played(
    config: WorldConfig, state: TableState, hidden: HiddenState, policy: Policy, world_key: Key, policy_key: Key
) -> Iterator[Stage]:
    xp = library_of(state.is_on_table, world_key)
    is_active = xp.ones(state.steps_to_go.shape, dtype=bool)
    for t in range(config.num_stages):
        if xp is np and not is_active.any():
            return
        decision = policy.decide(state, random.fold_in(policy_key, t))
        after, of_hidden, outcome = step(config, state, hidden, decision.action, random.fold_in(world_key, t))
        yield Stage(state, decision, outcome, is_active)
        state, hidden = chosen(is_active, (after, of_hidden), (state, hidden))
        is_active = is_active & ~outcome.is_over


def _recorded(
    config: WorldConfig, layouts: Layout, policy: Policy, key: Key, episode: Int[np.ndarray, " B"]
) -> Episodes:
    hidden, played = stages_of_play(config, layouts, policy, key, episode)
    stages = list(played)
    # Once all are over, the last stage fills the rest of the horizon.
    over = stages[-1]._replace(is_taken=library_of(stages[-1].is_taken).zeros_like(stages[-1].is_taken))
    stages += [over] * (config.num_stages - len(stages))
    all_stages = stacked(stages, axis=1)
    outcome = all_stages.outcome
    return Episodes(
        states=all_stages.state,
        action=all_stages.decision.action,
        probability=all_stages.decision.probability,
        reward=outcome.reward,
        duration_s=outcome.duration_s,
        is_taken=all_stages.is_taken,
        hidden=hidden,
        paid_alone=outcome.paid_alone,
        out_s=outcome.out_s,
    )


def _totals(config: WorldConfig, layouts: Layout, policy: Policy, key: Key, episode: Int[Array, " B"]) -> Totals:
    _, stages = stages_of_play(config, layouts, policy, key, episode)
    xp, zero, taken = library_of(layouts.is_object, key), np.float32(0.0), []
    for stage in stages:
        reward, duration_s = (xp.where(stage.is_taken, each, zero) for each in stage.outcome[:2])
        taken.append((reward, duration_s, stage.is_taken.astype(np.int32)))
    return Totals(*(sum(each) for each in zip(*taken, strict=True)))
