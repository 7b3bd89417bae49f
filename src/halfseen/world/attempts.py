"""The parts of every transition: one attempt, its reward, and the look that follows."""

from dataclasses import replace

import numpy as np

from halfseen.arrays import Amounts, Array, Flags, Which, at, chosen, library_of
from halfseen.shapes import Bool, Float
from halfseen.world.actions import Verb
from halfseen.world.config import WorldConfig
from halfseen.world.grasping import Arrangement, Attempt
from halfseen.world.random import Key
from halfseen.world.seeing import Glimpse
from halfseen.world.state import NO_ATTEMPT, HiddenState, TableState, numbered, occlusion_by


def is_target(state: TableState, target: Which) -> Bool[Array, "*B N"]:
    """One-hot mask of an action's target."""
    return numbered(target, state.num_objects)


def attempted(
    config: WorldConfig,
    state: TableState,
    hidden: HiddenState,
    verb: Which,
    target: Which,
    key: Key,
    occluded: Float[Array, "*B N"],
) -> Attempt:
    """Draw the outcome of an attempt; it changes nothing for FINISH or if the target is not on the table."""
    xp, law = library_of(verb), config.grasping
    is_attempt, is_there = verb != Verb.FINISH, at(state.is_on_table, target)
    tried = law.attempt(
        Arrangement(state.hides, state.is_on_table, occluded, state.grip), hidden.grasp_latent, verb, target, key
    )
    is_real = is_attempt & is_there
    duration_s = xp.where(is_attempt, xp.where(is_there, tried.duration_s, law.limit_s), 0.0)
    return Attempt(
        is_held=is_real & tried.is_held,
        duration_s=duration_s.astype(np.float32),
        hides=chosen(is_real, tried.hides, state.hides),
        latent=chosen(is_real, tried.latent, hidden.grasp_latent),
    )


def action_reward(config: WorldConfig, verb: Which, is_grasped: Flags, is_dirty: Flags, duration_s: Amounts) -> Amounts:
    """Reward of an action, without the penalty for dirty objects left at the end."""
    xp = library_of(verb)
    washed = xp.where(is_dirty, config.reward_wash_dirty, config.reward_wash_clean)
    wash = xp.where(is_grasped, washed, config.reward_wash_failed)
    lift = xp.where(verb == Verb.LIFT, config.reward_lift_per_s * duration_s, np.float32(0.0))
    return xp.where(verb == Verb.WASH, wash, lift).astype(np.float32)


def price_of_left(config: WorldConfig, state: TableState, hidden: HiddenState, ends: Flags) -> Amounts:
    """Penalty for dirty objects left on the table, where the trajectory ends."""
    xp = library_of(ends)
    dirty_left = xp.sum(state.is_on_table & hidden.is_dirty, axis=-1).astype(np.float32)
    return xp.where(ends, config.reward_dirty_left * dirty_left, np.float32(0.0))


def after_attempt(
    state: TableState, verb: Which, target: Which, tried: Attempt, occlusion_then: Amounts, robot: Which | None = None
) -> TableState:
    """State after an attempt, before the next look; `occlusion_then` is the target's occlusion at its begin."""
    xp, by = library_of(verb), state.attempt_robot
    is_now = numbered(state.horizon - state.steps_to_go, state.horizon)
    is_grasped = is_target(state, target) & tried.is_held[..., None]
    was_object = xp.where(verb == Verb.FINISH, NO_ATTEMPT, target)[..., None]
    if by is not None and robot is not None:
        by = xp.where(is_now, robot[..., None], by).astype(np.int32)
    return replace(
        state,
        hides=tried.hides,
        is_on_table=state.is_on_table & ~(is_grasped & (verb == Verb.WASH)[..., None]),
        lifts=(state.lifts + (is_grasped & (verb == Verb.LIFT)[..., None])).astype(np.int32),
        attempt_object=xp.where(is_now, was_object, state.attempt_object).astype(np.int32),
        attempt_occlusion=xp.where(is_now, occlusion_then[..., None], state.attempt_occlusion),
        attempt_succeeded=xp.where(is_now, tried.is_held[..., None], state.attempt_succeeded),
        attempt_robot=by,
        steps_to_go=state.steps_to_go - np.int32(1),
    )


def look(
    config: WorldConfig, state: TableState, hidden: HiddenState, held: Bool[Array, "*B N"], key: Key
) -> tuple[TableState, HiddenState]:
    """Look at every object on the table once, by the law of seeing.

    An object in `held` is seen unoccluded and hides nothing.
    """
    xp, is_seen = library_of(held), state.is_on_table
    occluded = xp.where(held, np.float32(0.0), occlusion_by(state.hides, is_seen & ~held))
    looked = config.seeing.look(
        Glimpse(is_seen, occluded, held, state.seen), state.log_odds, hidden.is_dirty, hidden.seeing_latent, key
    )
    log_odds = xp.asarray(xp.where(is_seen, looked.log_odds, state.log_odds), dtype=np.float32)
    seen = state.seen
    if looked.seen is not seen:
        seen = xp.asarray(xp.where(is_seen, looked.seen, seen), dtype=np.float32)
    return replace(state, log_odds=log_odds, seen=seen), replace(hidden, seeing_latent=looked.latent)
