"""A learned Q of a team as a policy."""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from halfseen.learners.q_learning.choice import leaning
from halfseen.learners.q_learning.support import seen_among
from halfseen.learners.q_learning.transitions import q_values
from halfseen.team.actions import WAIT, worthwhile_actions
from halfseen.team.features import team_features
from halfseen.team.state import TeamState
from halfseen.world.action_space import ActionSpace
from halfseen.world.grasp_model import GraspModel
from halfseen.world.policy import Decision, surely


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class LinearTeamPolicy:
    """argmax over what the robot that decides may do of Q̂_h, with h the decisions to go of all robots together.

    Parameters
    ----------
    coefficients
        Of Q_1 … Q_T, by decisions to go, for all verbs alike (K = 1), the offset first.
    grasp
        What tells the probability of a grasp in the features; None for the rule of succession.
    is_seen
        Which verbs have a value, by decisions to go; None for all.
    margin
        M by decisions to go; None without pessimism.
    behaviour
        Coefficients of the behaviour policy, which waives margins; None if not known.
    num_robots
        For how many robots it was learned; None if nobody said so.
    """

    coefficients: Float[Array, "T K F"]
    grasp: GraspModel | None = None
    is_seen: Bool[Array, "T V"] | None = None
    margin: Float[Array, "T K F F"] | None = None
    behaviour: Float[Array, "K G"] | None = None
    num_robots: int | None = field(default=None, metadata={"static": True})

    def q_values(self, state: TeamState, key: Array | None = None) -> Float[Array, " A"]:
        """Q of every action, less its margin, measured from leaving the table; −∞ where it is not chosen from."""
        features, allowed = team_features(state, self.grasp), worthwhile_actions(state)
        one_block = jnp.zeros(len(allowed), dtype=jnp.int32)
        to_go = jnp.clip(jnp.sum(state.robots.decisions_to_go), 1, len(self.coefficients)) - 1
        q = q_values(self.coefficients[to_go], features, one_block)
        if self.is_seen is not None:
            verbs = jnp.append(jnp.asarray(ActionSpace(state.table.num_objects).verbs), WAIT)
            allowed = jnp.asarray(seen_among(allowed, self.is_seen[to_go][verbs]))
        if self.margin is not None:
            of_offset, slopes = self.margin[to_go, 0, 0], self.margin[to_go, 0, 1:]
            margin = jnp.linalg.norm(of_offset + features @ slopes, axis=-1)
            if self.behaviour is not None:
                utility = q_values(self.behaviour, features, one_block)
                margin = (1.0 - jnp.asarray(leaning(utility, allowed))) * margin
            q = q - margin
        return jnp.where(allowed, q, -jnp.inf)

    def decide(self, state: TeamState, key: Array) -> Decision:
        """Choose for one table; deterministic."""
        return surely(jnp.argmax(self.q_values(state)).astype(jnp.int32))
