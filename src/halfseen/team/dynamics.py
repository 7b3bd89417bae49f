"""One decision of one robot, and what happens until the next one: pure functions; `jax.vmap` makes them a batch.

A stage lasts from one decision to the next, whichever robot makes it. What a robot begins is drawn when it begins and
told when it ends: then the table changes, the camera looks, the reward falls, and robots that waited are free. Where
another robot is free at once, the stage takes no time, and nothing is looked at in it. With one robot that is
`world.dynamics`, draw by draw.

A robot may drop out (battery, e-stop) while it is at something, waiting included; who has parked no longer does. What
it carried out is abandoned: its object stays where it was, nothing is paid, and the attempt is not counted. Robots that
waited are free, as after any event. Nothing is looked at: labels come with what was done, and nothing was, so that the
table stays as it was seen. What ends at the very moment of a drop-out ends before it.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from halfseen.team.actions import WAIT, possible_actions
from halfseen.team.config import TeamConfig
from halfseen.team.state import OfRobots, Pending, Robots, TeamHidden, TeamLayout, TeamState
from halfseen.world import dynamics as table_dynamics
from halfseen.world.action_space import ActionSpace, Verb
from halfseen.world.dynamics import Outcome, action_reward, after_attempt, attempted, look
from halfseen.world.episodes import Dynamics
from halfseen.world.grasping import Attempt
from halfseen.world.state import TableState, occlusion

_DROP_OUT_KEY = 29
"""Folded into the key of the start for the times of drop-outs, so that no other draw changes."""


def start(config: TeamConfig, layout: TeamLayout, key: Array) -> tuple[TeamState, TeamHidden]:
    """Set one table before a team that is free: what is hidden is drawn, and the camera takes its first view."""
    table, hidden = table_dynamics.start(config.world, layout.table, key)
    size, num_objects = config.num_robots, table.num_objects
    table = _with_room(table, size * config.world.horizon)
    if config.has_own_laws:
        table = replace(table, attempt_robot=jnp.zeros(table.horizon, dtype=jnp.int32))
    robots = Robots(
        is_busy=jnp.zeros(size, dtype=bool),
        is_parked=jnp.zeros(size, dtype=bool),
        verb=jnp.zeros(size, dtype=jnp.int32),
        target=jnp.zeros(size, dtype=jnp.int32),
        since_s=jnp.zeros(size, dtype=jnp.float32),
        decisions_to_go=jnp.full(size, config.world.horizon, dtype=jnp.int32),
        is_out=None if config.drop_out_rate is None else jnp.zeros(size, dtype=bool),
    )
    pending = Pending(
        left_s=jnp.full(size, jnp.inf, dtype=jnp.float32),
        duration_s=jnp.zeros(size, dtype=jnp.float32),
        is_held=jnp.zeros(size, dtype=bool),
        occlusion=jnp.zeros(size, dtype=jnp.float32),
        hides=jnp.zeros((size, num_objects, num_objects), dtype=jnp.float32),
        is_moved=jnp.zeros((size, num_objects, num_objects), dtype=bool),
    )
    state = TeamState(table, robots, layout.workspace, jnp.asarray(0, dtype=jnp.int32))
    return state, TeamHidden(hidden, pending, until_out_s(config, jax.random.fold_in(key, _DROP_OUT_KEY)))


def until_out_s(config: TeamConfig, key: Array) -> Float[Array, " K"] | None:
    """Draw until when each robot drops out, which knows nothing of what went before; None where nobody can [s]."""
    if config.drop_out_rate is None:
        return None
    rate = jnp.asarray(config.drop_out_rate, dtype=jnp.float32)
    survival = jax.random.exponential(key, rate.shape)
    return jnp.where(rate > 0.0, survival / jnp.where(rate > 0.0, rate, 1.0), jnp.inf)


def step(
    config: TeamConfig, state: TeamState, hidden: TeamHidden, action: Int[Array, ""], key: Array
) -> tuple[TeamState, TeamHidden, Outcome]:
    """Let the robot that decides begin an action, and wait for the next decision.

    Returns
    -------
    TeamState
        What is seen then, and who decides.
    TeamHidden
        What is hidden then.
    Outcome
        All reward of the time between, the price of its seconds and, where the path ends, of what is left dirty.
    """
    return _stepped(config, state, hidden, action, key, jnp.asarray(True))


def step_any(
    config: TeamConfig, state: TeamState, hidden: TeamHidden, action: Int[Array, ""], key: Array
) -> tuple[TeamState, TeamHidden, Outcome]:
    """As `step`, also where the action is not possible for the robot that decides.

    An attempt that is not possible closes on nothing: it fails, and takes as long as an attempt may. A WAIT for nothing
    lasts as long as going home.
    """
    return _stepped(config, state, hidden, action, key, possible_actions(state)[action])


def _stepped(
    config: TeamConfig,
    state: TeamState,
    hidden: TeamHidden,
    action: Int[Array, ""],
    key: Array,
    is_possible: Bool[Array, ""],
) -> tuple[TeamState, TeamHidden, Outcome]:
    grasp_key, see_key = jax.random.split(key)
    state, hidden = _begun(config, state, hidden, action, grasp_key, is_possible)
    total = _Passed.nothing(config)
    for k in range(config.num_robots):
        # What frees nobody ends a robot for good, parked or dropped out: up to K such events before anybody decides.
        is_idle = ~jnp.any(state.robots.is_undecided) & ~_is_over(state)
        of_event = see_key if k == 0 else jax.random.fold_in(see_key, k)
        *after, passed = _next_event(config, state, hidden, of_event)
        state, hidden = jax.tree.map(
            lambda new, old, is_idle=is_idle: jnp.where(is_idle, new, old), tuple(after), (state, hidden)
        )
        total = total.and_then(passed, is_idle)
    is_over = _is_over(state)
    dirty_left = jnp.sum(state.table.is_on_table & hidden.table.is_dirty)
    reward = total.paid + jnp.where(is_over, config.world.reward_dirty_left * dirty_left, 0.0)
    reward = reward + config.reward_per_s * total.duration_s
    decider = jnp.argmax(state.robots.is_undecided).astype(jnp.int32)
    of_robots = OfRobots(total.paid_alone, total.out_s)
    return replace(state, decider=decider), hidden, Outcome(reward, total.duration_s, is_over, of_robots)


class _Passed(NamedTuple):
    """What came of some time: what was paid, to all and to each alone, and how far into it each dropped out [s]."""

    paid: Float[Array, ""]
    duration_s: Float[Array, ""]
    paid_alone: Float[Array, " K"]
    out_s: Float[Array, " K"] | None

    @classmethod
    def nothing(cls, config: TeamConfig) -> "_Passed":
        zero, each = jnp.zeros((), dtype=jnp.float32), jnp.zeros(config.num_robots, dtype=jnp.float32)
        return cls(zero, zero, each, None if config.drop_out_rate is None else each + jnp.inf)

    def and_then(self, later: "_Passed", is_so: Bool[Array, ""]) -> "_Passed":
        out_s = None
        if self.out_s is not None and later.out_s is not None:
            out_s = jnp.where(is_so, jnp.minimum(self.out_s, self.duration_s + later.out_s), self.out_s)
        return _Passed(
            paid=self.paid + jnp.where(is_so, later.paid, 0.0),
            duration_s=self.duration_s + jnp.where(is_so, later.duration_s, 0.0),
            paid_alone=self.paid_alone + jnp.where(is_so, later.paid_alone, 0.0),
            out_s=out_s,
        )


def _with_room(table: TableState, num_attempts: int) -> TableState:
    """The same table with room for the attempts of all robots."""
    spare = num_attempts - table.horizon

    def longer(leaf: Array, empty: int | float | bool) -> Array:
        return jnp.pad(leaf, (0, spare), constant_values=empty)

    return replace(
        table,
        attempt_object=longer(table.attempt_object, -1),
        attempt_occlusion=longer(table.attempt_occlusion, 0.0),
        attempt_succeeded=longer(table.attempt_succeeded, False),
        steps_to_go=jnp.asarray(num_attempts, dtype=jnp.int32),
    )


def _is_over(state: TeamState) -> Bool[Array, ""]:
    """Whether all robots are done for good, or the table is clear."""
    return jnp.all(state.robots.is_done) | ~jnp.any(state.table.is_on_table)


def _begun(
    config: TeamConfig,
    state: TeamState,
    hidden: TeamHidden,
    action: Int[Array, ""],
    key: Array,
    is_possible: Bool[Array, ""],
) -> tuple[TeamState, TeamHidden]:
    """Draw how the action of the robot that decides will go."""
    actions, robot = ActionSpace(state.table.num_objects), state.decider
    verb, target = actions.verb(action), actions.target(action)
    is_wait = verb == WAIT
    is_there = state.table.is_on_table & (is_possible | (jnp.arange(state.table.num_objects) != target))
    world, there = config.world.as_robot(robot), replace(state.table, is_on_table=is_there)
    tried = attempted(world, there, hidden.table, _to_the_table(verb), target, key)
    speed = jnp.asarray(config.speed)[robot]
    duration_s = (config.world.transport_s + tried.duration_s) / speed
    robots, pending = state.robots, hidden.pending
    robots = replace(
        robots,
        is_busy=robots.is_busy.at[robot].set(True),
        verb=robots.verb.at[robot].set(verb),
        target=robots.target.at[robot].set(target),
        since_s=robots.since_s.at[robot].set(0.0),
        decisions_to_go=robots.decisions_to_go.at[robot].add(-1),
    )
    pending = Pending(
        left_s=pending.left_s.at[robot].set(jnp.where(is_wait & is_possible, jnp.inf, duration_s)),
        duration_s=pending.duration_s.at[robot].set(duration_s),
        is_held=pending.is_held.at[robot].set(tried.is_held),
        occlusion=pending.occlusion.at[robot].set(occlusion(state.table)[target]),
        hides=pending.hides.at[robot].set(tried.hides),
        is_moved=pending.is_moved.at[robot].set(tried.hides != state.table.hides),
    )
    of_table = replace(hidden.table, grasp_trait=tried.trait)
    return replace(state, robots=robots), replace(hidden, table=of_table, pending=pending)


def _to_the_table(verb: Int[Array, ""]) -> Int[Array, ""]:
    """To the table, who waits does nothing, as who finishes."""
    return jnp.where(verb == WAIT, Verb.FINISH, verb)


def _next_event(
    config: TeamConfig, state: TeamState, hidden: TeamHidden, key: Array
) -> tuple[TeamState, TeamHidden, _Passed]:
    """Let the first thing that ends end, or a robot drop out before: what is seen and hidden then."""
    robots, pending = state.robots, hidden.pending
    left_s = jnp.where(robots.is_busy, pending.left_s, jnp.inf)
    robot = jnp.argmin(left_s)
    # Nothing is to end where a path is over: what comes of that is thrown away, and is to be finite.
    passed_s = jnp.where(jnp.isfinite(left_s[robot]), left_s[robot], 0.0)
    *ended, paid = _at_end(config, state, hidden, robot, passed_s, key)
    after: Any = tuple(ended)
    is_out = None
    if hidden.until_out_s is not None:
        until_s = jnp.where(robots.is_busy, hidden.until_out_s, jnp.inf)
        is_first = jnp.min(until_s) < left_s[robot]
        is_out = is_first & (jnp.arange(robots.num_robots) == jnp.argmin(until_s))
        passed_s, paid = jnp.where(is_first, jnp.min(until_s), passed_s), jnp.where(is_first, 0.0, paid)
        without = _at_drop_out(state, hidden, jnp.argmin(until_s), passed_s)
        after = jax.tree.map(lambda left, ended: jnp.where(is_first, left, ended), without, after)
    state, hidden = after
    if hidden.until_out_s is not None:
        hidden = replace(hidden, until_out_s=hidden.until_out_s - passed_s)
    is_mine = jnp.arange(robots.num_robots) == robot
    alone = jnp.where(is_mine, paid, 0.0) + _own_price(config, robots.is_done, state, hidden, passed_s)
    out_s = None if is_out is None else jnp.where(is_out, passed_s, jnp.inf)
    return state, hidden, _Passed(paid, passed_s, alone, out_s)


def _own_price(
    config: TeamConfig, was_done: Bool[Array, " K"], state: TeamState, hidden: TeamHidden, passed_s: Float[Array, ""]
) -> Float[Array, " K"]:
    """Price of the seconds of each robot that goes on, and of what is left in its reach where it came to its end."""
    robots = state.robots
    is_at_end = robots.is_done & ~was_done
    if robots.is_out is not None:
        is_at_end = is_at_end & ~robots.is_out
    left = jnp.sum(state.table.is_on_table & hidden.table.is_dirty & state.workspace.is_in_reach, axis=-1)
    of_left = jnp.where(is_at_end, config.world.reward_dirty_left * left, 0.0)
    return of_left + jnp.where(was_done, 0.0, config.reward_per_s * passed_s)


def _at_end(
    config: TeamConfig,
    state: TeamState,
    hidden: TeamHidden,
    robot: Int[Array, ""],
    passed_s: Float[Array, ""],
    key: Array,
) -> tuple[TeamState, TeamHidden, Float[Array, ""]]:
    """What is seen and hidden once a robot has ended what it was at, and what that pays."""
    robots, pending = state.robots, hidden.pending
    verb, target = robots.verb[robot], robots.target[robot]
    hides = jnp.where(pending.is_moved[robot], pending.hides[robot], state.table.hides)
    tried = Attempt(pending.is_held[robot], pending.duration_s[robot], hides, None)
    table = after_attempt(state.table, _to_the_table(verb), target, tried, pending.occlusion[robot])
    if table.attempt_robot is not None:
        now = table.horizon - state.table.steps_to_go
        table = replace(table, attempt_robot=table.attempt_robot.at[now].set(robot))
    robots, pending = _freed(robots, pending, robot, passed_s)
    robots = replace(robots, is_parked=robots.is_parked.at[robot].set(verb == Verb.FINISH))
    is_lifted = (jnp.arange(table.num_objects) == target) & tried.is_held & (verb == Verb.LIFT)
    held = is_lifted | _in_the_air(config, robots, pending, table)
    table, of_table = look(config.world, table, hidden.table, held, key)
    paid = action_reward(config.world, verb, tried.is_held, of_table.is_dirty[target], tried.duration_s)
    return replace(state, table=table, robots=robots), replace(hidden, table=of_table, pending=pending), paid


def _at_drop_out(
    state: TeamState, hidden: TeamHidden, robot: Int[Array, ""], passed_s: Float[Array, ""]
) -> tuple[TeamState, TeamHidden]:
    """What is seen and hidden once a robot has dropped out: the table is as it was."""
    robots, pending = _freed(state.robots, hidden.pending, robot, passed_s)
    assert robots.is_out is not None
    robots = replace(robots, is_out=robots.is_out.at[robot].set(True))
    return replace(state, robots=robots), replace(hidden, pending=pending)


def _freed(
    robots: Robots, pending: Pending, robot: Int[Array, ""], passed_s: Float[Array, ""]
) -> tuple[Robots, Pending]:
    """A robot after so many seconds is at nothing any more, and neither is who waited."""
    is_free = (jnp.arange(robots.num_robots) == robot) | (robots.is_busy & (robots.verb == WAIT))
    left_s = jnp.where(robots.is_busy, pending.left_s, jnp.inf)
    robots = replace(robots, is_busy=robots.is_busy & ~is_free, since_s=robots.since_s + passed_s)
    return robots, replace(pending, left_s=jnp.where(robots.is_busy, left_s - passed_s, jnp.inf))


def _in_the_air(config: TeamConfig, robots: Robots, pending: Pending, table: TableState) -> Bool[Array, " N"]:
    """What robots that are busy hold: an object is held for as long as its transport takes."""
    transport_s = config.world.transport_s / jnp.asarray(config.speed)
    is_holding = robots.is_busy & pending.is_held & (pending.left_s <= transport_s)
    return jnp.any(is_holding[:, None] & (robots.target[:, None] == jnp.arange(table.num_objects)), axis=0)


TEAM = Dynamics(start, step)
