"""Decisions of policies of named actions, from the covariates of one stage, and their reasons."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np

from halfseen.errors import ArgumentError, LogError, PolicyError
from halfseen.lazy import Frame
from halfseen.learning.discrete_policy import DiscretePolicy, Valued
from halfseen.policies.decision import (
    Decision,
    QError,
    certainty,
    lead,
    least_gap,
    next_best,
    values_by_name,
    written_gap,
)
from halfseen.policies.ranges import (
    Margins,
    Range,
    Ranges,
    RangesOfStage,
    beyond,
    everything,
    middle_of,
    no_margins,
    refuse_far,
    refuse_outside,
)


@dataclass(frozen=True, eq=False)
class NamedObservation:
    """Covariates of one stage.

    Parameters
    ----------
    row
        A frame of one row, with the covariates of the policy among its columns; or their values by name.
    stage
        The stage to decide, from 1.
    last
        Covariates of the previous stage of the trajectory, filled in, for the rule ``"last"``; None if there is none.
    filled
        Covariates already filled in, each with a sentence that gives the replacement.
    """

    row: Frame | Mapping[str, Any]
    stage: int
    last: Mapping[str, Any] | None = None
    filled: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class NamedDecider:
    """Asks a policy of named actions (a `Decider`).

    Parameters
    ----------
    policy
        The policy.
    ranges
        What the training logs showed of each covariate.
    extrapolates
        Whether to decide even if a covariate lies far outside these ranges.
    q_error
        Errors of its Q; None if unknown.
    stays_within
        Whether to refuse covariates outside these ranges by more than their margins.
    margins
        By stage, how far outside these ranges a covariate may lie by chance.
    """

    policy: DiscretePolicy
    ranges: RangesOfStage = everything
    extrapolates: bool = False
    q_error: QError | None = None
    stays_within: bool = False
    margins: Callable[[int], Margins] = no_margins

    def decide(self, observation: NamedObservation) -> Decision:
        """Take the possible action with the largest Q, less its margin for pessimism.

        Raises
        ------
        ArgumentError
            There is no such stage, or it is no observation.
        PolicyError
            The state is neither one row nor a mapping, or a covariate is missing, not finite, null or of an unknown
            category.
        OutOfRangeError
            A covariate lies far outside the logs, and extrapolation is not allowed.
        """
        if not isinstance(observation, NamedObservation):
            raise ArgumentError(f"observation is a {type(observation).__name__}; give NamedObservation(row, stage)")
        policy, row = self.policy, observation.row
        full, filled = completed(policy, row if isinstance(row, Mapping) else _only_row(row), observation.last)
        values = known_covariates(policy, full, "the state")
        return self.decide_known(values, observation.stage, {**observation.filled, **filled})

    def decide_known(
        self, values: Mapping[str, Any], stage: int, filled: Mapping[str, str] = MappingProxyType({})
    ) -> Decision:
        """Decide like `decide`, but faster, from values of all covariates in `looks_at`.

        Parameters
        ----------
        values
            Finite numbers, and text of known categories, by name.
        stage
            The stage to decide, from 1.
        filled
            As in `NamedObservation`.

        Raises
        ------
        ArgumentError
            There is no such stage.
        OutOfRangeError
            As for `decide`.
        """
        policy = self.policy
        valued = policy.valued(policy.looks_at.encode_known([values]), stage)
        possible = np.where(policy.is_possible[stage - 1], valued.scores[0], -np.inf)
        ranges = self.ranges(stage)
        by_range = {name: {name: value} for name, value in values.items()}
        if self.stays_within:
            refuse_outside(ranges, by_range, self.margins(stage))
        if not self.extrapolates:
            refuse_far(ranges, by_range)
        names = [str(name) for name in policy.actions]
        intervals, chance_best = self._certainty(valued, stage, names)
        return Decision(
            action=policy.actions[int(np.argmax(possible))],
            q_values=values_by_name(names, possible),
            reason=flat_reason(policy, values, stage, ranges or None, chance_best),
            warnings=(*beyond(ranges, by_range), *filled.values()),
            intervals=intervals,
            chance_best=chance_best,
            filled=tuple(filled),
        )

    def _certainty(
        self, valued: Valued, stage: int, names: list[str]
    ) -> tuple[dict[str, tuple[float, float]], dict[str, float]]:
        """Certainty of Q, by name; empty if unknown."""
        policy = self.policy
        if policy.margin is None or self.q_error is None:
            return {}, {}
        q, error = valued.q[0], valued.margins[0] / self.q_error.pessimism
        # Each action has coefficients of its own.
        of_stage = self.q_error.stages_from(stage, policy.horizon), self.q_error.lasting
        blocks, is_possible = np.arange(len(q)), policy.is_possible[stage - 1]
        return certainty(q, error[:, None], blocks, is_possible, *of_stage).by_name(names)


def flat_reason(
    policy: DiscretePolicy,
    row: Mapping[str, Any],
    stage: int,
    ranges: Ranges | None,
    chance_best: Mapping[str, float] | None = None,
) -> str:
    """Say why the best action of a policy of named actions is best.

    The reason names the covariate whose replacement reduces the action's lead most. Its replacement is the middle of
    its range in the log, its most frequent category, or, for 0 and 1, the other of the two.

    Parameters
    ----------
    policy
        A policy.
    row
        The covariates of one state: numbers, and text of known categories.
    stage
        The stage, from 1.
    ranges
        Range of each covariate in the log; None if no trajectory reached this stage.
    chance_best
        Probability that no action is better, by name; empty if unknown.
    """
    # A boolean may be replaced by a number.
    instead = {} if ranges is None else {name: _instead(ranges[name], row[name]) for name in policy.covariates}
    rows = [row, *({**row, name: value} for name, value in instead.items())]
    each = policy.valued(policy.looks_at.encode_known(rows), stage).scores
    q = np.where(policy.is_possible[stage - 1], each[0], -np.inf)
    best = int(np.argmax(q))
    names = [str(name) for name in policy.actions]
    start, other = lead(names, q, best, chance_best or {}), next_best(q, best)
    if not policy.covariates or ranges is None or other is None:
        return f"{start}."
    left, ahead = each[1:, best] - each[1:, other], q[best] - q[other]
    least = int(np.argmin(left))
    name = policy.covariates[least]
    if ahead - left[least] <= least_gap(q) or written_gap(left[least]) == written_gap(ahead):
        return f"{start}; no covariate favours it more than its usual value does."
    is_value, is_other = _written(row[name], 6), _written(instead[name], 3)
    would = f"worth {written_gap(abs(left[least]))} {'more' if left[least] >= 0 else 'less'} than {names[other]}"
    usual = "" if _is_switch(ranges[name], row[name]) else f" ({_usual(ranges[name])} in the logs)"
    return f"{start}; mainly because {name} is {is_value}: at {is_other}{usual}, it would be {would}."


def _instead(seen: Range, value: Any) -> float | str:
    """Replacement of a covariate: the other of 0 and 1; a whole number among whole numbers."""
    if _is_switch(seen, value):
        return 1.0 - float(value)
    middle = middle_of(seen)
    is_whole = not isinstance(seen, Mapping) and all(float(one).is_integer() for one in (*seen, value))
    return float(np.floor(middle)) if is_whole else middle


def _is_switch(seen: Range, value: Any) -> bool:
    return not isinstance(seen, Mapping) and tuple(seen) == (0.0, 1.0) and float(value) in (0.0, 1.0)


def _usual(seen: Range) -> str:
    return "most frequent" if isinstance(seen, Mapping) else "mid-range"


def _written(value: Any, num_digits: int) -> str:
    return value if isinstance(value, str) else f"{float(value):.{num_digits}g}"


STATE_FILES = (".json", ".csv")


def completed(
    policy: DiscretePolicy, state: Mapping[str, Any], last: Mapping[str, Any] | None = None
) -> tuple[Mapping[str, Any], dict[str, str]]:
    """Fill in missing covariates by the policy's rules, and say which; see `NamedObservation`."""
    return (state, {}) if policy.filling is None else policy.filling.of_state(state, policy.covariates, last)


