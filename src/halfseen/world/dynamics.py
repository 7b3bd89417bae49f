"""One step of one table: grasp, reward, see. Pure functions; `jax.vmap` makes them a batch."""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from halfseen.world.action_space import Verb, target_of, verb_of
from halfseen.world.config import WorldConfig
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


def grasp_scale_s(config: WorldConfig, occluded: Float[Array, "*#S"], grip_offset: Float[Array, "*#S"]) -> Array:
    """Mean time to grasp: exp(a + b·occ − u) [s]."""
    return jnp.exp(config.grasp_log_time + config.grasp_log_time_per_occlusion * occluded - grip_offset)


def grasp_probability(config: WorldConfig, occluded: Float[Array, "*#S"], grip_offset: Float[Array, "*#S"]) -> Array:
    """P(T ≤ τ | occ, u) = 1 − exp(−τ / scale)."""
    return -jnp.expm1(-config.attempt_limit_s / grasp_scale_s(config, occluded, grip_offset))


def label_accuracy(config: WorldConfig, occluded: Float[Array, "*S"]) -> Float[Array, "*S"]:
    """Probability that a label is right."""
    # exp and log, not a power: several times as fast where the planner asks for millions.
    return config.label_floor + config.label_gain * jnp.exp(config.label_power * jnp.log1p(-occluded))


def see(
    config: WorldConfig, state: TableState, hidden: HiddenState, held: Bool[Array, " N"], key: Array
) -> Float[Array, " N"]:
    """Label every object on the table once; return the new log-odds of DIRTY.

    An object in `held` is seen unoccluded and hides nothing.
    """
    occluded = jnp.where(held, 0.0, occlusion_without(state, held))
    accuracy = label_accuracy(config, occluded)
    is_right = jax.random.uniform(key, accuracy.shape) < accuracy
    says_dirty = hidden.is_dirty == is_right
    evidence = jnp.log(accuracy) - jnp.log1p(-accuracy)
    update = jnp.where(says_dirty, evidence, -evidence)
    return state.log_odds + jnp.where(state.is_on_table, update, 0.0)


def start(config: WorldConfig, layout: Layout, key: Array) -> tuple[TableState, HiddenState]:
    """Set one table: hidden attributes and offsets are drawn, and the camera takes its first view of it."""
    hidden_key, see_key = jax.random.split(key)
    state = initial_state(config, layout)
    hidden = draw_hidden(config, state.num_objects, hidden_key)
    log_odds = see(config, state, hidden, jnp.zeros_like(state.is_object), see_key)
    return replace(state, log_odds=log_odds), hidden


def step(
    config: WorldConfig, state: TableState, hidden: HiddenState, action: Int[Array, ""], key: Array
) -> tuple[TableState, Outcome]:
    """Carry out one possible action on one table.

    Returns the state after it and what it brought. The reward includes the price of the dirty objects left when the
    path ends, be it by FINISH or by the horizon.
    """
    grasp_key, see_key = jax.random.split(key)
    verb, target = verb_of(action, state.num_objects), target_of(action, state.num_objects)
    is_attempt = verb != Verb.FINISH
    is_target = (jnp.arange(state.num_objects) == target) & is_attempt
    occluded = occlusion(state)[target]
    grasp_s = jax.random.exponential(grasp_key) * grasp_scale_s(config, occluded, hidden.grip_offset[target])
    is_grasped = is_attempt & (grasp_s <= config.attempt_limit_s)
    duration_s = config.transport_s + jnp.where(is_attempt, jnp.minimum(grasp_s, config.attempt_limit_s), 0.0)

    after = _after_attempt(state, verb, target, is_target, is_grasped, occluded)
    is_held = is_target & is_grasped & (verb == Verb.LIFT)
    after = replace(after, log_odds=see(config, after, hidden, is_held, see_key))
    is_over = ~is_attempt | (after.steps_to_go == 0) | ~jnp.any(after.is_on_table)
    dirty_left = jnp.sum(after.is_on_table & hidden.is_dirty)
    reward = _action_reward(config, verb, is_grasped, hidden.is_dirty[target], duration_s)
    reward = reward + jnp.where(is_over, config.reward_dirty_left * dirty_left, 0.0)
    return after, Outcome(reward, duration_s, is_over)


def _action_reward(
    config: WorldConfig,
    verb: Int[Array, ""],
    is_grasped: Bool[Array, ""],
    is_dirty: Bool[Array, ""],
    duration_s: Float[Array, ""],
) -> Float[Array, ""]:
    washed = jnp.where(is_dirty, config.reward_wash_dirty, config.reward_wash_clean)
    wash = jnp.where(is_grasped, washed, config.reward_wash_failed)
    return jnp.select([verb == Verb.WASH, verb == Verb.LIFT], [wash, config.reward_lift_per_s * duration_s], 0.0)


def _after_attempt(
    state: TableState,
    verb: Int[Array, ""],
    target: Int[Array, ""],
    is_target: Bool[Array, " N"],
    is_grasped: Bool[Array, ""],
    occluded: Float[Array, ""],
) -> TableState:
    now = state.horizon - state.steps_to_go
    return replace(
        state,
        is_on_table=state.is_on_table & ~(is_target & is_grasped & (verb == Verb.WASH)),
        lifts=state.lifts + (is_target & is_grasped & (verb == Verb.LIFT)),
        attempt_object=state.attempt_object.at[now].set(jnp.where(verb == Verb.FINISH, NO_ATTEMPT, target)),
        attempt_occlusion=state.attempt_occlusion.at[now].set(occluded),
        attempt_succeeded=state.attempt_succeeded.at[now].set(is_grasped),
        steps_to_go=state.steps_to_go - 1,
    )
