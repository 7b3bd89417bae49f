"""Why a policy takes an action rather than the next best, in one sentence: what it is worth more, how sure, and why."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import isfinite
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float

from halfseen.learners.q_learning.flat_policy import FlatPolicy
from halfseen.policies.ranges import Range, Ranges, middle_of
from halfseen.tables.reasons import Grounds, table_grounds
from halfseen.world.action_space import ActionSpace

_SAME_VALUE = 1e-5
_LIKELIER = 0.05
"""By which another action must be likelier the best before the reason tells of it."""


def table_reason(grounds: Grounds, q: Float[np.ndarray, " A"], chance_best: Mapping[str, float] | None = None) -> str:
    """Say why the best action of one table is best.

    Parameters
    ----------
    grounds
        What there is to be said of the table.
    q
        Q of each action; −∞ where impossible.
    chance_best
        Probability that no action is better, by name; nothing where nobody knows it.

    Examples
    --------
    >>> from halfseen.tables.present import first_state
    >>> from halfseen.world import Scene
    >>> state = first_state(Scene(np.array([[0.0, 0.5], [0.0, 0.0]])), horizon=10, dirty_share=0.6).state
    >>> table_reason(Grounds.of(state, 0.6), np.array([0.0, 1.0, 0.5, 0.0, 1.8]))
    'LIFT 1: worth 0.80 more than WASH 0; it would lay bare 50% of object 0, of which nothing is known yet; as for \
WASH 0, it is half hidden (0.50), and nothing is known yet of whether it is dirty.'
    """
    names, best = ActionSpace(len(grounds.is_there)).names, int(np.argmax(q))
    own = table_grounds(grounds, best)
    told, other = [_lead(names, q, best, chance_best or {}), own], _next_best(q, best)
    # What a wrong WASH costs is told once.
    free = replace(grounds, worst_wash=None)
    rest = grounds if table_grounds(free, best) == own else free
    if other is not None and (against := table_grounds(rest, other)) != own:
        told.append(f"as for {names[other]}, {against}")
    return f"{'; '.join(told)}."


def flat_reason(
    policy: FlatPolicy,
    row: pd.DataFrame,
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
        Covariates, one row.
    stage
        The stage, from 1.
    ranges
        What the log showed of each covariate; None if no path came so far.
    chance_best
        Probability that no action is better, by name; nothing where nobody knows it.
    """
    is_possible = policy.is_possible[stage - 1]
    q = np.where(is_possible, policy.scores(row, stage)[0], -np.inf)
    best = int(np.argmax(q))
    names = [str(name) for name in policy.actions]
    lead, other = _lead(names, q, best, chance_best or {}), _next_best(q, best)
    if not policy.covariates or ranges is None or other is None:
        return f"{lead}."
    instead = {name: _instead(ranges[name], row[name].iloc[0]) for name in policy.covariates}
    # What is true or false may be changed to a number.
    numbers = row.astype({name: float for name in policy.covariates if name not in policy.categories})
    changed = pd.concat([numbers.assign(**{name: instead[name]}) for name in policy.covariates], ignore_index=True)
    each = policy.scores(changed, stage)
    left = each[:, best] - each[:, other]
    least = int(np.argmin(left))
    name = policy.covariates[least]
    if q[best] - q[other] - left[least] < _SAME_VALUE:
        return f"{lead}; none of what it looks at speaks for it more than what is usual in the logs does."
    is_value, is_other = _written(row[name].iloc[0], 6), _written(instead[name], 3)
    would = f"worth {abs(left[least]):.2f} {'more' if left[least] >= 0 else 'less'} than {names[other]}"
    usual = "" if _is_switch(ranges[name], row[name].iloc[0]) else f", {_usual(ranges[name])} in the logs"
    return f"{lead}; that {name} is {is_value} speaks for it most: were it {is_other}{usual}, it would be {would}."


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


def _next_best(q: Float[np.ndarray, " A"], best: int) -> int | None:
    others = np.where(np.arange(len(q)) == best, -np.inf, q)
    other = int(np.argmax(others))
    return other if np.isfinite(others[other]) else None


def _lead(names: Sequence[str], q: Float[np.ndarray, " A"], best: int, chance_best: Mapping[str, float]) -> str:
    other = _next_best(q, best)
    if other is None:
        return f"{names[best]}: nothing else is possible"
    gap = float(q[best] - q[other])
    is_same = gap < _SAME_VALUE * max(1.0, abs(float(q[best])))
    worth = f"worth as much as {names[other]}" if is_same else f"worth {gap:.2f} more than {names[other]}"
    return f"{names[best]}: {worth}{_how_sure(names[best], chance_best)}"


def _how_sure(best: str, chance_best: Mapping[str, float]) -> str:
    if not chance_best:
        return ""
    likeliest = max(chance_best, key=lambda name: chance_best[name])
    sure = f", and best with a chance of {chance_best[best]:.0%}"
    if chance_best[likeliest] < chance_best[best] + _LIKELIER:
        return sure
    return f"{sure}; {likeliest} is likelier best ({chance_best[likeliest]:.0%}), but the logs bear it out less"


def values_by_name(names: Sequence[str], q: Float[np.ndarray, " A"]) -> dict[str, float | None]:
    """Q of each action by name; None where it is not possible."""
    return {name: float(value) if isfinite(value) else None for name, value in zip(names, q, strict=True)}