def known_covariates(policy: DiscretePolicy, state: Mapping[str, Any], where: str) -> dict[str, float | str]:
    """Extract a policy's covariates from a state in memory, for `NamedDecider.decide_known`.

    Parameters
    ----------
    policy
        A policy of named actions.
    state
        Covariates by name, and possibly other items.
    where
        Source of the state, for messages.

    Raises
    ------
    PolicyError
        A covariate is missing, not finite, null or of an unknown category.
    """
    looks_at, texts = policy.looks_at, policy.categories
    if not all(name in state and looks_at.is_known(name, state[name]) for name in policy.covariates):
        # Values of other types are treated as if read from a file.
        row = _row(state, where)
        _check_row(row, policy, where)
        state = {name: row[name].iloc[0] for name in policy.covariates}
    return {name: (str if name in texts else float)(state[name]) for name in policy.covariates}


def checked_stage(stage: Any, latest: int, where: str, what: str = "the policy's horizon, ") -> int:
    """Convert a stage to a number.

    Raises
    ------
    PolicyError
        It is no whole number from 1 to `latest`, which is `what`.
    """
    if isinstance(stage, bool) or not (hasattr(stage, "__index__") and 1 <= int(stage) <= latest):
        raise PolicyError(f"{where}: stage is {stage!r:.40}; give a whole number from 1 to {what}{latest:,}")
    return int(stage)


