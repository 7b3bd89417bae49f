"""One future of a table, drawn by any dynamics: an action first, then a policy to the path's own end."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from halfseen.world.config import WorldConfig
from halfseen.world.episodes import Dynamics
from halfseen.world.state import HiddenState, TableState


class Future(NamedTuple):
    """What a future brought, and where it ended."""

    reward: Float[Array, ""]
    state: Any
    hidden: Any


def future(
    dynamics: Dynamics, config: Any, now: tuple[Any, Any], action: Int[Array, ""], policy: Any, key: Array
) -> Future:
    """Draw one future of one table.

    Parameters
    ----------
    dynamics
        Of one robot, or of a team.
    config
        What the dynamics take.
    now
        The state, and what is hidden in it.
    action
        The first action; a path of one robot must not be over.
    policy
        What decides ever after.
    key
        What is drawn from; stage by stage, so that futures that begin with other actions meet like draws.
    """
    world_key, policy_key = jax.random.split(key)

    def follow(carry: tuple[Future, Array, Array, Array]) -> tuple[Future, Array, Array, Array]:
        so_far, action, t, _ = carry
        at = jax.random.fold_in(world_key, t)
        state, hidden, outcome = dynamics.step(config, so_far.state, so_far.hidden, action, at)
        after = policy.decide(state, jax.random.fold_in(policy_key, t)).action.astype(action.dtype)
        return Future(so_far.reward + outcome.reward, state, hidden), after, t + 1, outcome.is_over

    begin = Future(jnp.zeros((), dtype=jnp.float32), *now), action, jnp.asarray(0), jnp.asarray(False)
    return jax.lax.while_loop(lambda carry: ~carry[3], follow, begin)[0]


def as_expected(
    config: WorldConfig,
    reward: Float[Array, ""],
    is_at_stake: Bool[Array, " N"],
    table: TableState,
    hidden: HiddenState,
) -> Float[Array, ""]:
    """What a future is worth once what it drew of being dirty is integrated out, given all that was seen in it.

    The mean over futures stays, and much of their noise goes (Rao–Blackwell): an object's log-odds say all that was
    seen of it, up to the moment in which it left.

    Parameters
    ----------
    config
        The world.
    reward
        Of the future.
    is_at_stake
        What stood on the table as it began.
    table, hidden
        As it ended.
    """
    gone = is_at_stake & ~table.is_on_table
    if_dirty = jnp.where(gone, config.reward_wash_dirty, config.reward_dirty_left)
    if_clean = jnp.where(gone, config.reward_wash_clean, 0.0)
    excess = (jax.nn.sigmoid(table.log_odds) - hidden.is_dirty) * (if_dirty - if_clean)
    return reward + jnp.sum(jnp.where(is_at_stake, excess, 0.0))
