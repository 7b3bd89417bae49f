"""A learned Q of tables, or of a team, as a policy: coefficients, and nothing of the learner."""

from collections.abc import Callable, Sequence
from dataclasses import field
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Bool, Float, Int

from halfseen.arrays import STATIC, Array, at, library_of, record
from halfseen.errors import ArgumentError
from halfseen.learning.behaviour import leaning, seen_among
from halfseen.learning.q_space import KernelMap
from halfseen.learning.rows import q_values
from halfseen.tables.features import table_features, table_q
from halfseen.tables.team_features import team_features
from halfseen.world.actions import WAIT, ActionSpace, possible_actions, worthwhile_actions
from halfseen.world.policy import Decision, GraspModel, Policy, surely
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
        margin = _waived(margin, self.behaviour, raw, verbs, is_possible)
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


def _waived(margin: Any, behaviour: Any, features: Any, blocks: Any, is_possible: Any) -> Any:
    """Margins, which count less, the more the behaviour policy takes an action anyway."""
    if behaviour is None:
        return margin
    lean = leaning(q_values(behaviour, features, blocks), is_possible)
    return (1.0 - lean).astype(margin.dtype) * margin


def _where_possible(is_possible: Bool[Array, "*B A"], q: Any) -> Any:
    return library_of(q).where(is_possible, q, np.float32(-np.inf))


@record
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
    num_robots: int | None = field(default=None, metadata=STATIC)
    base: Policy | None = None
    caution: float | Array = 0.0

    @property
    def num_stages(self) -> int:
        """Decisions of all robots together, for which it was learned."""
        return len(self.coefficients)

    def q_values(self, state: TableState, key: Key | None = None) -> Float[Array, "*B A"]:
        """Q of every action, less its margin, measured from leaving the table; −∞ where it is not chosen from."""
        features, allowed = team_features(state, self.grasp), worthwhile_actions(state)
        xp, one_block = library_of(features), np.zeros(allowed.shape[-1], dtype=np.int32)
        to_go = self._to_go(state)
        q = q_values(xp.take(self.coefficients, to_go, axis=0), features, one_block)
        if self.is_seen is not None:
            verbs = np.append(ActionSpace(state.num_objects).verbs, WAIT)
            allowed = seen_among(allowed, xp.take(self.is_seen, to_go, axis=0)[..., verbs])
        if self.margin is not None:
            margin = margins(self.margin, features, to_go, [slice(None)])
            q = q - _waived(margin, self.behaviour, features, one_block, allowed)
        return _where_possible(allowed, q)

    def _to_go(self, state: TableState) -> Int[Array, "*B"]:
        assert state.robots is not None
        xp = library_of(state.robots.decisions_to_go)
        return xp.clip(xp.sum(state.robots.decisions_to_go, axis=-1), 1, len(self.coefficients)) - 1

    def decide(self, state: TableState, key: Key) -> Decision:
        """Choose; deterministic."""
        q = self.q_values(state)
        xp = library_of(q)
        best = xp.argmax(q, axis=-1)
        if self.base is None:
            return surely(best)
        of_base = self.base.decide(state, key).action
        return surely(xp.where(at(q, best) - at(q, of_base) > self.caution, best, of_base))


def margins(
    margin: Float[Array, "T K F F"],
    features: Float[Array, "*B A F1"],
    to_go: Int[Array, "*B"],
    blocks: Sequence[slice],
) -> Float[Array, "*B A"]:
    """Length of the deviations of every action.

    Parameters
    ----------
    margin
        M.
    features
        φ, without the constant.
    to_go
        Which M of the T.
    blocks
        Where the actions of each of the K blocks stand.
    """

    def length(each: Any, of: Any) -> Any:
        return library_of(of).sqrt(library_of(of).sum(_deviations(each, of, blocks) ** 2, axis=-1))

    return _by_steps(length, margin, features, to_go)


def deviations(
    margin: Float[Array, "T K F F"],
    features: Float[Array, "*B A F1"],
    to_go: Int[Array, "*B"],
    blocks: Sequence[slice],
) -> Float[Array, "*B A F"]:
    """Mᵀ (1, φ) of every action; parameters as `margins` has them."""
    return _by_steps(lambda each, of: _deviations(each, of, blocks), margin, features, to_go)


def _by_steps(
    asked: Callable[[Any, Any], Any], margin: Float[Array, "T K F F"], features: Any, to_go: Int[Array, "*B"]
) -> Any:
    """Ask for the states of each number of steps to go at once: to copy an M for each state takes far longer."""
    xp = library_of(margin, features, to_go)
    if xp is not np:
        return asked(xp.take(margin, to_go, axis=0), features)
    steps = np.unique(to_go)
    if len(steps) == 1:
        return asked(margin[steps[0]], features)
    states, place = features.reshape(-1, *features.shape[-2:]), np.ravel(to_go)
    order = np.argsort(place, kind="stable")
    found = np.concatenate([asked(margin[step], states[place == step]) for step in steps])
    return found[np.argsort(order)].reshape(*features.shape[:-1], *found.shape[2:])


def _deviations(margin: Any, features: Any, blocks: Sequence[slice]) -> Any:
    each = [margin[..., k, :1, :] + features[..., block, :] @ margin[..., k, 1:, :] for k, block in enumerate(blocks)]
    return library_of(features, margin).concatenate(each, axis=-2)
