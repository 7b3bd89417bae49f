"""A policy whose rule decides in states outside the policy's training log.

In service the policy steps back in such states, and the log records it. The logged action is then what the policy and
its rule would do again. A category that is not in the training log has no coefficient of its own: models treat it as
the most frequent category, and the importance weights correct the error.
"""

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from halfseen.learning.covariates import Categories
from halfseen.learning.discrete_policy import DiscretePolicy
from halfseen.logs import Logs
from halfseen.logs.columns import ARM, RULE, STEPPED_BACK
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
        """Number T of stages, with those that the rule decides alone."""
        stages: Any = self.by_rule.get_level_values("stage")
        return max(self.policy.horizon, int(stages.max()))

    @property
    def actions_by_stage(self) -> dict[int, list[Hashable]]:
        """Names of the actions that each stage allows, from 1."""
        beyond = range(self.policy.horizon + 1, self.horizon + 1)
        return {**self.policy.actions_by_stage, **{stage: list(self.actions) for stage in beyond}}

    def probabilities(self, frame: Any, stage: int) -> Float[np.ndarray, "m A"]:
        """π(a | S): 1 for the action that the policy takes or its rule took."""
        taken = frame["action"].to_numpy(dtype=object)
        if stage <= self.policy.horizon:
            is_by_rule = pd.MultiIndex.from_frame(frame[STAGE]).isin(self.by_rule)
            taken = np.where(is_by_rule, taken, self.policy.decide(frame, stage))
        return (pd.Index(self.actions).get_indexer(taken)[:, None] == np.arange(len(self.actions))).astype(np.float64)


class ServedLog(NamedTuple):
    """A policy, and a log of its service that models can be fitted to."""

    policy: Any
    logs: Logs
    notes: tuple[str, ...] = ()
    """Where the rule decided, and which categories were replaced, and by which."""


def with_its_rule(
    policy: Any, logs: Logs, is_outside: Callable[[Any], Bool[np.ndarray, " m"]] | None = None
) -> ServedLog:
    """Combine a policy with the rule of its service; unchanged if the policy knows each state of the log.

    Parameters
    ----------
    policy
        The policy.
    logs
        The log.
    is_outside
        Whether each of some states lies outside the ranges of the policy's training log, as `StoredPolicy.is_outside`;
        None if these are unknown.

    Raises
    ------
    LogError
        A state has an unknown category, and the log does not record that the policy stepped back there.
    """
    stages = logs.stages
    if not isinstance(policy, DiscretePolicy) or not set(policy.covariates) <= set(stages.columns):
        return ServedLog(policy, logs)
    is_new, is_by_rule = ~policy.looks_at.knows(stages), _is_by_rule(logs)
    is_far = is_by_rule & ~is_new
    if is_outside is None:
        is_far[:] = False
    else:
        # Another policy may have stepped back where this one decides.
        is_far[is_far] = is_outside(stages[is_far])
    is_late = stages["stage"].to_numpy() > policy.horizon
    is_far |= is_late & is_by_rule if is_by_rule[is_late].all() else is_late & False
    if not (is_new | is_far).any():
        return ServedLog(policy, logs)
    # Refuse unknown categories from which the policy did not step back.
    unexplained: Any = stages[is_new & ~is_by_rule]
    policy.looks_at.encode(unexplained)
    by_rule: Any = stages[is_new | is_far]
    actions = tuple(dict.fromkeys([*policy.actions, *by_rule["action"].tolist()]))
    replaced, notes = _replaced(policy.categories, stages)
    if is_far.any():
        where = f"{is_far.sum()} {'stage' if is_far.sum() == 1 else 'stages'}"
        beyond = "the state lies outside the policy's logs, or beyond its horizon"
        notes = (*notes, f"in {where} {beyond}: the rule decided in its place")
    known = Logs(replaced, logs.trajectories, logs.objects, reward_unit=logs.reward_unit, missing=logs.missing)
    return ServedLog(WithItsRule(policy, actions, pd.MultiIndex.from_frame(by_rule[STAGE])), known, notes)


def _is_by_rule(logs: Logs) -> Bool[np.ndarray, " m"]:
    """Whether the policy stepped back; or would have, in a trajectory that a comparison dealt to the rule.

    There, the log's probability is that of both arms together, so it is 1 where both take the action.
    """
    stages, trajectories = logs.stages, logs.trajectories
    is_by_rule = np.zeros(len(stages), dtype=bool)
    if STEPPED_BACK in stages.columns:
        is_by_rule |= stages[STEPPED_BACK].notna().to_numpy()
    if ARM in trajectories.columns and "probability" in stages.columns:
        of_rule: Any = trajectories["trajectory"][trajectories[ARM].eq(RULE).fillna(False)]
        is_sure = stages["trajectory"].isin(of_rule.tolist()) & stages["probability"].eq(1.0).fillna(False)
        is_by_rule |= is_sure.to_numpy(dtype=bool)
    return is_by_rule & stages["action"].notna().to_numpy()


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
