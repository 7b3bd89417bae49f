"""The transition: one decision of one robot, and all events until the next decision.

A stage lasts from one decision to the next, whichever robot makes it. The outcome of an action is drawn when it begins
and revealed when it ends: then the table changes, the camera looks, the reward is paid, and waiting robots become free.
If another robot is free at once, the stage takes no time and has no look. A single robot has one event per stage, and
nothing is pending.

A robot may drop out (battery, e-stop) while it carries out an action, WAIT included, but not once it is parked. Its
action is abandoned: the object stays in place, nothing is paid, and the attempt is not counted. Waiting robots become
free, as after any event. There is no look, since labels only follow completed actions, so the observed table does not
change. An action that ends at the very moment of a drop-out ends before it.
"""

from dataclasses import replace
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from halfseen.arrays import Amounts, Array, Flags, Which, at, chosen, library_of
from halfseen.shapes import Bool, Float
from halfseen.world import random
from halfseen.world.actions import WAIT, ActionSpace, Verb, possible_actions
from halfseen.world.attempts import action_reward, after_attempt, attempted, is_target, look, price_of_left
from halfseen.world.config import WorldConfig
from halfseen.world.grasping import Attempt
from halfseen.world.random import Key
from halfseen.world.state import (
    HiddenState,
    Layout,
    Pending,
    Robots,
    TableState,
    initial_state,
    nothing_pending,
    numbered,
    occlusion,
)

_DROP_OUT_KEY = 29
"""Folded into the start key for the drop-out times, so that other draws do not change."""


class Outcome(NamedTuple):
    """Outcome of one stage."""

    reward: Amounts
    """Includes the price of its seconds and, if the trajectory ends, the penalty for dirty objects left."""
    duration_s: Amounts
    """Positive, except if several robots are free at once [s]."""
    is_over: Flags
    """Whether the trajectory has come to its own end."""
    paid_alone: Float[Array, "*B K"] | None = None
    """Reward of the stage for each robot of a team had it been alone: its own attempts that ended, the price of its
    seconds until its own end, and then the penalty for dirty objects left in its reach; None for a single robot."""
    out_s: Float[Array, "*B K"] | None = None
    """Time from the stage's begin to each robot's drop-out, infinite without one; None if no robot can drop out [s]."""


Stepped: TypeAlias = tuple[TableState, HiddenState, Outcome]
Paid: TypeAlias = tuple[TableState, HiddenState, Amounts]
"""Observed and hidden state afterwards, and a reward."""


def start(config: WorldConfig, layout: Layout, key: Key) -> tuple[TableState, HiddenState]:
    """Set tables: draw the hidden state and take the camera's first look; all robots are free."""
    hidden_key, see_key = random.split(key)
    state = initial_state(config, layout)
    dirty_key, grasp_key = random.split(hidden_key)
    hidden = HiddenState(
        is_dirty=random.uniform(dirty_key, state.num_objects) < config.dirty_share,
        grasp_latent=config.grasping.draw_latent(state.num_objects, grasp_key),
        seeing_latent=config.seeing.draw_latent(state.num_objects, random.fold_in(hidden_key, 2)),
    )
    if state.robots is not None:
        until_s = until_out_s(config, random.fold_in(key, _DROP_OUT_KEY))
        pending = nothing_pending(config.num_robots, state.is_object)
        hidden = replace(hidden, pending=pending, until_out_s=until_s)
    return look(config, state, hidden, library_of(state.is_object).zeros_like(state.is_object), see_key)


def until_out_s(config: WorldConfig, key: Key) -> Float[Array, "*B K"] | None:
    """Draw the time until each robot drops out, which is memoryless; None if no robot can [s]."""
    if config.drop_out_rate is None:
        return None
    xp = library_of(key)
    rate = xp.asarray(config.drop_out_rate, dtype=np.float32)
    survival = random.exponential(key, len(config.drop_out_rate))
    return xp.where(rate > 0.0, survival / xp.where(rate > 0.0, rate, np.float32(1.0)), np.float32(np.inf))


