"""What nobody knows of a table before a team, drawn from what is seen: attributes, grips, how what goes on will end.

An attempt that goes on has not ended yet, and that tells: of all ways in which it might have gone, those that would be
over by now are out. So pairs of a grip and an attempt with it are drawn as if the attempt began now, and the first that
lasts longer than the robot has been at it is kept, grip included (rejection sampling). The draws are those of the
world's own law, whatever it is.

The state does not tell how far the object was hidden when the attempt began; it is taken as it is hidden now.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from halfseen.planners.belief import Grip, grip_posterior, known_grasping, known_seeing, offset_nodes
from halfseen.team.actions import WAIT
from halfseen.team.config import TeamConfig
from halfseen.team.state import Pending, TeamHidden, TeamState
from halfseen.world.action_space import Verb
from halfseen.world.grasping import Arrangement
from halfseen.world.state import HiddenState, occlusion

NUM_PROPOSALS = 64
"""Attempts of which the first that may still go on is kept."""


class _Attempts(NamedTuple):
    """Attempts that may go on, and the grips that they were drawn with."""

    offset: Float[Array, "*S"]
    is_held: Bool[Array, "*S"]
    duration_s: Float[Array, "*S"]
    """Transport included, at the robot's speed [s]."""


def sampled_hidden(config: TeamConfig, state: TeamState, key: Array) -> TeamHidden:
    """Draw what nobody knows of one table, given its state alone.

    Raises
    ------
    ArgumentError
        The probabilities of the world's laws are not known, or robots may drop out.
    """
    dirty_key, grip_key, seeing_key, attempt_key = jax.random.split(key, 4)
    world, table, num_objects = config.world, state.table, state.table.num_objects
    grip = grip_posterior(world, table)
    drawn = jax.random.categorical(grip_key, grip.log_weights, axis=-1)
    trait = offset_nodes(world)[drawn]
    keys = jax.random.split(attempt_key, state.robots.num_robots)
    attempts = jax.vmap(lambda robot, key: _going_on(config, state, grip, robot, key))(jnp.arange(len(keys)), keys)
    robots = state.robots
    is_attempt = robots.is_busy & ((robots.verb == Verb.WASH) | (robots.verb == Verb.LIFT))
    # No two robots are at one object.
    is_at = is_attempt[:, None] & (robots.target[:, None] == jnp.arange(num_objects))
    trait = jnp.where(jnp.any(is_at, axis=0), jnp.sum(jnp.where(is_at, attempts.offset[:, None], 0.0), axis=0), trait)
    hidden = HiddenState(
        is_dirty=jax.random.uniform(dirty_key, (num_objects,)) < jax.nn.sigmoid(table.log_odds),
        grasp_trait=trait,
        seeing_trait=known_seeing(world).draw_trait(num_objects, seeing_key),
    )
    return TeamHidden(hidden, _pending(config, state, is_attempt, attempts))


def _going_on(config: TeamConfig, state: TeamState, grip: Grip, robot: Int[Array, ""], key: Array) -> _Attempts:
    """Draw how the attempt of a robot goes that has not ended yet."""
    law, table, robots = known_grasping(config.world), state.table, state.robots
    target, num_objects = robots.target[robot], state.table.num_objects
    speed = jnp.asarray(config.speed)[robot]

    def proposed(key: Array) -> _Attempts:
        grip_key, grasp_key = jax.random.split(key)
        offset = offset_nodes(config.world)[jax.random.categorical(grip_key, grip.log_weights[target])]
        arrangement = Arrangement(table.hides, table.is_on_table, occlusion(table), table.grip)
        tried = law.attempt(arrangement, jnp.full(num_objects, offset), robots.verb[robot], target, grasp_key)
        return _Attempts(offset, tried.is_held, (config.world.transport_s + tried.duration_s) / speed)

    proposals = jax.vmap(proposed)(jax.random.split(key, NUM_PROPOSALS))
    # Of two things that end at once, that of the lower robot ends first.
    is_after = jnp.arange(robots.num_robots)[robot] > state.decider
    since_s = robots.since_s[robot]
    goes_on = (proposals.duration_s > since_s) | (is_after & (proposals.duration_s == since_s))
    # Where none does, the longest is the likeliest to.
    kept = jnp.where(jnp.any(goes_on), jnp.argmax(goes_on), jnp.argmax(proposals.duration_s))
    return jax.tree.map(lambda leaf: leaf[kept], proposals)


def _pending(config: TeamConfig, state: TeamState, is_attempt: Bool[Array, " K"], attempts: _Attempts) -> Pending:
    table, robots, num_robots = state.table, state.robots, state.robots.num_robots
    leaving_s = config.world.transport_s / jnp.asarray(config.speed)
    duration_s = jnp.where(is_attempt, attempts.duration_s, leaving_s)
    left_s = jnp.maximum(duration_s - robots.since_s, 0.0)
    left_s = jnp.where(robots.verb == WAIT, jnp.inf, left_s)
    square = (num_robots, table.num_objects, table.num_objects)
    return Pending(
        left_s=jnp.where(robots.is_busy, left_s, jnp.inf),
        duration_s=jnp.asarray(duration_s, dtype=jnp.float32),
        is_held=is_attempt & attempts.is_held,
        occlusion=occlusion(table)[robots.target],
        hides=jnp.broadcast_to(table.hides, square),
        is_moved=jnp.zeros(square, dtype=bool),
    )
