"""Decisions of a policy of named actions."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from halfseen.lazy import Frame
from halfseen.learning.flat_policy import FlatPolicy, Valued
from halfseen.policies.certainty import QError, certainty
from halfseen.policies.decision import Decision
from halfseen.policies.flat_reason import flat_reason
from halfseen.policies.ranges import RangesOfStage, beyond, everything, refuse_far
from halfseen.policies.reasons import values_by_name


@dataclass(frozen=True, eq=False)
class NamedObservation:
    """Covariates of one stage.

    Parameters
    ----------
    row
        One row, with the covariates of the policy among its columns; or their values by name.
    stage
        The stage to decide, from 1.
    """

    row: Frame | Mapping[str, Any]
    stage: int


@dataclass(frozen=True, eq=False)
class NamedDecider:
    """Asks a policy of named actions (a `Decider`).

    Parameters
    ----------
    policy
        The policy.
    ranges
        What the logs showed where it was learned.
    extrapolates
        Whether to decide where a covariate lies far outside these ranges, too.
    q_error
        What is known of the errors of its Q; None if nothing.
    """

    policy: FlatPolicy
    ranges: RangesOfStage = everything
    extrapolates: bool = False
    q_error: QError | None = None

    def decide(self, observation: NamedObservation) -> Decision:
        """Take the possible action with the largest Q, with pessimism less its margin.

        Raises
        ------
        ArgumentError
            There is no such stage.
        LogError
            A covariate is missing, no finite number, null or of an unknown category.
        PolicyError
            A covariate lies far outside what the logs showed, and it is not to be extrapolated.
        """
        policy, row = self.policy, observation.row
        if isinstance(row, Mapping):
            return self.decide_known(row, observation.stage)
        policy.looks_at.encode(row)
        texts = policy.categories
        values = {name: (str if name in texts else float)(row[name].iloc[0]) for name in policy.covariates}
        return self.decide_known(values, observation.stage)

    def decide_known(self, values: Mapping[str, Any], stage: int) -> Decision:
        """Decide as `decide` does, and faster, from covariates that `looks_at` knows all of.

        Parameters
        ----------
        values
            Finite numbers, and text of known categories, by name.
        stage
            The stage to decide, from 1.

        Raises
        ------
        ArgumentError
            There is no such stage.
        PolicyError
            As `decide`.
        """
        policy = self.policy
        valued = policy.valued(policy.looks_at.encode_known([values]), stage)
        possible = np.where(policy.is_possible[stage - 1], valued.scores[0], -np.inf)
        ranges = self.ranges(stage)
        by_range = {name: {name: value} for name, value in values.items()}
        if not self.extrapolates:
            refuse_far(ranges, by_range)
        names = [str(name) for name in policy.actions]
        intervals, chance_best = self._certainty(valued, stage, names)
        return Decision(
            action=policy.actions[int(np.argmax(possible))],
            q_values=values_by_name(names, possible),
            reason=flat_reason(policy, values, stage, ranges or None, chance_best),
            warnings=beyond(ranges, by_range),
            intervals=intervals,
            chance_best=chance_best,
        )

    def _certainty(
        self, valued: Valued, stage: int, names: list[str]
    ) -> tuple[dict[str, tuple[float, float]], dict[str, float]]:
        """How sure Q is, by name; nothing where nobody knows."""
        policy = self.policy
        if policy.margin is None or self.q_error is None:
            return {}, {}
        q, error = valued.q[0], valued.margins[0] / self.q_error.pessimism
        # Each action has coefficients of its own.
        of_stage = self.q_error.stages_from(stage, policy.horizon), self.q_error.lasting
        blocks, is_possible = np.arange(len(q)), policy.is_possible[stage - 1]
        return certainty(q, error[:, None], blocks, is_possible, *of_stage).by_name(names)
