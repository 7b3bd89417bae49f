"""A learned Q of tables as a policy: coefficients, and nothing of the learner."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from halfseen.errors import ArgumentError
from halfseen.learning.choice import leaning
from halfseen.learning.kernel_map import KernelMap
from halfseen.learning.support import seen_among
from halfseen.learning.transitions import q_values
from halfseen.tables.features import table_features, table_q
from halfseen.world.action_space import ActionSpace, possible_actions
from halfseen.world.grasp_model import GraspModel
from halfseen.world.policy import Decision, surely
from halfseen.world.state import TableState


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class LinearTablePolicy:
    """argmax over possible actions of Q̂_h(S, a), with h the steps to go; with pessimism, less a margin.

    Parameters
    ----------
    coefficients
        Of Q_1 … Q_T, by steps to go, verb and feature (offset first).
    grasp
        What tells the probability of a grasp in the features; None for the rule of succession.
    kernel_map
        Features of the RKHS; None where Q is linear in the features of the table.
    is_seen
        Which verbs have a value, by steps to go: those that the log has seen completed; None for all.
    margin
        M by steps to go and verb: the lower confidence bound is Q̂ − ‖Mᵀ (1, features)‖; None without pessimism.
    behaviour
        Coefficients of the behaviour policy on the features of the table, the offset first; None if not known.
    """

    coefficients: Float[Array, "*B T K F"]
    grasp: GraspModel | None = None
    kernel_map: KernelMap | None = None
    is_seen: Bool[Array, "T K"] | None = None
    margin: Float[Array, "*B T K F F"] | None = None
    behaviour: Float[Array, "K G"] | None = None

    def q_values(self, state: TableState, key: Array | None = None) -> Float[Array, " A"]:
        """Q of every action of one table, −∞ where an action is not possible.

        With pessimism, less its margin, which counts less, the more the log takes the action anyway.
        """
        q = self._q(state)
        if self.margin is not None:
            q = q - (1.0 - self._leaning(state)) * jnp.linalg.norm(self.deviations(state), axis=-1)
        return jnp.where(self._possible(state), q, -jnp.inf)

    def estimates(self, state: TableState) -> Float[Array, " A"]:
        """Q̂ of every action of one table, without any margin; −∞ where an action is not possible."""
        return jnp.where(self._possible(state), self._q(state), -jnp.inf)

    def deviations(self, state: TableState) -> Float[Array, "A F"]:
        """Mᵀ (1, features) of every action of one table: its length is the margin.

        Raises
        ------
        ArgumentError
            There is no margin.
        """
        if self.margin is None:
            raise ArgumentError("the policy has no margin; learn with pessimism")
        each = self.margin[state.steps_to_go - 1][self._verbs(state)]
        return each[:, 0] + jnp.einsum("af,afg->ag", self._features(state), each[:, 1:])

    def _q(self, state: TableState) -> Float[Array, " A"]:
        coefficients = self.coefficients[state.steps_to_go - 1]
        if self.kernel_map is None:
            return table_q(coefficients, state, self.grasp)
        return q_values(coefficients, self._features(state), self._verbs(state))

    def _leaning(self, state: TableState) -> Float[Array, " A"]:
        if self.behaviour is None:
            return jnp.zeros(len(self._verbs(state)))
        utility = q_values(self.behaviour, table_features(state, self.grasp), self._verbs(state))
        return jnp.asarray(leaning(utility, self._possible(state)))

    def _features(self, state: TableState) -> Float[Array, "A F1"]:
        features = table_features(state, self.grasp)
        return features if self.kernel_map is None else jnp.asarray(self.kernel_map(features))

    def _verbs(self, state: TableState) -> Int[Array, " A"]:
        return jnp.asarray(ActionSpace(state.num_objects).verbs)

    def decide(self, state: TableState, key: Array) -> Decision:
        """Choose for one table; deterministic."""
        return surely(jnp.argmax(self.q_values(state)).astype(jnp.int32))

    def _possible(self, state: TableState) -> Bool[Array, " A"]:
        allowed = possible_actions(state)
        if self.is_seen is None:
            return allowed
        return jnp.asarray(seen_among(allowed, self.is_seen[state.steps_to_go - 1][self._verbs(state)]))
