"""One decision of one robot, and what happens until the next one.

A stage lasts from one decision to the next, whichever robot makes it. What a robot begins is drawn when it begins and
known when it ends: then the table changes, the camera looks, the reward falls, and robots that waited are free. Where
another robot is free at once, the stage takes no time, and nothing is looked at in it. One robot alone has one event a
stage, and nothing is pending.

A robot may drop out (battery, e-stop) while it is at something, waiting included; who has parked no longer does. What
it carried out is abandoned: its object stays where it was, nothing is paid, and the attempt is not counted. Robots that
waited are free, as after any event. Nothing is looked at: labels come with what was done, and nothing was, so that the
table stays as it was seen. What ends at the very moment of a drop-out ends before it.
"""

from dataclasses import replace

import numpy as np

from halfseen.arrays import Array, at, library_of
from halfseen.shapes import Float, Int
from halfseen.world import random
from halfseen.world.actions import ActionSpace, Verb, possible_actions
from halfseen.world.attempts import action_reward, after_attempt, attempted, is_target, look, price_of_left
from halfseen.world.config import WorldConfig
from halfseen.world.events import Outcome, step_of_several
from halfseen.world.random import Key
from halfseen.world.state import HiddenState, Layout, TableState, initial_state, nothing_pending, occlusion

_DROP_OUT_KEY = 29
"""Folded into the key of the start for the times of drop-outs, so that no other draw changes."""


def start(config: WorldConfig, layout: Layout, key: Key) -> tuple[TableState, HiddenState]:
    """Set tables: what is hidden is drawn, and the camera takes its first view; all robots are free."""
    hidden_key, see_key = random.split(key)
    state = initial_state(config, layout)
    hidden = draw_hidden(config, state.num_objects, hidden_key)
    if state.robots is not None:
        until_s = until_out_s(config, random.fold_in(key, _DROP_OUT_KEY))
        pending = nothing_pending(config.num_robots, state.is_object)
        hidden = replace(hidden, pending=pending, until_out_s=until_s)
    return look(config, state, hidden, library_of(state.is_object).zeros_like(state.is_object), see_key)


def draw_hidden(config: WorldConfig, num_objects: int, key: Key) -> HiddenState:
    """Draw attributes from the prior, and the traits of the laws."""
    dirty_key, grasp_key = random.split(key)
    return HiddenState(
        is_dirty=random.uniform(dirty_key, num_objects) < config.dirty_share,
        grasp_trait=config.grasping.draw_trait(num_objects, grasp_key),
        seeing_trait=config.seeing.draw_trait(num_objects, random.fold_in(key, 2)),
    )


def until_out_s(config: WorldConfig, key: Key) -> Float[Array, "*B K"] | None:
    """Draw until when each robot drops out, which knows nothing of what went before; None where nobody can [s]."""
    if config.drop_out_rate is None:
        return None
    xp = library_of(key)
    rate = xp.asarray(config.drop_out_rate, dtype=np.float32)
    survival = random.exponential(key, len(config.drop_out_rate))
    return xp.where(rate > 0.0, survival / xp.where(rate > 0.0, rate, np.float32(1.0)), np.float32(np.inf))


def step(
    config: WorldConfig,
    state: TableState,
    hidden: HiddenState,
    action: Int[Array, "*B"],
    key: Key,
    *,
    any_action: bool = False,
) -> tuple[TableState, HiddenState, Outcome]:
    """Let the robot that decides begin an action, and wait for the next decision.

    An attempt of one robot alone on what is not on the table closes on nothing: it fails, and takes as long as an
    attempt may.

    Parameters
    ----------
    config, state, hidden
        The world, and what is seen and hidden in it.
    action
        Of the robot that decides.
    key
        The only source of randomness.
    any_action
        Whether it may be one that is not possible for one of several robots: an attempt then closes on nothing, too,
        and a WAIT for nothing lasts as long as going home.

    Returns
    -------
    TableState
        What is seen then, and who decides.
    HiddenState
        What is hidden then: the laws may change their traits.
    Outcome
        What it brought.
    """
    if state.robots is None:
        return _step_of_one(config, state, hidden, action, key)
    is_possible = at(possible_actions(state), action) if any_action else None
    return step_of_several(config, state, hidden, action, key, is_possible)


def _step_of_one(
    config: WorldConfig, state: TableState, hidden: HiddenState, action: Int[Array, "*B"], key: Key
) -> tuple[TableState, HiddenState, Outcome]:
    xp, actions = library_of(action), ActionSpace(state.num_objects)
    grasp_key, see_key = random.split(key)
    verb, target = actions.verb(action), actions.target(action)
    occluded = occlusion(state)
    tried = attempted(config, state, hidden, verb, target, grasp_key, occluded)
    after = after_attempt(state, verb, target, tried, at(occluded, target))
    hidden = replace(hidden, grasp_trait=tried.trait)
    is_held = is_target(state, target) & (tried.is_held & (verb == Verb.LIFT))[..., None]
    after, hidden = look(config, after, hidden, is_held, see_key)
    ends = (verb == Verb.FINISH) | (after.steps_to_go == 0) | ~xp.any(after.is_on_table, axis=-1)
    duration_s = config.transport_s + tried.duration_s
    reward = action_reward(config, verb, tried.is_held, at(hidden.is_dirty, target), duration_s)
    reward = reward + price_of_left(config, after, hidden, ends)
    return after, hidden, Outcome(reward, duration_s, ends)
