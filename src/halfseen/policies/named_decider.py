"""Decisions of a policy of named actions."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from halfseen.learners.q_learning.flat_policy import FlatPolicy
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
        One row, with the covariates of the policy among its columns.
    stage
        The stage to decide, from 1.
    """

    row: pd.DataFrame
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
        policy, row, stage = self.policy, observation.row, observation.stage
        q = policy.scores(row, stage)[0]
        possible = np.where(policy.is_possible[stage - 1], q, -np.inf)
        ranges = self.ranges(stage)
        values = {
            name: {name: (str if name in policy.categories else float)(row[name].iloc[0])} for name in policy.covariates
        }
        if not self.extrapolates:
            refuse_far(ranges, values)
        names = [str(name) for name in policy.actions]
        intervals, chance_best = self._certainty(row, stage, names)
        return Decision(
            action=policy.actions[int(np.argmax(possible))],
            q_values=values_by_name(names, possible),
            reason=flat_reason(policy, row, stage, ranges or None, chance_best),
            warnings=beyond(ranges, values),
            intervals=intervals,
            chance_best=chance_best,
        )

    def _certainty(
        self, row: pd.DataFrame, stage: int, names: list[str]
    ) -> tuple[dict[str, tuple[float, float]], dict[str, float]]:
        """How sure Q is, by name; nothing where nobody knows."""
        policy = self.policy
        if policy.margin is None or self.q_error is None:
            return {}, {}
        q = policy.q_values(row, stage)[0]
        error = (q - policy.lower_bounds(row, stage)[0]) / self.q_error.pessimism
        # Each action has coefficients of its own.
        of_stage = self.q_error.stages_from(stage, policy.horizon), self.q_error.lasting
        blocks, is_possible = np.arange(len(q)), policy.is_possible[stage - 1]
        return certainty(q, error[:, None], blocks, is_possible, *of_stage).by_name(names)
