"""Policies of tables with a learned linear Q, without the learner; and action probabilities of any policy.

K robots share one table; a state without robots is that of a single robot. Q is linear in the features of an action
(`halfseen.tables.features`), with one block of coefficients for each verb, or one for all verbs.
"""

from collections.abc import Callable, Sequence
from dataclasses import field, replace
from typing import Any, ClassVar

import numpy as np

from halfseen.arrays import STATIC, Array, at, library_of, mapped, record
from halfseen.errors import ArgumentError
from halfseen.learning.behaviour import excess_propensity, seen_among
from halfseen.learning.q_space import KernelMap
from halfseen.learning.rows import q_values
from halfseen.shapes import Bool, Float, Int
from halfseen.tables.features import table_features, table_q, team_features
from halfseen.world import ExploringPolicy, Policy, UniformPolicy, random
from halfseen.world.actions import WAIT, ActionSpace, Verb, is_decider, possible_actions, worthwhile_actions
from halfseen.world.policy import ByValue, GraspModel, PolicyDraw, check_decides_for, surely
from halfseen.world.random import Key
from halfseen.world.state import TableState


@record
class _LinearPolicy(ByValue):
    """argmax over possible actions of Q̂_h(S, a), with h the steps to go; with pessimism, of Q̂ minus a margin.

    Parameters
    ----------
    coefficients
        Of Q_1 … Q_T, by steps to go, block and feature (offset first). Leading axes index policies; in results they
        precede the axes of the states.
    grasp
        Model of the probability of a grasp in the features; None for the rule of succession.
    kernel_map
        Features of the RKHS; None where Q is linear in the features of the table.
    is_seen
        Which verbs have a value, by steps to go: those that were completed in the log; None for all.
    margin
        M by steps to go and block: the lower confidence bound is Q̂ − ‖Mᵀ (1, features)‖; None without pessimism.
    behaviour
        Coefficients of the behaviour policy on the features of the table, offset first; None if unknown.
    """

    coefficients: Float[Array, "*P T K F"]
    grasp: GraspModel | None = None
    kernel_map: KernelMap | None = None
    is_seen: Bool[Array, "T V"] | None = None
    margin: Float[Array, "T K F F"] | None = None
    behaviour: Float[Array, "K G"] | None = None

    def q_values(self, state: TableState, key: Key | None = None) -> Float[Array, "*B A"]:
        """Q of every action; −∞ where an action may not be chosen.

        With pessimism, minus its margin, which is reduced for actions that the behaviour policy prefers.
        """
        allowed, to_go = self._allowed(state), self._to_go(state)
        coefficients = library_of(self.coefficients, to_go).take(self.coefficients, to_go, axis=-3)
        if self.margin is None and self.kernel_map is None and state.robots is None:
            q = table_q(coefficients, state, self.grasp)
            return library_of(q).where(allowed, q, np.float32(-np.inf))
        features, blocks = self._features(state), self._blocks(state)
        q = q_values(coefficients, self._mapped(features), blocks)
        if self.margin is not None:
            margin = _by_steps(_lengths, self.margin, self._mapped(features), to_go, self._slices(state))
            if self.behaviour is not None:
                lean = excess_propensity(q_values(self.behaviour, features, blocks), allowed)
                margin = (1.0 - lean).astype(margin.dtype) * margin
            q = q - margin
        return library_of(q).where(allowed, q, np.float32(-np.inf))

    def estimates(self, state: TableState) -> Float[Array, "*B A"]:
        """Q̂ of every action, without any margin; −∞ where an action may not be chosen."""
        return replace(self, margin=None).q_values(state)

    def deviations(self, state: TableState) -> Float[Array, "*B A F"]:
        """Mᵀ (1, features) of every action: its length is the margin.

        Raises
        ------
        ArgumentError
            There is no margin.
        """
        if self.margin is None:
            raise ArgumentError("the policy has no margin; learn with pessimism")
        features = self._mapped(self._features(state))
        return _by_steps(_deviations, self.margin, features, self._to_go(state), self._slices(state))

    def _features(self, state: TableState) -> Float[Array, "*B A F"]:
        return (table_features if state.robots is None else team_features)(state, self.grasp)

    def _mapped(self, features: Float[Array, "*B A F"]) -> Float[Array, "*B A F1"]:
        return features if self.kernel_map is None else self.kernel_map(features)

    def _to_go(self, state: TableState) -> Int[Array, "*B"]:
        """Index of Q among the T: by steps to go, or by the decisions to go of all robots together."""
        if state.robots is None:
            return state.steps_to_go - 1
        xp, each = library_of(state.robots.decisions_to_go), state.robots.decisions_to_go
        return xp.clip(xp.sum(each, axis=-1), 1, self.coefficients.shape[-3]) - 1

    def _blocks(self, state: TableState) -> Int[np.ndarray, " A"]:
        verbs = verbs_of(state)
        return verbs if self.coefficients.shape[-2] > 1 else np.zeros_like(verbs)

    def _slices(self, state: TableState) -> list[slice]:
        return ActionSpace(state.num_objects).slices if self.coefficients.shape[-2] > 1 else [slice(None)]

    def _allowed(self, state: TableState) -> Bool[Array, "*B A"]:
        allowed = worthwhile_actions(state)
        if self.is_seen is None:
            return allowed
        is_seen = library_of(allowed).take(self.is_seen, self._to_go(state), axis=0)
        return seen_among(allowed, is_seen[..., verbs_of(state)])