def step(
    config: WorldConfig, state: TableState, hidden: HiddenState, action: Which, key: Key, *, any_action: bool = False
) -> Stepped:
    """Let the deciding robot begin an action, and advance to the next decision.

    An attempt of a single robot on an object that is not on the table closes on nothing: it fails, and takes the
    longest time of an attempt.

    Parameters
    ----------
    config, state, hidden
        The world, with its observed and hidden state.
    action
        Action of the deciding robot.
    key
        The only source of randomness.
    any_action
        Whether a robot of a team may take an impossible action: an attempt then closes on nothing, and a WAIT for
        nothing lasts as long as going home.

    Returns
    -------
    TableState
        The next observed state, with the next deciding robot.
    HiddenState
        The next hidden state; the laws may change their latents.
    Outcome
        The outcome of the stage.
    """
    if state.robots is None:
        return _step_alone(config, state, hidden, action, key)
    is_possible = at(possible_actions(state), action) if any_action else None
    return _step_of_several(config, state, hidden, action, key, is_possible)


def _step_alone(config: WorldConfig, state: TableState, hidden: HiddenState, action: Which, key: Key) -> Stepped:
    """One step of a single robot: its action ends without other events."""
    xp, actions = library_of(action), ActionSpace(state.num_objects)
    grasp_key, see_key = random.split(key)
    verb, target, occluded = actions.verb(action), actions.target(action), occlusion(state)
    tried = attempted(config, state, hidden, verb, target, grasp_key, occluded)
    tried = tried._replace(duration_s=config.transport_s + tried.duration_s)
    hidden, was_hidden = replace(hidden, grasp_latent=tried.latent), at(occluded, target)
    after, hidden, paid = _ended(config, state, hidden, verb, target, tried, was_hidden, see_key)
    ends = (verb == Verb.FINISH) | (after.steps_to_go == 0) | ~xp.any(after.is_on_table, axis=-1)
    return after, hidden, Outcome(paid + price_of_left(config, after, hidden, ends), tried.duration_s, ends)


def _ended(
    config: WorldConfig,
    state: TableState,
    hidden: HiddenState,
    verb: Which,
    target: Which,
    tried: Attempt,
    was_hidden: Amounts,
    key: Key,
    robot: Which | None = None,
    in_the_air: Bool[Array, "*B N"] | bool = False,
) -> Paid:
    """Observed and hidden state after an attempt and the look that follows, and the reward."""
    state = after_attempt(state, verb, target, tried, was_hidden, robot)
    is_lifted = is_target(state, target) & (tried.is_held & (verb == Verb.LIFT))[..., None]
    state, hidden = look(config, state, hidden, is_lifted | in_the_air, key)
    return state, hidden, action_reward(config, verb, tried.is_held, at(hidden.is_dirty, target), tried.duration_s)


def _step_of_several(
    config: WorldConfig, state: TableState, hidden: HiddenState, action: Which, key: Key, is_possible: Flags | None
) -> Stepped:
    """Let the deciding robot begin an action, and process events until a robot is free to decide."""
    xp = library_of(action)
    grasp_key, see_key = random.split(key)
    state, hidden = _begun(config, state, hidden, action, grasp_key, is_possible)
    total = _nothing(config, state)
    for k in range(config.num_robots):
        # An event that frees no robot ends one for good (parked or dropped out): at most K events before a decision.
        is_idle = ~xp.any(_robots(state).is_undecided, axis=-1) & ~_is_over(state)
        if xp is np and not is_idle.any():
            break
        of_event = see_key if k == 0 else random.fold_in(see_key, k)
        after, of_hidden, brought = _next_event(config, state, hidden, of_event)
        state, hidden = chosen(is_idle, (after, of_hidden), (state, hidden))
        total = chosen(is_idle, _added(total, brought), total)
    decider, is_over = xp.argmax(_robots(state).is_undecided, axis=-1).astype(np.int32), _is_over(state)
    reward = total.reward + price_of_left(config, state, hidden, is_over) + config.reward_per_s * total.duration_s
    return replace(state, decider=decider), hidden, total._replace(reward=reward, is_over=is_over)


def _robots(state: TableState) -> Robots:
    assert state.robots is not None
    return state.robots


def _pending(hidden: HiddenState) -> Pending:
    assert hidden.pending is not None
    return hidden.pending


def _is_over(state: TableState) -> Flags:
    """Whether all robots are done for good, or the table is clear."""
    xp = library_of(state.is_on_table)
    return xp.all(_robots(state).is_done, axis=-1) | ~xp.any(state.is_on_table, axis=-1)


