"""How long a team will be busy after each action, in attempts: the lower bound of scheduling theory [Graham1969]_.

An object is work as far as it promises to be dirty, (4·(p − ½)) within 0 and 1. No plan is done before the robot that
alone can do most has done that, nor before all work is done if it were shared evenly:

    makespan ≥ max( max_r (begun_r + work that r alone reaches),  (Σ_r begun_r + all work) / robots that go on ).

What a robot is at counts 1 as it begins, and less the longer it has been at it.
"""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from halfseen.arrays import Array, expit, library_of
from halfseen.world.others import Others, is_decider
from halfseen.world.state import TableState

FADES_PER_S = 0.03
"""How fast what is begun counts less [1/s]."""
WAITS = 0.5
"""What WAIT begins: half of what another robot is at."""


def makespans(state: TableState, others: Others) -> Float[Array, "*B A"]:
    """Bound of what follows each action, WAIT last; 0 where nothing is left to do.

    Parameters
    ----------
    state
        Of a table with several robots.
    others
        Of that state.
    """
    robots: Any = state.robots
    workspace: Any = state.workspace
    xp, is_me, zero = library_of(state.log_odds), is_decider(state), np.float32(0.0)
    work = xp.clip(4.0 * (expit(state.log_odds) - 0.5), zero, np.float32(1.0))
    work = xp.where(state.is_on_table & ~others.taken, work, zero)
    begun = xp.where(others.is_at_object, xp.exp(-FADES_PER_S * robots.since_s), zero)
    everyone = others.goes_on | is_me

    def bound(goes_on: Bool[Array, "*B K"], mine: float, left: Float[Array, "*L N"]) -> Float[Array, "*L"]:
        each, among = begun + mine * is_me.astype(np.float32), goes_on
        if left.ndim > work.ndim:
            each, among = each[..., None, :], goes_on[..., None, :]
        is_in_reach = workspace.is_in_reach[(..., *(None,) * (left.ndim - work.ndim), slice(None), slice(None))]
        return _bound(among[..., None] & is_in_reach, among, each, left)

    is_kept = ~xp.eye(state.num_objects, dtype=bool)
    of_wash = bound(everyone, 1.0, xp.where(is_kept, work[..., None, :], zero))
    of_lift = xp.broadcast_to(bound(everyone, 1.0, work)[..., None], work.shape)
    finish, wait = bound(others.goes_on, 0.0, work), bound(everyone, WAITS, work)
    return xp.concatenate([finish[..., None], of_wash, of_lift, wait[..., None]], axis=-1)


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
