"""A policy whose rule decides in states with a category that is not in the policy's training log.

In service the policy steps back in such states, and the log records it. The logged action is then what the policy and
its rule would do again. Such a rare category has no coefficient of its own: models treat it as the most frequent
category, and the importance weights correct the error.
"""

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from halfseen.learning.covariates import Categories
from halfseen.learning.discrete_policy import DiscretePolicy
from halfseen.logs import Logs
from halfseen.logs.columns import STEPPED_BACK
from halfseen.shapes import Bool, Float

STAGE = ["trajectory", "stage"]


@dataclass(frozen=True, eq=False)
class WithItsRule:
    """A policy that does what was logged in the stages in which it stepped back.

    Parameters
    ----------
    policy
        The policy.
    actions
        Names of its actions, and of further actions of the rule.
    by_rule
        Trajectory and stage of each decision of the rule.
    """

    policy: DiscretePolicy
    actions: tuple[Hashable, ...]
    by_rule: pd.MultiIndex

    @property
    def covariates(self) -> tuple[str, ...]:
        """Columns that the policy uses."""
        return self.policy.covariates

    @property
    def categories(self) -> Categories:
        """Categories of the covariates that hold text."""
        return self.policy.categories

    @property
    def horizon(self) -> int:
        """Number T of stages."""
        return self.policy.horizon

    @property
    def actions_by_stage(self) -> dict[int, list[Hashable]]:
        """Names of the actions that each stage allows, from 1."""
        return self.policy.actions_by_stage

    def probabilities(self, frame: Any, stage: int) -> Float[np.ndarray, "m A"]:
        """π(a | S): 1 for the action that the policy takes or its rule took."""
        is_by_rule = pd.MultiIndex.from_frame(frame[STAGE]).isin(self.by_rule)
        taken = np.where(is_by_rule, frame["action"].to_numpy(dtype=object), self.policy.decide(frame, stage))
        return (pd.Index(self.actions).get_indexer(taken)[:, None] == np.arange(len(self.actions))).astype(np.float64)


class Served(NamedTuple):
    """A policy, and a log of its service that models can be fitted to."""

    policy: Any
    logs: Logs
    notes: tuple[str, ...] = ()
    """Which categories were replaced, and by which."""


def with_its_rule(policy: Any, logs: Logs) -> Served:
    """Combine a policy with the rule of its service; unchanged if the log has no category unknown to the policy.

    Raises
    ------
    LogError
        A state has an unknown category, and the log does not record that the policy stepped back there.
    """
    stages = logs.stages
    if not isinstance(policy, DiscretePolicy) or not set(policy.covariates) <= set(stages.columns):
        return Served(policy, logs)
    is_new = ~policy.looks_at.knows(stages)
    if not is_new.any():
        return Served(policy, logs)
    # Refuse unknown categories from which the policy did not step back.
    unexplained: Any = stages[is_new & ~_is_by_rule(stages)]
    policy.looks_at.encode(unexplained)
    by_rule: Any = stages[is_new]
    actions = tuple(dict.fromkeys([*policy.actions, *by_rule["action"].tolist()]))
    replaced, notes = _replaced(policy.categories, stages)
    known = Logs(replaced, logs.trajectories, logs.objects, reward_unit=logs.reward_unit, missing=logs.missing)
    return Served(WithItsRule(policy, actions, pd.MultiIndex.from_frame(by_rule[STAGE])), known, notes)


def _is_by_rule(stages: Any) -> Bool[np.ndarray, " m"]:
    if STEPPED_BACK not in stages.columns:
        return np.zeros(len(stages), dtype=bool)
    return (stages[STEPPED_BACK].notna() & stages["action"].notna()).to_numpy()


def _replaced(categories: Categories, stages: Any) -> tuple[Any, tuple[str, ...]]:
    """Replace unknown categories by the most frequent known one, and describe each replacement."""
    columns, notes = {}, []
    for name, known in categories.items():
        values = stages[name].astype(object).map(str)
        is_known = values.isin(known)
        if is_known.all():
            continue
        usual = values[is_known].value_counts().index[0] if is_known.any() else known[0]
        columns[name] = values.where(is_known, usual)
        named, num = ", ".join(map(repr, sorted(set(values[~is_known])))), int((~is_known).sum())
        notes.append(
            f"in {num} {'stage' if num == 1 else 'stages'} {name} is {named}, which the policy does not know: the "
            f"rule decided in its place, and models treat it as {usual!r}"
        )
    return stages.assign(**columns), tuple(notes)
