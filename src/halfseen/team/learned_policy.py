"""A learned Q of a team as a policy."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from halfseen.learners.q_learning.support import seen_among
from halfseen.learners.q_learning.transitions import q_values
from halfseen.team.actions import WAIT, possible_actions
from halfseen.team.features import team_features
from halfseen.team.state import TeamState
from halfseen.world.action_space import ActionSpace
from halfseen.world.policy import Decision, surely


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class LinearTeamPolicy:
    """argmax over what the robot that decides may do of Q̂_h, with h the decisions to go of all robots together.

    Parameters
    ----------
    coefficients
        Of Q_1 … Q_T, by decisions to go, verb and feature (offset first).
    is_seen
        Which verbs have a value, by decisions to go; None for all.
    margin
        M by decisions to go and verb; None without pessimism.
    """

    coefficients: Float[Array, "T K F"]
    is_seen: Bool[Array, "T K"] | None = None
    margin: Float[Array, "T K F F"] | None = None

    def q_values(self, state: TeamState, key: Array | None = None) -> Float[Array, " A"]:
        """Q of every action, less its margin; −∞ where it is not possible."""
        verbs = jnp.append(jnp.asarray(ActionSpace(state.table.num_objects).verbs), WAIT)
        features = team_features(state)
        to_go = jnp.clip(jnp.sum(state.robots.decisions_to_go), 1, len(self.coefficients)) - 1
        q = q_values(self.coefficients[to_go], features, verbs)
        if self.margin is not None:
            each = self.margin[to_go][verbs]
            q = q - jnp.linalg.norm(each[:, 0] + jnp.einsum("af,afg->ag", features, each[:, 1:]), axis=-1)
        allowed = possible_actions(state)
        if self.is_seen is not None:
            allowed = jnp.asarray(seen_among(allowed, self.is_seen[to_go][verbs]))
        return jnp.where(allowed, q, -jnp.inf)

    def decide(self, state: TeamState, key: Array) -> Decision:
        """Choose for one table; deterministic."""
        return surely(jnp.argmax(self.q_values(state)).astype(jnp.int32))
