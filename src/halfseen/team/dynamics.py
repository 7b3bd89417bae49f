"""One decision of one robot, and what happens until the next one: pure functions; `jax.vmap` makes them a batch.

A stage lasts from one decision to the next, whichever robot makes it. What a robot begins is drawn when it begins and
told when it ends: then the table changes, the camera looks, the reward falls, and robots that waited are free. Where
another robot is free at once, the stage takes no time, and nothing is looked at in it. With one robot that is
`world.dynamics`, draw by draw.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from halfseen.team.actions import WAIT
from halfseen.team.config import TeamConfig
from halfseen.team.state import Pending, Robots, TeamHidden, TeamLayout, TeamState
from halfseen.world import dynamics as table_dynamics
from halfseen.world.action_space import ActionSpace, Verb
from halfseen.world.dynamics import Outcome, action_reward, after_attempt, attempted, look
from halfseen.world.episodes import Dynamics
from halfseen.world.grasping import Attempt
from halfseen.world.state import TableState, occlusion


def start(config: TeamConfig, layout: TeamLayout, key: Array) -> tuple[TeamState, TeamHidden]:
    """Set one table before a team that is free: what is hidden is drawn, and the camera takes its first view."""
    table, hidden = table_dynamics.start(config.world, layout.table, key)
    size, num_objects = config.num_robots, table.num_objects
    table = _with_room(table, size * config.world.horizon)
    robots = Robots(
        is_busy=jnp.zeros(size, dtype=bool),
        is_parked=jnp.zeros(size, dtype=bool),
        verb=jnp.zeros(size, dtype=jnp.int32),
        target=jnp.zeros(size, dtype=jnp.int32),
        since_s=jnp.zeros(size, dtype=jnp.float32),
        decisions_to_go=jnp.full(size, config.world.horizon, dtype=jnp.int32),
    )
    pending = Pending(
        left_s=jnp.full(size, jnp.inf, dtype=jnp.float32),
        duration_s=jnp.zeros(size, dtype=jnp.float32),
        is_held=jnp.zeros(size, dtype=bool),
        occlusion=jnp.zeros(size, dtype=jnp.float32),
        hides=jnp.zeros((size, num_objects, num_objects), dtype=jnp.float32),
        is_moved=jnp.zeros((size, num_objects, num_objects), dtype=bool),
    )
    return TeamState(table, robots, layout.workspace, jnp.asarray(0, dtype=jnp.int32)), TeamHidden(hidden, pending)


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
    grasp_key, see_key = jax.random.split(key)
    state, hidden = _begun(config, state, hidden, action, grasp_key)
    reward, duration_s = jnp.zeros((), dtype=jnp.float32), jnp.zeros((), dtype=jnp.float32)
    for k in range(config.num_robots):
        # A robot that parks frees nobody, so up to K things may end before anybody decides.
        is_idle = ~jnp.any(state.robots.is_undecided) & ~_is_over(state)
        of_event = see_key if k == 0 else jax.random.fold_in(see_key, k)
        *after, gained, passed_s = _next_end(config, state, hidden, of_event)
        state, hidden = jax.tree.map(
            lambda new, old, is_idle=is_idle: jnp.where(is_idle, new, old), tuple(after), (state, hidden)
        )
        reward = reward + jnp.where(is_idle, gained, 0.0)
        duration_s = duration_s + jnp.where(is_idle, passed_s, 0.0)
    is_over = _is_over(state)
    dirty_left = jnp.sum(state.table.is_on_table & hidden.table.is_dirty)
    reward = reward + jnp.where(is_over, config.world.reward_dirty_left * dirty_left, 0.0)
    reward = reward + config.reward_per_s * duration_s
    decider = jnp.argmax(state.robots.is_undecided).astype(jnp.int32)
    return replace(state, decider=decider), hidden, Outcome(reward, duration_s, is_over)


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
    robots = state.robots
    is_done = ~robots.is_busy & (robots.is_parked | (robots.decisions_to_go == 0))
    return jnp.all(is_done) | ~jnp.any(state.table.is_on_table)


def _begun(
    config: TeamConfig, state: TeamState, hidden: TeamHidden, action: Int[Array, ""], key: Array
) -> tuple[TeamState, TeamHidden]:
    """Draw how the action of the robot that decides will go."""
    actions, robot = ActionSpace(state.table.num_objects), state.decider
    verb, target = actions.verb(action), actions.target(action)
    is_wait = verb == WAIT
    # To the table, who waits does nothing, as who finishes.
    tried = attempted(config.world, state.table, hidden.table, jnp.where(is_wait, Verb.FINISH, verb), target, key)
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
        left_s=pending.left_s.at[robot].set(jnp.where(is_wait, jnp.inf, duration_s)),
        duration_s=pending.duration_s.at[robot].set(duration_s),
        is_held=pending.is_held.at[robot].set(tried.is_held),
        occlusion=pending.occlusion.at[robot].set(occlusion(state.table)[target]),
        hides=pending.hides.at[robot].set(tried.hides),
        is_moved=pending.is_moved.at[robot].set(tried.hides != state.table.hides),
    )
    return replace(state, robots=robots), TeamHidden(replace(hidden.table, grasp_trait=tried.trait), pending)


def _next_end(
    config: TeamConfig, state: TeamState, hidden: TeamHidden, key: Array
) -> tuple[TeamState, TeamHidden, Float[Array, ""], Float[Array, ""]]:
    """Let the first thing that ends end: what is seen and hidden then, what it pays, and the time until then [s]."""
    robots, pending = state.robots, hidden.pending
    left_s = jnp.where(robots.is_busy, pending.left_s, jnp.inf)
    robot = jnp.argmin(left_s)
    # Nothing is to end where a path is over: what comes of that is thrown away, and is to be finite.
    passed_s = jnp.where(jnp.isfinite(left_s[robot]), left_s[robot], 0.0)
    verb, target = robots.verb[robot], robots.target[robot]
    hides = jnp.where(pending.is_moved[robot], pending.hides[robot], state.table.hides)
    tried = Attempt(pending.is_held[robot], pending.duration_s[robot], hides, None)
    table = after_attempt(state.table, verb, target, tried, pending.occlusion[robot])
    is_free = (jnp.arange(robots.num_robots) == robot) | (robots.is_busy & (robots.verb == WAIT))
    robots = replace(
        robots,
        is_busy=robots.is_busy & ~is_free,
        is_parked=robots.is_parked.at[robot].set(verb == Verb.FINISH),
        since_s=robots.since_s + passed_s,
    )
    pending = replace(pending, left_s=jnp.where(robots.is_busy, left_s - passed_s, jnp.inf))
    is_lifted = (jnp.arange(table.num_objects) == target) & tried.is_held & (verb == Verb.LIFT)
    held = is_lifted | _in_the_air(config, robots, pending, table)
    table, of_table = look(config.world, table, hidden.table, held, key)
    paid = action_reward(config.world, verb, tried.is_held, of_table.is_dirty[target], tried.duration_s)
    return replace(state, table=table, robots=robots), TeamHidden(of_table, pending), paid, passed_s


def _in_the_air(config: TeamConfig, robots: Robots, pending: Pending, table: TableState) -> Bool[Array, " N"]:
    """What robots that are busy hold: an object is held for as long as its transport takes."""
    transport_s = config.world.transport_s / jnp.asarray(config.speed)
    is_holding = robots.is_busy & pending.is_held & (pending.left_s <= transport_s)
    return jnp.any(is_holding[:, None] & (robots.target[:, None] == jnp.arange(table.num_objects)), axis=0)


TEAM = Dynamics(start, step)