@record
class LinearTablePolicy(_LinearPolicy):
    """Decides for a single robot; one block of coefficients for each verb."""

    num_robots: ClassVar[int] = 1


@record
class LinearTeamPolicy(_LinearPolicy):
    """Decides for the free robot of a team; one block of coefficients for all verbs.

    Where Q̂ is that of a base policy, the base decides unless the maximum of Q̂ exceeds the value of its action by more
    than `caution`: one step of policy iteration, one robot at a time. The caution guards it against errors of Q̂.

    Parameters
    ----------
    num_robots
        Number of robots for which it was learned; None if unknown.
    base
        The team policy whose Q this is; None if it is the Q of the best policy.
    caution
        Least gain over the action of `base` that another action must have [reward].
    """

    num_robots: int | None = field(default=None, metadata=STATIC)
    base: Policy | None = None
    caution: float | Array = 0.0

    @property
    def num_stages(self) -> int:
        """Number of decisions of all robots together for which it was learned."""
        return len(self.coefficients)

    def decide(self, state: TableState, key: Key) -> PolicyDraw:
        """Choose an action, deterministically."""
        q = self.q_values(state)
        xp = library_of(q)
        best = xp.argmax(q, axis=-1)
        if self.base is None:
            return surely(best)
        of_base = self.base.decide(state, key).action
        return surely(xp.where(at(q, best) - at(q, of_base) > self.caution, best, of_base))


def verbs_of(state: TableState) -> Int[np.ndarray, " A"]:
    """Verb of each action; WAIT comes last where there are robots."""
    verbs = ActionSpace(state.num_objects).verbs
    return verbs if state.robots is None else np.append(verbs, WAIT)


def _by_steps(
    asked: Callable[[Any, Any, Sequence[slice]], Any],
    margin: Float[Array, "T K F F"],
    features: Any,
    to_go: Int[Array, "*B"],
    blocks: Sequence[slice],
) -> Any:
    """Process states with equal steps to go together: copying an M for each state takes far longer."""
    xp = library_of(margin, features, to_go)
    if xp is not np:
        return asked(xp.take(margin, to_go, axis=0), features, blocks)
    steps = np.unique(to_go)
    if len(steps) == 1:
        return asked(margin[steps[0]], features, blocks)
    states, place = features.reshape(-1, *features.shape[-2:]), np.ravel(to_go)
    order = np.argsort(place, kind="stable")
    found = np.concatenate([asked(margin[step], states[place == step], blocks) for step in steps])
    return found[np.argsort(order)].reshape(*features.shape[:-1], *found.shape[2:])


def _deviations(margin: Any, features: Any, blocks: Sequence[slice]) -> Any:
    """Mᵀ (1, φ) of every action; `blocks` are the slices of the actions of the K blocks."""
    each = [margin[..., k, :1, :] + features[..., block, :] @ margin[..., k, 1:, :] for k, block in enumerate(blocks)]
    return library_of(features, margin).concatenate(each, axis=-2)


