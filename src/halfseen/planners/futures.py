"""Futures of a table, by the dynamics of one robot or of a team: what is hidden is drawn from the belief, then played.

Where `rollout` moves a belief, a future here moves the world itself, so that all that the dynamics know (robots, times,
prices) counts. Nothing that is truly hidden is read: attributes and grips are drawn as `belief` has them, and labels by
their probabilities given what is known.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from halfseen.planners.belief import grip_posterior, known_seeing, trait_at
from halfseen.world.config import WorldConfig
from halfseen.world.episodes import Dynamics
from halfseen.world.seeing import Glimpse, KnownSeeing, Told, label_evidence
from halfseen.world.state import HiddenState, TableState


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ForeseenSeeing:
    """Labels by the probabilities of a law, given the truth and what is known: no hidden trait is needed.

    Parameters
    ----------
    law
        Whose labels they are.
    """

    law: KnownSeeing

    def draw_trait(self, num_objects: int, key: Array) -> None:
        """No trait: what persists is in `Glimpse.seen`."""
        return

    def look(
        self, glimpse: Glimpse, log_odds: Float[Array, " N"], is_dirty: Bool[Array, " N"], trait: None, key: Array
    ) -> Told:
        """Label each object once."""
        if_dirty, if_clean = self.law.positive(glimpse.occluded, glimpse.seen, glimpse.is_held)
        says_dirty = jax.random.uniform(key, is_dirty.shape) < jnp.where(is_dirty, if_dirty, if_clean)
        seen = self.law.after(glimpse.occluded, glimpse.seen, says_dirty, glimpse.is_held)
        return Told(log_odds + label_evidence(if_dirty, if_clean, says_dirty), seen, None)


def foreseen(config: WorldConfig) -> WorldConfig:
    """The world in which futures are played: its labels come from what is known."""
    return replace(config, seeing=ForeseenSeeing(known_seeing(config)))


def imagined(config: WorldConfig, state: TableState, key: Array) -> HiddenState:
    """Draw what is hidden of one table, given all that is seen."""
    dirty_key, grip_key = jax.random.split(key)
    is_dirty = jax.random.uniform(dirty_key, state.log_odds.shape) < jax.nn.sigmoid(state.log_odds)
    node = jax.random.categorical(grip_key, grip_posterior(config, state).log_weights, axis=-1)
    return HiddenState(is_dirty, trait_at(config, node), None)


@dataclass(frozen=True)
class KnownRewards:
    """Rewards expected given what is seen in a future, in place of those that depend on hidden attributes.

    Whether an attempt holds tells nothing of DIRTY, so that a stage's rewards are expected to be the same: only their
    noise falls (Rao–Blackwell).

    Parameters
    ----------
    world
        The world.
    table_of
        Takes the table out of a state, and what is hidden of it out of a hidden state.
    """

    world: WorldConfig
    table_of: Callable[[Any], Any]

    def less_luck(self, before: Any, after: Any, hidden: Any, is_over: Bool[Array, ""]) -> Float[Array, ""]:
        """What is to be added to the reward of a stage that led from one state to another."""
        was, now, is_dirty = self.table_of(before), self.table_of(after), self.table_of(hidden).is_dirty
        washed = self.world.reward_wash_dirty - self.world.reward_wash_clean
        is_washed, is_left = was.is_on_table & ~now.is_on_table, now.is_on_table & is_over
        of_washed = jnp.sum(jnp.where(is_washed, jax.nn.sigmoid(was.log_odds) - is_dirty, 0.0))
        of_left = jnp.sum(jnp.where(is_left, jax.nn.sigmoid(now.log_odds) - is_dirty, 0.0))
        return washed * of_washed + self.world.reward_dirty_left * of_left


def future_rewards(
    dynamics: Dynamics,
    config: Any,
    state: Any,
    is_possible: Bool[Array, " A"],
    imagine: Callable[[Array], Any],
    policy: Any,
    key: Array,
    num_futures: int,
    rewards: KnownRewards,
) -> Float[Array, "S A"]:
    """Reward to the path's end of each action followed by a policy, in each of S futures; −∞ where it is impossible.

    All actions meet the same hidden truth and the same draws.

    Parameters
    ----------
    dynamics
        Of one robot or of a team.
    config
        As `dynamics` takes it, with a world that is `foreseen`.
    state
        Of one table.
    is_possible
        Which actions are tried.
    imagine
        Draws what is hidden from a key.
    policy
        What decides ever after.
    key
        What is drawn from.
    num_futures
        S.
    rewards
        What takes the luck of attributes out of what a future earns.
    """
    keys = jax.random.split(key, num_futures)

    def futures(action: Int[Array, ""]) -> Float[Array, " S"]:
        return jax.vmap(lambda key: _future_reward(dynamics, config, state, action, imagine, policy, key, rewards))(
            keys
        )

    def tried(action: Int[Array, ""]) -> Float[Array, " S"]:
        nothing = jnp.full(num_futures, -jnp.inf, dtype=jnp.float32)
        return jax.lax.cond(is_possible[action], futures, lambda _: nothing, action)

    # One action after the other: what is impossible costs nothing, and memory stays small.
    return jax.lax.map(tried, jnp.arange(is_possible.shape[0], dtype=jnp.int32)).T


def _future_reward(
    dynamics: Dynamics,
    config: Any,
    state: Any,
    action: Int[Array, ""],
    imagine: Callable[[Array], Any],
    policy: Any,
    key: Array,
    rewards: KnownRewards,
) -> Float[Array, ""]:
    hidden_key, world_key, policy_key = jax.random.split(key, 3)

    def goes_on(carry: tuple[Any, ...]) -> Array:
        return ~carry[3]

    def advance(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        state, hidden, action, _, total, t = carry
        before = state
        state, hidden, outcome = dynamics.step(config, state, hidden, action, jax.random.fold_in(world_key, t))
        reward = outcome.reward + rewards.less_luck(before, state, hidden, outcome.is_over)
        action = policy.decide(state, jax.random.fold_in(policy_key, t)).action.astype(action.dtype)
        return state, hidden, action, outcome.is_over, total + reward, t + 1

    begin = state, imagine(hidden_key), action, jnp.asarray(False), jnp.zeros(()), jnp.asarray(0)
    return jax.lax.while_loop(goes_on, advance, begin)[4]
