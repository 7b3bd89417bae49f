"""One step of one table: attempt, reward, look. Pure functions; `jax.vmap` makes them a batch."""

from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from halfseen.world.action_space import ActionSpace, Verb
from halfseen.world.config import WorldConfig
from halfseen.world.grasping import Arrangement, Attempt
from halfseen.world.seeing import Glimpse
from halfseen.world.state import (
    NO_ATTEMPT,
    HiddenState,
    Layout,
    TableState,
    draw_hidden,
    initial_state,
    occlusion,
    occlusion_without,
)


class Outcome(NamedTuple):
    """What one action brought."""

    reward: Float[Array, "*B"]
    duration_s: Float[Array, "*B"]
    """Time that the action took [s]; always positive."""
    is_over: Bool[Array, "*B"]
    """Whether the path has come to its own end."""
    of_robots: Any = None
    """What it brought to each robot of a team; nothing more where there is one."""


def look(
    config: WorldConfig, state: TableState, hidden: HiddenState, held: Bool[Array, " N"], key: Array
) -> tuple[TableState, HiddenState]:
    """Look at every object on the table once, as the law of seeing has it.

    An object in `held` is seen unoccluded and hides nothing.
    """
    is_seen = state.is_on_table
    glimpse = Glimpse(is_seen, jnp.where(held, 0.0, occlusion_without(state, held)), held, state.seen)
    told = config.seeing.look(glimpse, state.log_odds, hidden.is_dirty, hidden.seeing_trait, key)
    log_odds = jnp.where(is_seen, told.log_odds, state.log_odds)
    seen = jnp.where(is_seen, told.seen, state.seen)
    return replace(state, log_odds=log_odds, seen=seen), replace(hidden, seeing_trait=told.trait)


def start(config: WorldConfig, layout: Layout, key: Array) -> tuple[TableState, HiddenState]:
    """Set one table: what is hidden is drawn, and the camera takes its first view of it."""
    hidden_key, see_key = jax.random.split(key)
    state = initial_state(config, layout)
    hidden = draw_hidden(config, state.num_objects, hidden_key)
    return look(config, state, hidden, jnp.zeros_like(state.is_object), see_key)


def step(
    config: WorldConfig, state: TableState, hidden: HiddenState, action: Int[Array, ""], key: Array
) -> tuple[TableState, HiddenState, Outcome]:
    """Carry out one action on one table.

    An attempt on what is not on the table closes on nothing: it fails, and takes as long as an attempt may.

    Returns
    -------
    TableState
        What is seen after it.
    HiddenState
        What is hidden after it: the laws may change their traits.
    Outcome
        What it brought. The reward includes the price of the dirty objects left when the path ends, be it by FINISH or
        by the horizon.
    """
    grasp_key, see_key = jax.random.split(key)
    actions = ActionSpace(state.num_objects)
    verb, target = actions.verb(action), actions.target(action)
    tried = attempted(config, state, hidden, verb, target, grasp_key)
    after = after_attempt(state, verb, target, tried, occlusion(state)[target])
    hidden = replace(hidden, grasp_trait=tried.trait)
    is_held = (jnp.arange(state.num_objects) == target) & tried.is_held & (verb == Verb.LIFT)
    after, hidden = look(config, after, hidden, is_held, see_key)
    is_over = (verb == Verb.FINISH) | (after.steps_to_go == 0) | ~jnp.any(after.is_on_table)
    dirty_left = jnp.sum(after.is_on_table & hidden.is_dirty)
    duration_s = config.transport_s + tried.duration_s
    reward = action_reward(config, verb, tried.is_held, hidden.is_dirty[target], duration_s)
    reward = reward + jnp.where(is_over, config.reward_dirty_left * dirty_left, 0.0)
    return after, hidden, Outcome(reward, duration_s, is_over)


def attempted(
    config: WorldConfig,
    state: TableState,
    hidden: HiddenState,
    verb: Int[Array, ""],
    target: Int[Array, ""],
    key: Array,
) -> Attempt:
    """How the attempt went; it changes nothing where there is none, or none is possible."""
    law, is_attempt, is_there = config.grasping, verb != Verb.FINISH, state.is_on_table[target]
    table = Arrangement(state.hides, state.is_on_table, occlusion(state), state.grip)
    tried = law.attempt(table, hidden.grasp_trait, verb, target, key)
    is_real = is_attempt & is_there
    return Attempt(
        is_held=is_real & tried.is_held,
        duration_s=jnp.where(is_attempt, jnp.where(is_there, tried.duration_s, law.limit_s), 0.0),
        hides=jnp.where(is_real, tried.hides, state.hides),
        trait=jax.tree.map(lambda new, old: jnp.where(is_real, new, old), tried.trait, hidden.grasp_trait),
    )


def action_reward(
    config: WorldConfig,
    verb: Int[Array, ""],
    is_grasped: Bool[Array, ""],
    is_dirty: Bool[Array, ""],
    duration_s: Float[Array, ""],
) -> Float[Array, ""]:
    """What an action pays by itself, without what is left when the path ends."""
    washed = jnp.where(is_dirty, config.reward_wash_dirty, config.reward_wash_clean)
    wash = jnp.where(is_grasped, washed, config.reward_wash_failed)
    return jnp.select([verb == Verb.WASH, verb == Verb.LIFT], [wash, config.reward_lift_per_s * duration_s], 0.0)


def after_attempt(
    state: TableState, verb: Int[Array, ""], target: Int[Array, ""], tried: Attempt, occlusion_then: Float[Array, ""]
) -> TableState:
    """What is seen of the table once an attempt is over, before the camera looks; its object was hidden so far then."""
    now = state.horizon - state.steps_to_go
    is_grasped = (jnp.arange(state.num_objects) == target) & tried.is_held
    return replace(
        state,
        hides=tried.hides,
        is_on_table=state.is_on_table & ~(is_grasped & (verb == Verb.WASH)),
        lifts=state.lifts + (is_grasped & (verb == Verb.LIFT)),
        attempt_object=state.attempt_object.at[now].set(jnp.where(verb == Verb.FINISH, NO_ATTEMPT, target)),
        attempt_occlusion=state.attempt_occlusion.at[now].set(occlusion_then),
        attempt_succeeded=state.attempt_succeeded.at[now].set(tried.is_held),
        steps_to_go=state.steps_to_go - 1,
    )
