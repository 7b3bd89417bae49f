"""How long a team will be busy after each action, in attempts: the lower bound of scheduling theory [Graham1969]_.

An object is work as far as it promises to be dirty, (4·(p − ½)) within 0 and 1. No plan is done before the robot that
alone can do most has done that, nor before all work is done if it were shared evenly:

    makespan ≥ max( max_r (begun_r + work that r alone reaches),  (Σ_r begun_r + all work) / robots that go on ).

What a robot is at counts 1 as it begins, and less the longer it has been at it.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from halfseen.team.others import Others
from halfseen.team.state import TeamState

FADES_PER_S = 0.03
"""How fast what is begun counts less [1/s]."""
WAITS = 0.5
"""What WAIT begins: half of what another robot is at."""


def makespans(state: TeamState, others: Others) -> Float[Array, " A"]:
    """Bound of what follows each action, WAIT last; 0 where nothing is left to do.

    Parameters
    ----------
    state
        Of one table.
    others
        Of that state.
    """
    num_objects, num_robots = state.table.num_objects, state.robots.num_robots
    is_me = jnp.arange(num_robots) == state.decider
    work = jnp.clip(4.0 * (jax.nn.sigmoid(state.table.log_odds) - 0.5), 0.0, 1.0)
    work = jnp.where(state.table.is_on_table & ~others.taken, work, 0.0)
    begun = jnp.where(others.is_at_object, jnp.exp(-FADES_PER_S * state.robots.since_s), 0.0)
    everyone = others.goes_on | is_me
    is_target = jnp.eye(num_objects, dtype=bool)

    def bound(goes_on: Bool[Array, " K"], mine: float, left: Float[Array, " N"]) -> Float[Array, ""]:
        return _bound(goes_on[:, None] & state.workspace.is_in_reach, goes_on, begun + mine * is_me, left)

    of_wash = jax.vmap(lambda target: bound(everyone, 1.0, jnp.where(target, 0.0, work)))(is_target)
    of_lift = jnp.full(num_objects, bound(everyone, 1.0, work))
    finish, wait = bound(others.goes_on, 0.0, work), bound(everyone, WAITS, work)
    return jnp.concatenate([finish[None], of_wash, of_lift, wait[None]])


def _bound(
    reach: Bool[Array, "K N"], goes_on: Bool[Array, " K"], begun: Float[Array, " K"], work: Float[Array, " N"]
) -> Float[Array, ""]:
    num_reaching = jnp.sum(reach, axis=0)
    alone = jnp.sum(jnp.where(reach & (num_reaching == 1), work, 0.0), axis=1)
    longest = jnp.max(jnp.where(goes_on, begun + alone, 0.0))
    total = jnp.sum(jnp.where(num_reaching > 0, work, 0.0)) + jnp.sum(jnp.where(goes_on, begun, 0.0))
    return jnp.maximum(longest, total / jnp.maximum(jnp.sum(goes_on), 1))
