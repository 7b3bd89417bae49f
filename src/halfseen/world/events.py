"""What happens at a table with several robots between one decision and the next.

What a robot begins is drawn when it begins, and is pending until it ends. Of what is pending the first to end ends,
until somebody is free to decide.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from halfseen.arrays import Array, at, chosen, library_of
from halfseen.world import random
from halfseen.world.actions import WAIT, ActionSpace, Verb
from halfseen.world.attempts import action_reward, after_attempt, attempted, is_target, look
from halfseen.world.config import WorldConfig
from halfseen.world.grasping import Attempt
from halfseen.world.random import Key
from halfseen.world.state import HiddenState, Pending, Robots, TableState, occlusion


class Passed(NamedTuple):
    """What came of some time."""

    paid: Float[Array, "*B"]
    """Of what ended, to all robots."""
    duration_s: Float[Array, "*B"]
    paid_alone: Float[Array, "*B K"]
    """What it would have paid each robot had it been alone: its own attempts that ended, the price of its seconds until
    its own end, and there that of what is left dirty in its reach."""
    out_s: Float[Array, "*B K"] | None
    """How far into it each robot dropped out, infinite where it did not; None where nobody can [s]."""

    def and_then(self, later: "Passed", is_so: Bool[Array, "*B"]) -> "Passed":
        """Add what came after it, where it is so."""
        xp, zero, out_s = library_of(is_so), np.float32(0.0), None
        if self.out_s is not None and later.out_s is not None:
            within_s = xp.minimum(self.out_s, self.duration_s[..., None] + later.out_s)
            out_s = xp.where(is_so[..., None], within_s, self.out_s)
        return Passed(
            paid=self.paid + xp.where(is_so, later.paid, zero),
            duration_s=self.duration_s + xp.where(is_so, later.duration_s, zero),
            paid_alone=self.paid_alone + xp.where(is_so[..., None], later.paid_alone, zero),
            out_s=out_s,
        )


def until_next_decision(
    config: WorldConfig,
    state: TableState,
    hidden: HiddenState,
    action: Int[Array, "*B"],
    key: Key,
    is_possible: Bool[Array, "*#B"],
) -> tuple[TableState, HiddenState, Passed]:
    """Let the robot that decides begin an action, and what is pending end until somebody is to decide.

    Parameters
    ----------
    config, state, hidden, action, key
        As in `transition.step`.
    is_possible
        Whether the action is; an attempt that is not closes on nothing.
    """
    xp = library_of(action)
    grasp_key, see_key = random.split(key)
    state, hidden = _begun(config, state, hidden, action, grasp_key, is_possible)
    total = _nothing(config, state)
    for k in range(config.num_robots):
        # What frees nobody ends a robot for good, parked or dropped out: up to K such events before anybody decides.
        is_idle = ~xp.any(robots_of(state).is_undecided, axis=-1) & ~is_over(state)
        if xp is np and not is_idle.any():
            break
        of_event = see_key if k == 0 else random.fold_in(see_key, k)
        after, of_hidden, passed = _next_event(config, state, hidden, of_event)
        state, hidden = chosen(is_idle, (after, of_hidden), (state, hidden))
        total = total.and_then(passed, is_idle)
    decider = xp.argmax(robots_of(state).is_undecided, axis=-1).astype(np.int32)
    return replace(state, decider=decider), hidden, total


def robots_of(state: TableState) -> Robots:
    """The robots of a state that has several."""
    assert state.robots is not None
    return state.robots


def _nothing(config: WorldConfig, state: TableState) -> Passed:
    xp = library_of(state.is_on_table)
    each = xp.zeros(robots_of(state).is_busy.shape, dtype=np.float32)
    out_s = None if config.drop_out_rate is None else each + np.float32(np.inf)
    return Passed(each[..., 0], each[..., 0], each, out_s)


def is_over(state: TableState) -> Bool[Array, "*B"]:
    """Whether all robots are done for good, or the table is clear."""
    xp = library_of(state.is_on_table)
    return xp.all(robots_of(state).is_done, axis=-1) | ~xp.any(state.is_on_table, axis=-1)


def _begun(
    config: WorldConfig,
    state: TableState,
    hidden: HiddenState,
    action: Int[Array, "*B"],
    key: Key,
    is_possible: Bool[Array, "*#B"],
) -> tuple[TableState, HiddenState]:
    """Draw how the action of the robot that decides will go."""
    xp, actions, robots, pending = library_of(action), ActionSpace(state.num_objects), state.robots, hidden.pending
    assert robots is not None
    assert pending is not None
    assert state.decider is not None
    verb, target, robot = actions.verb(action), actions.target(action), state.decider
    is_there = state.is_on_table & (is_possible[..., None] | ~is_target(state, target))
    there, occluded = replace(state, is_on_table=is_there), occlusion(state)
    at_there = occlusion(there)
    tried = attempted(config.as_robot(robot), there, hidden, _to_the_table(verb), target, key, at_there)
    speed = xp.asarray(config.speed, dtype=np.float32)[robot]
    duration_s = (config.transport_s + tried.duration_s) / speed
    is_mine = xp.arange(robots.num_robots) == robot[..., None]

    def mine(values: Any, others: Any) -> Any:
        return chosen(is_mine, xp.expand_dims(values, robot.ndim), others)

    never_s = xp.where((verb == WAIT) & is_possible, np.float32(np.inf), duration_s)
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
    return replace(state, robots=robots), replace(hidden, grasp_trait=tried.trait, pending=pending)


def _to_the_table(verb: Int[Array, "*B"]) -> Int[Array, "*B"]:
    """To the table, who waits does nothing, as who finishes."""
    return library_of(verb).where(verb == WAIT, Verb.FINISH, verb)


def _next_event(
    config: WorldConfig, state: TableState, hidden: HiddenState, key: Key
) -> tuple[TableState, HiddenState, Passed]:
    """Let the first thing that ends end, or a robot drop out before: what is seen and hidden then."""
    robots, pending, until_out = robots_of(state), hidden.pending, hidden.until_out_s
    assert pending is not None
    xp, zero, never = library_of(robots.is_busy), np.float32(0.0), np.float32(np.inf)
    left_s = xp.where(robots.is_busy, pending.left_s, never)
    robot, first_s = xp.argmin(left_s, axis=-1), xp.min(left_s, axis=-1)
    # Nothing is to end where a path is over: what comes of that is thrown away, and is to be finite.
    passed_s = xp.where(xp.isfinite(first_s), first_s, zero)
    *ended, paid = _at_end(config, state, hidden, robot, passed_s, key)
    after: Any = tuple(ended)
    out_s = None
    if until_out is not None:
        until_s = xp.where(robots.is_busy, until_out, never)
        leaver, leaves_s = xp.argmin(until_s, axis=-1), xp.min(until_s, axis=-1)
        is_first = leaves_s < first_s
        passed_s, paid = xp.where(is_first, leaves_s, passed_s), xp.where(is_first, zero, paid)
        after = chosen(is_first, _at_drop_out(state, hidden, leaver, passed_s), after)
        after = after[0], replace(after[1], until_out_s=until_out - passed_s[..., None])
        is_out = is_first[..., None] & (xp.arange(robots.num_robots) == leaver[..., None])
        out_s = xp.where(is_out, passed_s[..., None], never)
    is_mine = xp.arange(robots.num_robots) == robot[..., None]
    state, hidden = after
    alone = xp.where(is_mine, paid[..., None], zero) + _own_price(config, robots.is_done, state, hidden, passed_s)
    return state, hidden, Passed(paid, passed_s, alone, out_s)


def _own_price(
    config: WorldConfig,
    was_done: Bool[Array, "*B K"],
    state: TableState,
    hidden: HiddenState,
    passed_s: Float[Array, "*B"],
) -> Float[Array, "*B K"]:
    """Price of the seconds of each robot that goes on, and of what is left in its reach where it came to its end."""
    xp, robots = library_of(was_done), robots_of(state)
    is_at_end = robots.is_done & ~was_done
    if robots.is_out is not None:
        is_at_end = is_at_end & ~robots.is_out
    assert state.workspace is not None
    is_left = (state.is_on_table & hidden.is_dirty)[..., None, :] & state.workspace.is_in_reach
    left = xp.sum(is_left, axis=-1).astype(np.float32)
    of_left = xp.where(is_at_end, config.reward_dirty_left * left, np.float32(0.0))
    return of_left + xp.where(was_done, np.float32(0.0), config.reward_per_s * passed_s[..., None])


def _at_end(
    config: WorldConfig,
    state: TableState,
    hidden: HiddenState,
    robot: Int[Array, "*B"],
    passed_s: Float[Array, "*B"],
    key: Key,
) -> tuple[TableState, HiddenState, Float[Array, "*B"]]:
    """What is seen and hidden once a robot has ended what it was at, and what that pays."""
    robots, pending, xp = robots_of(state), hidden.pending, library_of(robot)
    assert pending is not None
    verb, target, is_held = (at(values, robot) for values in (robots.verb, robots.target, pending.is_held))
    duration_s = at(pending.duration_s, robot)
    hides = xp.where(_matrix_of(pending.is_moved, robot), _matrix_of(pending.hides, robot), state.hides)
    tried = Attempt(is_held, duration_s, hides, None)
    now = state.horizon - state.steps_to_go
    state = after_attempt(state, _to_the_table(verb), target, tried, at(pending.occlusion, robot))
    if state.attempt_robot is not None:
        is_now = xp.arange(state.horizon) == now[..., None]
        state = replace(state, attempt_robot=xp.where(is_now, robot[..., None], state.attempt_robot).astype(np.int32))
    robots, pending = _freed(robots, pending, robot, passed_s)
    is_mine = xp.arange(robots.num_robots) == robot[..., None]
    robots = replace(robots, is_parked=xp.where(is_mine, (verb == Verb.FINISH)[..., None], robots.is_parked))
    is_lifted = is_target(state, target) & (is_held & (verb == Verb.LIFT))[..., None]
    held = is_lifted | _in_the_air(config, robots, pending, state)
    state, hidden = look(config, state, hidden, held, key)
    paid = action_reward(config, verb, is_held, at(hidden.is_dirty, target), duration_s)
    return replace(state, robots=robots), replace(hidden, pending=pending), paid


def _matrix_of(values: Array, robot: Int[Array, "*B"]) -> Array:
    xp = library_of(robot)
    return xp.take_along_axis(values, robot[..., None, None, None], axis=-3)[..., 0, :, :]


def _at_drop_out(
    state: TableState, hidden: HiddenState, robot: Int[Array, "*B"], passed_s: Float[Array, "*B"]
) -> tuple[TableState, HiddenState]:
    """What is seen and hidden once a robot has dropped out: the table is as it was."""
    assert hidden.pending is not None
    robots, pending = _freed(robots_of(state), hidden.pending, robot, passed_s)
    is_mine = library_of(robot).arange(robots.num_robots) == robot[..., None]
    assert robots.is_out is not None
    robots = replace(robots, is_out=robots.is_out | is_mine)
    return replace(state, robots=robots), replace(hidden, pending=pending)


def _freed(
    robots: Robots, pending: Pending, robot: Int[Array, "*B"], passed_s: Float[Array, "*B"]
) -> tuple[Robots, Pending]:
    """A robot after so many seconds is at nothing any more, and neither is who waited."""
    xp, never = library_of(robot), np.float32(np.inf)
    is_mine = xp.arange(robots.num_robots) == robot[..., None]
    is_free = is_mine | (robots.is_busy & (robots.verb == WAIT))
    left_s = xp.where(robots.is_busy, pending.left_s, never)
    freed = replace(robots, is_busy=robots.is_busy & ~is_free, since_s=robots.since_s + passed_s[..., None])
    return freed, replace(pending, left_s=xp.where(freed.is_busy, left_s - passed_s[..., None], never))


def _in_the_air(config: WorldConfig, robots: Robots, pending: Pending, state: TableState) -> Bool[Array, "*B N"]:
    """What robots that are busy hold: an object is held for as long as its transport takes."""
    xp = library_of(robots.is_busy)
    transport_s = config.transport_s / xp.asarray(config.speed, dtype=np.float32)
    is_holding = robots.is_busy & pending.is_held & (pending.left_s <= transport_s)
    is_target = robots.target[..., None] == xp.arange(state.num_objects)
    return xp.any(is_holding[..., None] & is_target, axis=-2)
