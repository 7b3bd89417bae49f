"""A learned Q of a team as a policy: what is best by it, or where it is sure to improve on what each does alone."""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from halfseen.learning.choice import leaning
from halfseen.learning.support import seen_among
from halfseen.learning.transitions import q_values
from halfseen.team.actions import WAIT, worthwhile_actions
from halfseen.team.features import team_features
from halfseen.team.policy import TeamPolicy
from halfseen.team.state import TeamState
from halfseen.world.action_space import ActionSpace
from halfseen.world.grasp_model import GraspModel
from halfseen.world.policy import Decision, surely


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class LinearTeamPolicy:
    """argmax over what the robot that decides may do of Q̂_h, with h the decisions to go of all robots together.

    Where Q̂ is that of a base policy, the base decides unless that maximum is worth more than the base's own action by
    more than `caution`: one step of policy iteration, one robot at a time, that Q̂'s errors are not to undo.

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
    base
        The policy of a team whose Q this is; None if it is that of the best.
    caution
        By how much another action must be better than that of `base`, in units of reward.
    """

    coefficients: Float[Array, "T K F"]
    grasp: GraspModel | None = None
    is_seen: Bool[Array, "T V"] | None = None
    margin: Float[Array, "T K F F"] | None = None
    behaviour: Float[Array, "K G"] | None = None
    num_robots: int | None = field(default=None, metadata={"static": True})
    base: TeamPolicy | None = None
    caution: float | Array = 0.0

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
        q = self.q_values(state)
        best = jnp.argmax(q).astype(jnp.int32)
        if self.base is None:
            return surely(best)
        of_base = self.base.decide(state, key).action
        return surely(jnp.where(q[best] - q[of_base] > self.caution, best, of_base).astype(jnp.int32))
