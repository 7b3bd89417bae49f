"""What the robots that do not decide are at, and what all of them can still reach."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from halfseen.arrays import Array, library_of
from halfseen.world.actions import WAIT, Verb, of_robot
from halfseen.world.state import TableState


class Others(NamedTuple):
    """The robots that do not decide."""

    goes_on: Bool[Array, "*B K"]
    """Which of them will do something yet; who goes home no longer does."""
    is_at_object: Bool[Array, "*B K"]
    """Which of them are at an object."""
    reached: Bool[Array, "*B N"]
    """What on the table those reach that go on."""
    taken: Bool[Array, "*B N"]
    """What they are at."""
    num_at_work: Float[Array, "*B"]
    since_s: Float[Array, "*B"]
    """For how long those that are at work have been at it, in all [s]."""


def is_decider(state: TableState) -> Bool[Array, "*B K"]:
    """Which of several robots decides."""
    decider: Any = state.decider
    return library_of(decider).arange(state.num_robots) == decider[..., None]


def others_of(state: TableState) -> Others:
    """Tell what the robots that do not decide are at, on a table with several."""
    robots: Any = state.robots
    workspace: Any = state.workspace
    xp, is_other = library_of(state.is_on_table), ~is_decider(state)
    goes_on = is_other & ~robots.is_done & ~(robots.is_busy & (robots.verb == Verb.FINISH))
    at_work = is_other & robots.is_busy & (robots.verb != WAIT)
    is_at_object = at_work & (robots.verb > 0)
    is_target = robots.target[..., None] == xp.arange(state.num_objects)
    return Others(
        goes_on=goes_on,
        is_at_object=is_at_object,
        reached=state.is_on_table & xp.any(goes_on[..., None] & workspace.is_in_reach, axis=-2),
        taken=xp.any(is_at_object[..., None] & is_target, axis=-2),
        num_at_work=xp.sum(at_work, axis=-1).astype(np.float32),
        since_s=xp.sum(xp.where(at_work, robots.since_s, np.float32(0.0)), axis=-1),
    )


def reached_by_decider(state: TableState) -> Bool[Array, "*B N"]:
    """What on the table is in reach of the robot that decides."""
    workspace: Any = state.workspace
    return state.is_on_table & of_robot(workspace.is_in_reach, state.decider)
