"""Rules of thumb: wash what promises most now, stop when nothing promises anything. They never look twice."""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from halfseen.planners.belief import grasp_chance, grip_posterior, offset_grid
from halfseen.world.actions import FINISH
from halfseen.world.config import WorldConfig
from halfseen.world.policy import Decision, surely
from halfseen.world.state import TableState, occlusion


def wash_worth(
    config: WorldConfig, state: TableState, chance: Float[Array, " N"], counts_penalty: bool
) -> Float[Array, " N"]:
    """Expected reward of one attempt to WASH each object.

    With `counts_penalty` the price of a dirty object left behind, which a success avoids, counts too.
    """
    is_dirty = jax.nn.sigmoid(state.log_odds)
    reward_dirty = config.reward_wash_dirty - (config.reward_dirty_left if counts_penalty else 0.0)
    washed = is_dirty * reward_dirty + (1.0 - is_dirty) * config.reward_wash_clean
    return chance * washed + (1.0 - chance) * config.reward_wash_failed


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class GreedyPolicy:
    """WASH the object with the largest expected reward; FINISH when none is positive.

    Parameters
    ----------
    config
        The world that it believes in.
    uses_history
        Whether the chance of a grasp is updated by the object's past attempts, or is the prior's at its occlusion.
    counts_penalty
        Whether the FINISH penalty that a successful WASH avoids is counted; that makes the rule much stronger.
    """

    config: WorldConfig
    uses_history: bool = field(default=False, metadata={"static": True})
    counts_penalty: bool = field(default=False, metadata={"static": True})

    def decide(self, state: TableState, key: Array) -> Decision:
        """Choose for one table; there is no chance in it."""
        if self.uses_history:
            log_weights = grip_posterior(self.config, state)
        else:
            log_weights = offset_grid(self.config)[1]
        chance = grasp_chance(self.config, occlusion(state), log_weights)
        worth = jnp.where(state.is_on_table, wash_worth(self.config, state, chance, self.counts_penalty), -jnp.inf)
        best = jnp.argmax(worth)
        return surely(jnp.where(worth[best] > 0.0, 1 + best, FINISH).astype(jnp.int32))