def stage_of(state: Mapping[str, Any], where: str, covariates: Collection[str] = ()) -> Any:
    """The stage in a state; None if there is none.

    Raises
    ------
    PolicyError
        It is spelled otherwise and no covariate, so that stage 1 would be decided.
    """
    for name in state if "stage" not in state else ():
        if str(name).strip().lower() == "stage" and name not in covariates:
            raise PolicyError(f"{where}: it says {name!r}, which is not read; write it as 'stage', or leave it out")
    return state.get("stage")


def covariates_in_words(policy: DiscretePolicy) -> str:
    """The covariates of the policy, in words."""
    return ", ".join(policy.covariates) or "no covariates"


def _check_row(row: Frame, policy: DiscretePolicy, where: str) -> None:
    """Refuse a row that lacks a covariate of the policy."""
    missing = [name for name in policy.covariates if name not in row.columns]
    if missing:
        raise PolicyError(
            f"{where}: the policy looks at {covariates_in_words(policy)}, but {missing[0]!r} is missing (given: "
            f"{', '.join(map(str, row.columns)) or 'nothing'}); give all covariates of the policy"
        )
    null = next((name for name in policy.covariates if row[name].isna().to_numpy().any()), None)
    if null is not None:
        raise PolicyError(
            f"{where}: covariate {null!r} is null; fill it in, leave the state out, or learn the policy with "
            f"--missing {null}=median+flag, which fills in nulls"
        )
    try:
        policy.looks_at.encode(row)
    except LogError as error:
        raise PolicyError(f"{where}: {error}") from error


def _only_row(frame: Frame) -> dict[str, Any]:
    if not hasattr(frame, "columns") or len(frame) != 1:
        what = f"{len(frame)} rows" if hasattr(frame, "columns") else f"a {type(frame).__name__}"
        raise PolicyError(f"the state: {what}; give a frame of one row, or the values of the covariates by name")
    is_null = frame.iloc[0].isna()
    return {name: None if is_null[name] else frame[name].iloc[0] for name in frame.columns}


def _row(state: Mapping[str, Any], where: str) -> Frame:
    import pandas as pd

    try:
        return pd.DataFrame([dict(state)])
    except OverflowError as error:
        raise PolicyError(f"{where}: it holds a number that is too large for any covariate; check its unit") from error