def _nothing(config: WorldConfig, state: TableState) -> Outcome:
    each = library_of(state.is_on_table).zeros(_robots(state).is_busy.shape, dtype=np.float32)
    out_s = None if config.drop_out_rate is None else each + np.float32(np.inf)
    return Outcome(each[..., 0], each[..., 0], each[..., 0] > 0, each, out_s)


def _added(total: Outcome, later: Outcome) -> Outcome:
    """Sum of the outcomes of two successive periods."""
    alone: Any = total.paid_alone
    out_s = total.out_s
    if out_s is not None:
        out_s = library_of(out_s).minimum(out_s, total.duration_s[..., None] + later.out_s)
    reward, duration_s = total.reward + later.reward, total.duration_s + later.duration_s
    return Outcome(reward, duration_s, total.is_over, alone + later.paid_alone, out_s)


def _begun(
    config: WorldConfig, state: TableState, hidden: HiddenState, action: Which, key: Key, is_possible: Flags | None
) -> tuple[TableState, HiddenState]:
    """Draw the outcome of the deciding robot's action, and set it pending."""
    xp, actions, robots, pending = library_of(action), ActionSpace(state.num_objects), _robots(state), _pending(hidden)
    assert state.decider is not None
    verb, target, robot = actions.verb(action), actions.target(action), state.decider
    occluded, is_wait, there = occlusion(state), verb == WAIT, state
    at_there = occluded
    if is_possible is not None:
        is_there, is_wait = is_possible[..., None] | ~is_target(state, target), is_wait & is_possible
        there = replace(state, is_on_table=state.is_on_table & is_there)
        at_there = occlusion(there)
    tried = attempted(config.as_robot(robot), there, hidden, _to_the_table(verb), target, key, at_there)
    duration_s = (config.transport_s + tried.duration_s) / xp.asarray(config.speed, dtype=np.float32)[robot]
    is_mine = numbered(robot, config.num_robots)

    def mine(values: Any, others: Any) -> Any:
        return chosen(is_mine, xp.expand_dims(values, robot.ndim), others)

    never_s = xp.where(is_wait, np.float32(np.inf), duration_s)
    robots = replace(
        robots,
        is_busy=robots.is_busy | is_mine,
        verb=mine(verb, robots.verb).astype(np.int32),
        target=mine(target, robots.target).astype(np.int32),
        since_s=xp.where(is_mine, np.float32(0.0), robots.since_s),
        decisions_to_go=(robots.decisions_to_go - is_mine).astype(np.int32),
    )
    pending = Pending(
        left_s=mine(never_s, pending.left_s),
        duration_s=mine(duration_s, pending.duration_s),
        is_held=mine(tried.is_held, pending.is_held),
        occlusion=mine(at(occluded, target), pending.occlusion),
        hides=mine(tried.hides, pending.hides),
        is_moved=mine(tried.hides != state.hides, pending.is_moved),
    )
    return replace(state, robots=robots), replace(hidden, grasp_latent=tried.latent, pending=pending)


def _to_the_table(verb: Which) -> Which:
    """Replace WAIT by FINISH: neither acts on the table."""
    return library_of(verb).where(verb == WAIT, Verb.FINISH, verb)


