"""What the robots that do not decide are at, and what all of them can still reach.

How long a team will be busy after each action, in attempts: the lower bound of scheduling theory [Graham1969]_.

An object is work as far as it promises to be dirty, (4·(p − ½)) within 0 and 1. No plan is done before the robot that
alone can do most has done that, nor before all work is done if it were shared evenly:

    makespan ≥ max( max_r (begun_r + work that r alone reaches),  (Σ_r begun_r + all work) / robots that go on ).

What a robot is at counts 1 as it begins, and less the longer it has been at it.
"""

from typing import Any, NamedTuple

import numpy as np

from halfseen.arrays import Array, expit, library_of
from halfseen.shapes import Bool, Float
from halfseen.world.actions import WAIT, Verb, is_decider, of_robot
from halfseen.world.state import TableState


class Others(NamedTuple):
    """The robots that do not decide."""

    goes_on: Bool[Array, "*B K"]
    """Which of them will do something yet; who goes home no longer does."""
    is_at_object: Bool[Array, "*B K"]
    reached: Bool[Array, "*B N"]
    """What on the table those reach that go on."""
    taken: Bool[Array, "*B N"]
    num_at_work: Float[Array, "*B"]
    since_s: Float[Array, "*B"]
    """For how long those that are at work have been at it, in all [s]."""


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


FADES_PER_S = 0.03
"""How fast what is begun counts less [1/s]."""
WAITS = 0.5
"""What WAIT begins: half of what another robot is at."""


def makespans(state: TableState, others: Others) -> Float[Array, "*B A"]:
    """Bound of what follows each action, WAIT last; 0 where nothing is left to do."""
    robots: Any = state.robots
    workspace: Any = state.workspace
    xp, is_me, zero, num = library_of(state.log_odds), is_decider(state), np.float32(0.0), state.num_objects
    work = xp.clip(4.0 * (expit(state.log_odds) - 0.5), zero, np.float32(1.0))
    work = xp.where(state.is_on_table & ~others.taken, work, zero)
    begun = xp.where(others.is_at_object, xp.exp(-FADES_PER_S * robots.since_s), zero)
    # Rows: FINISH, WASH of each object, any LIFT, WAIT.
    is_kept = xp.asarray(np.concatenate([np.ones((1, num)), 1 - np.eye(num), np.ones((2, num))]) > 0)
    begins = xp.asarray([0.0, *[1.0] * (num + 1), WAITS], dtype=np.float32)[:, None]
    goes_on = others.goes_on[..., None, :] | (is_me[..., None, :] & (begins > 0.0))
    each = begun[..., None, :] + begins * is_me[..., None, :].astype(np.float32)
    left = xp.where(is_kept, work[..., None, :], zero)
    bound = _bound(goes_on[..., None] & workspace.is_in_reach[..., None, :, :], goes_on, each, left)
    of_lift = xp.broadcast_to(bound[..., -2:-1], work.shape)
    return xp.concatenate([bound[..., : num + 1], of_lift, bound[..., -1:]], axis=-1)


def _bound(
    reach: Bool[Array, "*#L K N"],
    goes_on: Bool[Array, "*#L K"],
    begun: Float[Array, "*#L K"],
    work: Float[Array, "*L N"],
) -> Float[Array, "*L"]:
    xp, zero = library_of(work), np.float32(0.0)
    num_reaching = xp.sum(reach, axis=-2)
    alone = xp.sum(xp.where(reach & (num_reaching == 1)[..., None, :], work[..., None, :], zero), axis=-1)
    longest = xp.max(xp.where(goes_on, begun + alone, zero), axis=-1)
    total = xp.sum(xp.where(num_reaching > 0, work, zero), axis=-1) + xp.sum(xp.where(goes_on, begun, zero), axis=-1)
    num_going_on = xp.maximum(xp.sum(goes_on, axis=-1), 1).astype(np.float32)
    return xp.maximum(longest, total / num_going_on)
