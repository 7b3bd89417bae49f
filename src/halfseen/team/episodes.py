"""Tables that a team played to their end."""

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from halfseen.team.config import TeamConfig
from halfseen.team.dynamics import start, step
from halfseen.team.policy import TeamPolicy
from halfseen.team.state import Workspace
from halfseen.world.state import Layout


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TeamTotals:
    """What a team earned on each of B tables."""

    reward: Float[Array, "*B"]
    makespan_s: Float[Array, "*B"]
    """The table's clock at the path's own end [s]."""
    num_decisions: Int[Array, "*B"]


@partial(jax.jit, static_argnames="num_episodes")
def evaluate_team(
    config: TeamConfig, layouts: Layout, workspaces: Workspace, policy: TeamPolicy, key: Array, num_episodes: int
) -> TeamTotals:
    """Play tables to their end and keep the totals; table k is layout k modulo their number."""

    def totals(episode: Int[Array, ""]) -> TeamTotals:
        layout, space = jax.tree.map(lambda leaf: leaf[episode % leaf.shape[0]], (layouts, workspaces))
        return _played(config, layout, space, policy, jax.random.fold_in(key, episode))

    return jax.vmap(totals)(jnp.arange(num_episodes))


def _played(config: TeamConfig, layout: Layout, space: Workspace, policy: TeamPolicy, key: Array) -> TeamTotals:
    start_key, world_key, policy_key = jax.random.split(key, 3)
    state, hidden = start(config, layout, space, start_key)
    nothing = TeamTotals(jnp.zeros(()), jnp.zeros(()), jnp.zeros((), dtype=jnp.int32))

    def advance(carry, t):
        before, is_active, totals = carry
        decision = policy.decide(before[0], jax.random.fold_in(policy_key, t))
        *after, outcome = step(config, *before, decision.action, jax.random.fold_in(world_key, t))
        more = TeamTotals(
            totals.reward + outcome.reward, totals.makespan_s + outcome.duration_s, totals.num_decisions + 1
        )
        kept = jax.tree.map(lambda new, old: jnp.where(is_active, new, old), (tuple(after), more), (before, totals))
        return (kept[0], is_active & ~outcome.is_over, kept[1]), None

    num_decisions = config.num_robots * config.world.horizon
    carry = ((state, hidden), jnp.asarray(True), nothing)
    return jax.lax.scan(advance, carry, jnp.arange(num_decisions))[0][2]