def _next_event(config: WorldConfig, state: TableState, hidden: HiddenState, key: Key) -> Stepped:
    """Process the next event, the first action to end or an earlier drop-out: state, hidden state and outcome."""
    robots, until_out = _robots(state), hidden.until_out_s
    xp, zero, never, out_s = library_of(robots.is_busy), np.float32(0.0), np.float32(np.inf), None
    left_s = xp.where(robots.is_busy, _pending(hidden).left_s, never)
    robot, first_s = xp.argmin(left_s, axis=-1), xp.min(left_s, axis=-1)
    # If a trajectory is over, no action ends; the result is discarded, but must be finite.
    passed_s = xp.where(xp.isfinite(first_s), first_s, zero)
    after, of_hidden, paid = _at_end(config, state, hidden, robot, passed_s, key)
    if until_out is not None:
        until_s = xp.where(robots.is_busy, until_out, never)
        leaver, leaves_s = xp.argmin(until_s, axis=-1), xp.min(until_s, axis=-1)
        is_first = leaves_s < first_s
        passed_s, paid = xp.where(is_first, leaves_s, passed_s), xp.where(is_first, zero, paid)
        # The table does not change.
        freed, pending = _freed(robots, _pending(hidden), leaver, passed_s)
        is_leaver = numbered(leaver, config.num_robots)
        is_out = robots.is_out | is_leaver
        at_drop_out = replace(state, robots=replace(freed, is_out=is_out)), replace(hidden, pending=pending)
        after, of_hidden = chosen(is_first, at_drop_out, (after, of_hidden))
        of_hidden = replace(of_hidden, until_out_s=until_out - passed_s[..., None])
        out_s = xp.where(is_first[..., None] & is_leaver, passed_s[..., None], never)
    own = xp.where(numbered(robot, config.num_robots), paid[..., None], zero)
    alone = own + _own_price(config, robots.is_done, after, of_hidden, passed_s)
    return after, of_hidden, Outcome(paid, passed_s, xp.asarray(False), alone, out_s)


def _own_price(
    config: WorldConfig, was_done: Bool[Array, "*B K"], state: TableState, hidden: HiddenState, passed_s: Amounts
) -> Float[Array, "*B K"]:
    """Price of each robot's seconds until its end, and at its end the penalty for dirty objects left in its reach."""
    xp, robots = library_of(was_done), _robots(state)
    is_at_end = robots.is_done & ~was_done
    if robots.is_out is not None:
        is_at_end = is_at_end & ~robots.is_out
    assert state.workspace is not None
    is_left = (state.is_on_table & hidden.is_dirty)[..., None, :] & state.workspace.is_in_reach
    left = xp.sum(is_left, axis=-1).astype(np.float32)
    of_left = xp.where(is_at_end, config.reward_dirty_left * left, np.float32(0.0))
    return of_left + xp.where(was_done, np.float32(0.0), config.reward_per_s * passed_s[..., None])


def _at_end(
    config: WorldConfig, state: TableState, hidden: HiddenState, robot: Which, passed_s: Amounts, key: Key
) -> Paid:
    """Observed and hidden state after a robot's action ends, and its reward."""
    robots, pending, xp = _robots(state), _pending(hidden), library_of(robot)
    verb, target, is_held = (at(values, robot) for values in (robots.verb, robots.target, pending.is_held))
    duration_s, was_hidden = at(pending.duration_s, robot), at(pending.occlusion, robot)
    of_robot = robot[..., None, None, None]
    is_moved, moved = (
        xp.take_along_axis(each, of_robot, axis=-3)[..., 0, :, :] for each in (pending.is_moved, pending.hides)
    )
    tried = Attempt(is_held, duration_s, xp.where(is_moved, moved, state.hides), None)
    robots, pending = _freed(robots, pending, robot, passed_s)
    is_parked = xp.where(numbered(robot, config.num_robots), (verb == Verb.FINISH)[..., None], robots.is_parked)
    # An object is held for as long as its transport takes.
    transport_s = config.transport_s / xp.asarray(config.speed, dtype=np.float32)
    is_holding = robots.is_busy & pending.is_held & (pending.left_s <= transport_s)
    held = xp.any(is_holding[..., None] & (robots.target[..., None] == xp.arange(state.num_objects)), axis=-2)
    state, hidden, paid = _ended(
        config, state, hidden, _to_the_table(verb), target, tried, was_hidden, key, robot, held
    )
    return replace(state, robots=replace(robots, is_parked=is_parked)), replace(hidden, pending=pending), paid


def _freed(robots: Robots, pending: Pending, robot: Which, passed_s: Amounts) -> tuple[Robots, Pending]:
    """Free a robot, and all waiting robots, after `passed_s`."""
    xp, never = library_of(robot), np.float32(np.inf)
    is_free = numbered(robot, robots.num_robots) | (robots.is_busy & (robots.verb == WAIT))
    left_s = xp.where(robots.is_busy, pending.left_s, never)
    freed = replace(robots, is_busy=robots.is_busy & ~is_free, since_s=robots.since_s + passed_s[..., None])
    return freed, replace(pending, left_s=xp.where(freed.is_busy, left_s - passed_s[..., None], never))
