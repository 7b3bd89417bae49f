"""Why a policy takes one named action rather than the next best, in one sentence."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from halfseen.learning.flat_policy import FlatPolicy
from halfseen.policies.ranges import Range, Ranges, middle_of
from halfseen.policies.reasons import SAME_VALUE, lead, next_best


def flat_reason(
    policy: FlatPolicy,
    row: Mapping[str, Any],
    stage: int,
    ranges: Ranges | None,
    chance_best: Mapping[str, float] | None = None,
) -> str:
    """Say why the best action of a policy of named actions is best.

    The covariate that is told of is the one without which the action would lead by least: were it in the middle of
    what the log showed, the category that it showed most often, or, of what is 0 or 1, the other of the two.

    Parameters
    ----------
    policy
        A policy.
    row
        The covariates of one state: numbers, and text of categories that the policy knows.
    stage
        The stage, from 1.
    ranges
        What the log showed of each covariate; None if no trajectory came so far.
    chance_best
        Probability that no action is better, by name; nothing where nobody knows it.
    """
    # What is true or false may be changed to a number.
    instead = {} if ranges is None else {name: _instead(ranges[name], row[name]) for name in policy.covariates}
    rows = [row, *({**row, name: value} for name, value in instead.items())]
    each = policy.valued(policy.looks_at.encode_known(rows), stage).scores
    q = np.where(policy.is_possible[stage - 1], each[0], -np.inf)
    best = int(np.argmax(q))
    names = [str(name) for name in policy.actions]
    start, other = lead(names, q, best, chance_best or {}), next_best(q, best)
    if not policy.covariates or ranges is None or other is None:
        return f"{start}."
    left = each[1:, best] - each[1:, other]
    least = int(np.argmin(left))
    name = policy.covariates[least]
    if q[best] - q[other] - left[least] < SAME_VALUE:
        return f"{start}; none of what it looks at speaks for it more than what is usual in the logs does."
    is_value, is_other = _written(row[name], 6), _written(instead[name], 3)
    would = f"worth {abs(left[least]):.2f} {'more' if left[least] >= 0 else 'less'} than {names[other]}"
    usual = "" if _is_switch(ranges[name], row[name]) else f", {_usual(ranges[name])} in the logs"
    return f"{start}; that {name} is {is_value} speaks for it most: were it {is_other}{usual}, it would be {would}."


def _instead(seen: Range, value: Any) -> float | str:
    """What a covariate might have been: of 0 and 1 the other; among whole numbers a whole number."""
    if _is_switch(seen, value):
        return 1.0 - float(value)
    middle = middle_of(seen)
    is_whole = not isinstance(seen, Mapping) and all(float(one).is_integer() for one in (*seen, value))
    return float(np.floor(middle)) if is_whole else middle


def _is_switch(seen: Range, value: Any) -> bool:
    return not isinstance(seen, Mapping) and tuple(seen) == (0.0, 1.0) and float(value) in (0.0, 1.0)


def _usual(seen: Range) -> str:
    return "most often" if isinstance(seen, Mapping) else "the middle"


def _written(value: Any, num_digits: int) -> str:
    return value if isinstance(value, str) else f"{float(value):.{num_digits}g}"
