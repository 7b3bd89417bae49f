"""Rules of thumb: wash what promises most now, stop when nothing promises anything. They never lift to look."""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from halfseen.errors import ArgumentError
from halfseen.planners.belief import grasp_probability, grip_posterior, prior_grip
from halfseen.world.action_space import FINISH, ActionSpace, Verb
from halfseen.world.config import WorldConfig
from halfseen.world.grasp_model import GraspModel
from halfseen.world.policy import Decision, surely
from halfseen.world.state import TableState, occlusion


def wash_worth(
    config: WorldConfig, is_dirty: Float[Array, "*S"], probability: Float[Array, "*S"], counts_penalty: bool | Array
) -> Float[Array, "*S"]:
    """Expected reward of one attempt to WASH an object that is dirty with probability `is_dirty`.

    With `counts_penalty` the price of a dirty object left behind, which a success avoids, counts too.
    """
    reward_dirty = config.reward_wash_dirty - counts_penalty * config.reward_dirty_left
    washed = is_dirty * reward_dirty + (1.0 - is_dirty) * config.reward_wash_clean
    return probability * washed + (1.0 - probability) * config.reward_wash_failed


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TrueGrasp:
    """The true probability of a grasp, the hidden grip offset integrated out: a `GraspModel` that knows the world.

    Parameters
    ----------
    config
        The world.
    uses_history
        Whether the grip offset's distribution is the posterior given the object's past attempts, or the prior.
    """

    config: WorldConfig
    uses_history: bool = field(default=True, metadata={"static": True})

    def probability(self, state: TableState) -> Float[Array, " N"]:
        """P(an attempt succeeds) for each object of one table."""
        grip = grip_posterior(self.config, state) if self.uses_history else prior_grip(state.grip)
        return grasp_probability(self.config, occlusion(state), grip)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class GreedyPolicy:
    """WASH the object with the largest expected reward; FINISH when none is positive.

    Parameters
    ----------
    config
        The world that it believes in.
    uses_history
        Whether the probability of a grasp is updated by the object's past attempts, or is the prior's at its occlusion.
    counts_penalty
        Whether the FINISH penalty that a successful WASH avoids is counted; that makes the rule much stronger.
    grasp
        What tells the probability of a grasp in place of the true model; it needs `uses_history`.

    Raises
    ------
    ArgumentError
        `grasp` is given and `uses_history` is False.
    """

    config: WorldConfig
    uses_history: bool = field(default=False, metadata={"static": True})
    counts_penalty: bool | Array = False
    grasp: GraspModel | None = None

    def __post_init__(self) -> None:
        if self.grasp is not None and not self.uses_history:
            raise ArgumentError("grasp is given and uses_history is False; a grasp model looks at the history")

    def worth(self, state: TableState) -> Float[Array, " N"]:
        """Expected reward of an attempt to WASH each object of one table; −∞ where it does not stand there."""
        grasp = TrueGrasp(self.config, self.uses_history) if self.grasp is None else self.grasp
        probability = grasp.probability(state)
        worth = wash_worth(self.config, jax.nn.sigmoid(state.log_odds), probability, self.counts_penalty)
        return jnp.where(state.is_on_table, worth, -jnp.inf)

    def decide(self, state: TableState, key: Array) -> Decision:
        """Choose for one table; nothing is drawn."""
        worth = self.worth(state)
        best = jnp.argmax(worth)
        wash = ActionSpace(state.num_objects).encode(Verb.WASH, best)
        return surely(jnp.where(worth[best] > 0.0, wash, FINISH).astype(jnp.int32))
