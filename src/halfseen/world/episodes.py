"""Many tables played to their end, some hundreds in one compiled call."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Generic, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from halfseen.arrays import on_device
from halfseen.world.config import WorldConfig
from halfseen.world.dynamics import Outcome, start, step
from halfseen.world.policy import Decision, Policy
from halfseen.world.state import HiddenState, Layout, TableState

BATCH = 400
"""Paths that one compiled call plays: logs of all larger sizes share its program."""

Kept = TypeVar("Kept")
State = TypeVar("State")
Hidden = TypeVar("Hidden")


class Dynamics(NamedTuple):
    """How one table is set and how it goes on: of one robot, or of a team.

    The configuration that both take tells by `num_stages` how many decisions a path may have.
    """

    start: Callable[..., Any]
    """(config, layout, key) → state, hidden state."""
    step: Callable[..., Any]
    """(config, state, hidden, action, key) → state, hidden state, outcome."""


ONE_ROBOT = Dynamics(start, step)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Episodes(Generic[State, Hidden]):
    """Paths that nothing cut, stage by stage; `is_taken` is False after the path's own end."""

    states: State
    """S_t, axes (B, T)."""
    action: Int[Array, "*B T"]
    probability: Float[Array, "*B T"]
    """Of the logged action, under the policy that took it."""
    reward: Float[Array, "*B T"]
    duration_s: Float[Array, "*B T"]
    is_taken: Bool[Array, "*B T"]
    hidden: Hidden
    """As the table was set; for tests and oracles, it never reaches a log."""
    of_robots: Any = None
    """What each stage brought to each robot of a team; see `Outcome`."""

    @property
    def elapsed_s(self) -> Float[Array, "*B T"]:
        """U_t, the clock at the end of each stage [s]."""
        return jnp.cumsum(jnp.where(self.is_taken, self.duration_s, 0.0), axis=-1)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Totals:
    """What a policy earned on each of B tables."""

    reward: Float[Array, "*B"]
    robot_s: Float[Array, "*B"]
    """Robot time until the path's own end [s]."""
    num_steps: Int[Array, "*B"]


class _Stage(NamedTuple):
    """What happened in a stage, whether or not the path was already over."""

    state: Any
    decision: Decision
    outcome: Outcome
    is_taken: Bool[Array, "*B"]


def _play(
    config: Any, layout: Any, policy: Any, key: Array, keep: Callable[[_Stage], Kept], dynamics: Dynamics
) -> tuple[Kept, Any]:
    """Play one table to its end. World and policy draw from separate keys, so that policies meet the same world."""
    start_key, world_key, policy_key = jax.random.split(key, 3)
    state, hidden = dynamics.start(config, layout, start_key)

    def advance(carry: tuple[Any, Array], t: Array) -> tuple[tuple[Any, Array], Kept]:
        (state, hidden), is_active = carry
        decision = policy.decide(state, jax.random.fold_in(policy_key, t))
        *after, outcome = dynamics.step(config, state, hidden, decision.action, jax.random.fold_in(world_key, t))
        after = jax.tree.map(lambda new, old: jnp.where(is_active, new, old), tuple(after), (state, hidden))
        return (after, is_active & ~outcome.is_over), keep(_Stage(state, decision, outcome, is_active))

    _, kept = jax.lax.scan(advance, ((state, hidden), jnp.asarray(True)), jnp.arange(config.num_stages))
    return kept, hidden


def play(
    config: WorldConfig, layouts: Layout, policy: Policy, key: Array, num_episodes: int
) -> Episodes[TableState, HiddenState]:
    """Play `num_episodes` tables and record every stage; episode k uses layout k modulo their number."""
    return play_by(ONE_ROBOT, config, layouts, policy, key, num_episodes)


def play_by(
    dynamics: Dynamics, config: Any, layouts: Any, policy: Any, key: Array, num_episodes: int
) -> Episodes[Any, Any]:
    """`play` by any dynamics: configuration, layouts and policy are what these take."""
    size = max(1, min(num_episodes, BATCH))
    starts = range(0, max(1, num_episodes), size)
    batches = [_play_batch(dynamics, config, layouts, policy, key, jnp.asarray(first), size) for first in starts]
    if num_episodes == size:
        return batches[0]
    return jax.tree.map(lambda *leaves: on_device(np.concatenate(leaves)[:num_episodes]), *batches)


@partial(jax.jit, static_argnames=("dynamics", "size"))
def _play_batch(
    dynamics: Dynamics, config: Any, layouts: Any, policy: Any, key: Array, first: Int[Array, ""], size: int
) -> Episodes[Any, Any]:
    layout, keys = _spread(layouts, key, first + jnp.arange(size))
    play_one = partial(_play, keep=lambda stage: stage, dynamics=dynamics)
    stages, hidden = jax.vmap(play_one, in_axes=(None, 0, None, 0))(config, layout, policy, keys)
    return Episodes(
        states=stages.state,
        action=stages.decision.action,
        probability=stages.decision.probability,
        reward=stages.outcome.reward,
        duration_s=stages.outcome.duration_s,
        is_taken=stages.is_taken,
        hidden=hidden,
        of_robots=stages.outcome.of_robots,
    )


def evaluate(
    config: WorldConfig, layouts: Layout, policy: Policy, key: Array, num_episodes: int, batch_size: int | None = None
) -> Totals:
    """Play the tables that `play` would and keep only the totals.

    A policy that plans holds a tree for each table at once: `batch_size` bounds how many, and changes nothing else.
    """
    return evaluate_some(config, layouts, policy, key, jnp.arange(num_episodes), batch_size)


@partial(jax.jit, static_argnames=("batch_size", "dynamics"))
def evaluate_some(
    config: Any,
    layouts: Any,
    policy: Any,
    key: Array,
    episode: Int[Array, " B"],
    batch_size: int | None = None,
    dynamics: Dynamics = ONE_ROBOT,
) -> Totals:
    """Play some of the tables that `play` would, by number, and keep only the totals."""

    def totals(layout_and_key: tuple[Any, Array]) -> tuple[Array, Array, Array]:
        return _play(config, layout_and_key[0], policy, layout_and_key[1], _earned, dynamics)[0]

    inputs = _spread(layouts, key, episode)
    reward, duration_s, is_taken = jax.lax.map(totals, inputs, batch_size=batch_size or len(episode))
    return Totals(
        reward=jnp.sum(jnp.where(is_taken, reward, 0.0), axis=-1),
        robot_s=jnp.sum(jnp.where(is_taken, duration_s, 0.0), axis=-1),
        num_steps=jnp.sum(is_taken, axis=-1),
    )


def _earned(stage: _Stage) -> tuple[Array, Array, Array]:
    return stage.outcome.reward, stage.outcome.duration_s, stage.is_taken


def _spread(layouts: Any, key: Array, episode: Int[Array, " B"]) -> tuple[Any, Array]:
    layout = jax.tree.map(lambda leaf: leaf[episode % leaf.shape[0]], layouts)
    return layout, jax.vmap(partial(jax.random.fold_in, key))(episode)
