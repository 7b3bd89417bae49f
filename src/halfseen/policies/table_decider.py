"""Decisions at a table, by a learned policy, a planner or a heuristic."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from halfseen.policies.decision import Decision, QError, certainty, lead, next_best, values_by_name
from halfseen.policies.ranges import ROUNDING, RangesOfStage, beyond, everything, refuse_far
from halfseen.shapes import Float
from halfseen.tables.assisted import LawPolicy
from halfseen.tables.explain import TableExplanation, action_reason, implied
from halfseen.tables.policy import LinearTablePolicy
from halfseen.tables.present import Present
from halfseen.world.actions import ActionSpace, Verb
from halfseen.world.config import WorldConfig
from halfseen.world.policy import Policy
from halfseen.world.random import Key, key_of
from halfseen.world.state import TableState

UNBOUNDED = ("num_objects",)
"""Ranges whose quantities are unbounded in what Q looks at; shares, chances and success rates are bounded."""


@dataclass(frozen=True)
class TableDecider:
    """Asks any `halfseen.world.Policy` (a `Decider`).

    Parameters
    ----------
    policy
        The policy.
    ranges
        Ranges of the training logs; a policy that was not learned has none.
    seed
        Seed of a policy that draws, such as a planner; the same seed gives the same decision.
    extrapolates
        Whether to decide even with far more or fewer objects than in the logs.
    q_error
        Errors of a learned Q; None if unknown.
    least_rewards
        The least reward of each verb in the logs [reward]; empty if unknown. A planner knows its own.
    """

    policy: Policy
    ranges: RangesOfStage = everything
    seed: int = 0
    extrapolates: bool = False
    q_error: QError | None = None
    least_rewards: Mapping[str, float] = field(default_factory=dict)

    def decide(self, observation: Present) -> Decision:
        """Decide in the present state of the trajectory.

        Raises
        ------
        PolicyError
            There are far more or fewer objects than in the logs, and extrapolation is not allowed.
        """
        return self.decide_with(observation, key_of(self.seed))

    def decide_with(self, observation: Present, key: Key) -> Decision:
        """Decide with a given key, such as that of a decision to be reproduced.

        Raises
        ------
        PolicyError
            As for `decide`.
        """
        state, names = observation.state, ActionSpace(observation.state.num_objects).names
        ranges, values = self.ranges(observation.stage), observed_values(state)
        if not self.extrapolates:
            refuse_far({name: seen for name, seen in (ranges or {}).items() if name in UNBOUNDED}, values)
        warnings = (*observation.notes, *beyond(ranges, values, ROUNDING))
        explanation = TableExplanation.of(state, observation.dirty_share, self._worst_wash())
        if not hasattr(self.policy, "q_values"):
            action = int(self.policy.decide(state, key).action)
            rule = type(self.policy).__name__
            return Decision(
                names[action], {}, f"{names[action]}: by {rule}; {action_reason(explanation, action)}.", warnings
            )
        q, intervals, chance_best = self._valued(observation, key, names)
        reason = table_reason(explanation, q, chance_best)
        if isinstance(self.policy, LawPolicy):
            reason = f"{reason[:-1]}; {implied(self.policy, state, int(np.argmax(q)))}."
        return Decision(names[int(np.argmax(q))], values_by_name(names, q), reason, warnings, intervals, chance_best)

    def _valued(
        self, observation: Present, key: Key, names: tuple[str, ...]
    ) -> tuple[Float[np.ndarray, " A"], dict[str, tuple[float, float]], dict[str, float]]:
        """The compared values, and the certainty of Q, by name; empty if unknown."""
        policy: Any = self.policy
        state, stage = observation.state, observation.stage
        if not (isinstance(policy, LinearTablePolicy) and policy.margin is not None and self.q_error):
            return _as_floats(policy.q_values(state, key)), {}, {}
        values = policy.q_values(state), policy.estimates(state), policy.deviations(state)
        q, estimates, deviations = map(_as_floats, values)
        blocks = ActionSpace(state.num_objects).verbs
        of_stage = self.q_error.stages_from(stage, stage + int(state.steps_to_go) - 1), self.q_error.lasting
        error = deviations / self.q_error.pessimism
        return q, *certainty(estimates, error, blocks, np.isfinite(estimates), *of_stage).by_name(names)

    def _worst_wash(self) -> float | None:
        config = getattr(self.policy, "config", None)
        if isinstance(config, WorldConfig):
            return float(config.reward_wash_clean)
        return self.least_rewards.get(Verb.WASH.name)


def observed_values(state: TableState) -> dict[str, dict[str, float]]:
    """Values for the ranges of a table policy, by what each belongs to."""
    tried = np.asarray(state.attempt_object)[:, None] == np.arange(state.num_objects)
    each = {
        "occlusion": 1.0 - np.prod(1.0 - np.asarray(state.hides, dtype=np.float64), axis=1),
        "log_odds": np.asarray(state.log_odds, dtype=np.float64),
        "num_attempts": tried.sum(axis=0),
    }
    by_object = {name: {f"{name} of object {k}": float(v) for k, v in enumerate(each[name])} for name in each}
    return {"num_objects": {"num_objects": float(state.num_objects)}, **by_object}


def _as_floats(values: Any) -> np.ndarray:
    return np.asarray(values, dtype=np.float64)


def table_reason(
    explanation: TableExplanation, q: Float[np.ndarray, " A"], chance_best: Mapping[str, float] | None = None
) -> str:
    """Say why the best action of one table is best.

    Parameters
    ----------
    explanation
        Facts about the table that explain an action.
    q
        Q of each action; −∞ where impossible.
    chance_best
        Probability that no action is better, by name; empty if unknown.

    Examples
    --------
    >>> from halfseen.tables.present import first_state
    >>> from halfseen.world import Scene
    >>> state = first_state(Scene(np.array([[0.0, 0.5], [0.0, 0.0]])), horizon=10, dirty_share=0.6).state
    >>> table_reason(TableExplanation.of(state, 0.6), np.array([0.0, 1.0, 0.5, 0.0, 1.8]))
    'LIFT 1: worth 0.80 more than WASH 0; it would uncover 50% of object 0, not labelled yet; as for WASH 0, \
it is half hidden (0.50), and not labelled yet.'
    """
    names, best = ActionSpace(len(explanation.is_there)).names, int(np.argmax(q))
    own = action_reason(explanation, best)
    clauses, other = [lead(names, q, best, chance_best or {}), own], next_best(q, best)
    # The cost of a wrong WASH is stated once.
    free = replace(explanation, worst_wash=None)
    rest = explanation if action_reason(free, best) == own else free
    if other is not None and (against := action_reason(rest, other)) != own:
        clauses.append(f"as for {names[other]}, {against}")
    return f"{'; '.join(clauses)}."
