"""What the robots that do not decide are at, and what all of them can still reach."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from halfseen.team.actions import WAIT
from halfseen.team.state import TeamState
from halfseen.world.action_space import Verb


class Others(NamedTuple):
    """The robots that do not decide."""

    goes_on: Bool[Array, " K"]
    """Which of them will do something yet; who goes home no longer does."""
    is_at_object: Bool[Array, " K"]
    """Which of them are at an object."""
    reached: Bool[Array, " N"]
    """What on the table those reach that go on."""
    taken: Bool[Array, " N"]
    """What they are at."""
    num_at_work: Float[Array, ""]
    since_s: Float[Array, ""]
    """For how long those that are at work have been at it, in all [s]."""


def others_of(state: TeamState) -> Others:
    """Tell what the robots that do not decide are at."""
    robots = state.robots
    is_other = jnp.arange(robots.num_robots) != state.decider
    goes_on = is_other & ~robots.is_done & ~(robots.is_busy & (robots.verb == Verb.FINISH))
    at_work = is_other & robots.is_busy & (robots.verb != WAIT)
    is_at_object = at_work & (robots.verb > 0)
    is_target = robots.target[:, None] == jnp.arange(state.table.num_objects)
    return Others(
        goes_on=goes_on,
        is_at_object=is_at_object,
        reached=state.table.is_on_table & jnp.any(goes_on[:, None] & state.workspace.is_in_reach, axis=0),
        taken=jnp.any(is_at_object[:, None] & is_target, axis=0),
        num_at_work=jnp.sum(at_work).astype(jnp.float32),
        since_s=jnp.sum(jnp.where(at_work, robots.since_s, 0.0)),
    )


def reached_by_decider(state: TeamState) -> Bool[Array, " N"]:
    """What on the table is in reach of the robot that decides."""
    return state.table.is_on_table & state.workspace.is_in_reach[state.decider]
