"""A learned Q of tables as a policy: coefficients, and nothing of the learner."""

from typing import Any, ClassVar

import numpy as np
from jaxtyping import Bool, Float, Int

from halfseen.arrays import Array, library_of, record
from halfseen.errors import ArgumentError
from halfseen.learning.choice import leaning, seen_among
from halfseen.learning.q_space import KernelMap
from halfseen.learning.rows import q_values
from halfseen.tables.features import table_features, table_q
from halfseen.tables.margins import deviations, margins
from halfseen.world.actions import ActionSpace, possible_actions
from halfseen.world.policy import Decision, GraspModel, surely
from halfseen.world.random import Key
from halfseen.world.state import TableState


@record
class LinearTablePolicy:
    """argmax over possible actions of Q̂_h(S, a), with h the steps to go; with pessimism, less a margin.

    Parameters
    ----------
    coefficients
        Of Q_1 … Q_T, by steps to go, verb and feature (offset first). Axes in front are of policies; they come before
        those of the states in what is told of these.
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

    coefficients: Float[Array, "*P T K F"]
    grasp: GraspModel | None = None
    kernel_map: KernelMap | None = None
    is_seen: Bool[Array, "T K"] | None = None
    margin: Float[Array, "T K F F"] | None = None
    behaviour: Float[Array, "K G"] | None = None

    num_robots: ClassVar[int] = 1

    def decide(self, state: TableState, key: Key) -> Decision:
        """Choose; deterministic."""
        return surely(library_of(state.log_odds).argmax(self.q_values(state), axis=-1))

    def q_values(self, state: TableState, key: Key | None = None) -> Float[Array, "*B A"]:
        """Q of every action, −∞ where an action is not possible.

        With pessimism, less its margin, which counts less, the more the log takes the action anyway.
        """
        is_possible = self._possible(state)
        if self.margin is None:
            return _where_possible(is_possible, self._q(state))
        raw = table_features(state, self.grasp)
        features, verbs = self._mapped(raw), self._verbs(state)
        margin = margins(self.margin, features, self._to_go(state), self._slices(state))
        if self.behaviour is not None:
            lean = leaning(q_values(self.behaviour, raw, verbs), is_possible)
            margin = (1.0 - lean).astype(margin.dtype) * margin
        return _where_possible(is_possible, q_values(self._coefficients(state), features, verbs) - margin)

    def estimates(self, state: TableState) -> Float[Array, "*B A"]:
        """Q̂ of every action, without any margin; −∞ where an action is not possible."""
        return _where_possible(self._possible(state), self._q(state))

    def deviations(self, state: TableState) -> Float[Array, "*B A F"]:
        """Mᵀ (1, features) of every action: its length is the margin.

        Raises
        ------
        ArgumentError
            There is no margin.
        """
        if self.margin is None:
            raise ArgumentError("the policy has no margin; learn with pessimism")
        features = self._mapped(table_features(state, self.grasp))
        return deviations(self.margin, features, self._to_go(state), self._slices(state))

    def _q(self, state: TableState) -> Float[Array, "*B A"]:
        coefficients = self._coefficients(state)
        if self.kernel_map is None:
            return table_q(coefficients, state, self.grasp)
        return q_values(coefficients, self._mapped(table_features(state, self.grasp)), self._verbs(state))

    def _coefficients(self, state: TableState) -> Float[Array, "*B K F"]:
        return library_of(self.coefficients, state.steps_to_go).take(self.coefficients, self._to_go(state), axis=-3)

    def _mapped(self, features: Float[Array, "*B A F"]) -> Float[Array, "*B A F1"]:
        return features if self.kernel_map is None else self.kernel_map(features)

    def _to_go(self, state: TableState) -> Int[Array, "*B"]:
        """Where those with so many steps to go stand."""
        return state.steps_to_go - 1

    def _verbs(self, state: TableState) -> Int[np.ndarray, " A"]:
        return ActionSpace(state.num_objects).verbs

    def _slices(self, state: TableState) -> list[slice]:
        return ActionSpace(state.num_objects).slices

    def _possible(self, state: TableState) -> Bool[Array, "*B A"]:
        allowed = possible_actions(state)
        if self.is_seen is None:
            return allowed
        is_seen = library_of(allowed).take(self.is_seen, self._to_go(state), axis=0)
        return seen_among(allowed, is_seen[..., self._verbs(state)])


def _where_possible(is_possible: Bool[Array, "*B A"], q: Any) -> Any:
    return library_of(q).where(is_possible, q, np.float32(-np.inf))