def _lengths(margin: Any, features: Any, blocks: Sequence[slice]) -> Any:
    xp = library_of(features, margin)
    return xp.sqrt(xp.sum(_deviations(margin, features, blocks) ** 2, axis=-1))


def table_probabilities(policy: Any, states: TableState) -> Float[np.ndarray, "n T A"]:
    """π(a | S_t) of any deterministic `halfseen.world.Policy`, or one mixed with `UniformPolicy`.

    NaN where the policy draws its actions with unknown probabilities.

    Parameters
    ----------
    policy
        The policy.
    states
        States of a log, axes (n, T).

    Raises
    ------
    ArgumentError
        `policy` is not a policy.
    PolicyError
        It is for another number of robots.
    """
    if not isinstance(policy, Policy):
        raise ArgumentError(f"{type(policy).__name__} does not decide about tables; give a policy of tables")
    _check_number(policy, states)
    return _probabilities(policy, states)


def _probabilities(policy: Any, states: TableState) -> Float[np.ndarray, "*B A"]:
    is_possible = possible_actions(states)
    uniform = is_possible / np.sum(is_possible, axis=-1, keepdims=True)
    if isinstance(policy, UniformPolicy):
        return uniform
    if isinstance(policy, ExploringPolicy):
        return policy.random_share * uniform + (1.0 - policy.random_share) * _probabilities(policy.base, states)
    decision = _decision(policy, states)
    is_taken = np.arange(is_possible.shape[-1]) == decision.action[..., None]
    return np.where(decision.probability[..., None] == 1.0, is_taken.astype(np.float64), np.nan)


def decisions(policy: Any, states: TableState) -> Int[np.ndarray, "*B"]:
    """Action of a deterministic policy in each state.

    Raises
    ------
    ArgumentError
        The policy draws its actions at random.
    PolicyError
        It is for another number of robots.
    """
    _check_number(policy, states)
    decision = _decision(policy, states)
    # A deterministic policy reports probability 1; the probability of a planner's choice is unknown, NaN.
    if not (decision.probability == 1.0).all():
        raise ArgumentError(
            f"{type(policy).__name__} draws its actions, so a state does not determine them; give a "
            "deterministic policy"
        )
    return decision.action


def _check_number(policy: Any, states: TableState) -> None:
    if states.robots is not None or getattr(policy, "num_robots", None) not in (None, 1):
        check_decides_for(policy, states.num_robots)


def _decision(policy: Any, states: TableState) -> PolicyDraw:
    keys = np.broadcast_to(random.key_of(0), (*states.is_object.shape[:-1], 2))
    return policy.decide(states, keys)


@record
class IndependentPolicies:
    """A team without coordination: each robot ignores objects that another one is at or near.

    Parameters
    ----------
    policies
        Policy of each robot, such as one that learned from its own view of a log (`halfseen.tables.agent_view`).

    Raises
    ------
    ArgumentError
        `policies` is empty.
    """

    policies: tuple[Policy, ...]

    def __post_init__(self) -> None:
        if not self.policies:
            raise ArgumentError("policies is (): give the policy of each robot, at least one")

    @property
    def num_robots(self) -> int:
        """K, the robots of the team."""
        return len(self.policies)

    def decide(self, state: TableState, key: Key) -> PolicyDraw:
        """Choose by the policy of the deciding robot."""
        table, xp = own_table(state), library_of(state.log_odds)
        found, *rest = [policy.decide(table, key) for policy in self.policies]
        for robot, other in enumerate(rest, start=1):
            is_its_turn = state.decider == robot
            found = mapped(lambda new, old, turn=is_its_turn: xp.where(turn, new, old), other, found)
        return found


def own_table(state: TableState) -> TableState:
    """The table as if the deciding robot were alone: objects that it could act on now, and its own decisions to go."""
    robots: Any = state.robots
    xp = library_of(state.log_odds)
    is_free = possible_actions(state)[..., ActionSpace(state.num_objects).of(Verb.WASH)]
    own_to_go = xp.sum(xp.where(is_decider(state), robots.decisions_to_go, 0), axis=-1)
    to_go = xp.maximum(own_to_go, 1).astype(state.steps_to_go.dtype)
    alone = {"robots": None, "workspace": None, "decider": None, "attempt_robot": None}
    return replace(state, is_on_table=is_free, steps_to_go=to_go, **alone)
