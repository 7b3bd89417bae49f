"""Decisions of a policy of named actions."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from halfseen.learners.q_learning.flat_policy import FlatPolicy
from halfseen.policies.decision import Decision
from halfseen.policies.ranges import RangesOfStage, beyond, everything
from halfseen.policies.reasons import flat_reason, values_by_name


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
    """

    policy: FlatPolicy
    ranges: RangesOfStage = everything

    def decide(self, observation: NamedObservation) -> Decision:
        """Take the possible action with the largest Q, with pessimism less its margin.

        Raises
        ------
        ArgumentError
            There is no such stage.
        LogError
            A covariate is missing, no finite number, null or of an unknown category.
        """
        policy, row, stage = self.policy, observation.row, observation.stage
        q = policy.scores(row, stage)[0]
        possible = np.where(policy.is_possible[stage - 1], q, -np.inf)
        ranges = self.ranges(stage)
        values = {
            name: {name: (str if name in policy.categories else float)(row[name].iloc[0])} for name in policy.covariates
        }
        return Decision(
            action=policy.actions[int(np.argmax(possible))],
            q_values=values_by_name([str(name) for name in policy.actions], possible),
            reason=flat_reason(policy, row, stage, ranges or None),
            warnings=beyond(ranges, values),
        )
