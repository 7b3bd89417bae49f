"""Why a policy takes an action, in one sentence: what it is worth more than the next, and what it looked at."""

from collections.abc import Sequence
from math import isfinite
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float

from halfseen.learners.q_learning.flat_policy import FlatPolicy
from halfseen.policies.ranges import Ranges, middle_of
from halfseen.tables.reasons import table_grounds
from halfseen.world.action_space import ActionSpace
from halfseen.world.state import TableState

_SAME_VALUE = 1e-5


def table_reason(state: TableState, q: Float[np.ndarray, " A"]) -> str:
    """Say why the best action of one table is best.

    Parameters
    ----------
    state
        One table with an object on it.
    q
        Q of each action; −∞ where impossible.

    Examples
    --------
    >>> from halfseen.tables.present import first_state
    >>> from halfseen.world import Scene
    >>> state = first_state(Scene(np.array([[0.0, 0.5], [0.0, 0.0]])), horizon=10, dirty_share=0.6).state
    >>> table_reason(state, np.array([0.0, 1.0, 0.5, 0.0, 1.8]))
    'LIFT 1: worth 0.80 more than WASH 0; it is in plain sight (0.00) and rather dirty than clean (0.60), and it \
hides 0.'
    """
    best = int(np.argmax(q))
    return f"{_lead(ActionSpace(state.num_objects).names, q, best)}; {table_grounds(state, best)}."


def flat_reason(policy: FlatPolicy, row: pd.DataFrame, stage: int, ranges: Ranges | None) -> str:
    """Say why the best action of a policy of named actions is best.

    The covariate that is told of is the one without which the action would lead by least: were it in the middle of
    what the log showed, or the category that it showed most often.

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
    """
    is_possible = policy.is_possible[stage - 1]
    q = np.where(is_possible, policy.scores(row, stage)[0], -np.inf)
    best = int(np.argmax(q))
    names = [str(name) for name in policy.actions]
    lead = _lead(names, q, best)
    if not policy.covariates or ranges is None or is_possible.sum() < 2:
        return f"{lead}."
    other = int(np.argmax(np.where(np.arange(len(q)) == best, -np.inf, q)))
    middle = {name: middle_of(ranges[name]) for name in policy.covariates}
    # What is true or false lies in its middle at one half.
    numbers = row.astype({name: float for name in policy.covariates if name not in policy.categories})
    changed = pd.concat([numbers.assign(**{name: middle[name]}) for name in policy.covariates], ignore_index=True)
    each = policy.scores(changed, stage)
    left = each[:, best] - each[:, other]
    least = int(np.argmin(left))
    name = policy.covariates[least]
    if q[best] - q[other] - left[least] < _SAME_VALUE:
        return f"{lead}; none of what it looks at speaks for it more than the middle of the logs does."
    is_value, is_middle = (_written(one) for one in (row[name].iloc[0], middle[name]))
    would = f"worth {abs(left[least]):.2f} {'more' if left[least] >= 0 else 'less'} than {names[other]}"
    return f"{lead}; {name} = {is_value} speaks for it most: at {is_middle}, it would be {would}."


def _written(value: Any) -> str:
    return value if isinstance(value, str) else f"{float(value):g}"


def _lead(names: Sequence[str], q: Float[np.ndarray, " A"], best: int) -> str:
    others = np.where(np.arange(len(q)) == best, -np.inf, q)
    other = int(np.argmax(others))
    if not np.isfinite(others[other]):
        return f"{names[best]}: nothing else is possible"
    gap = float(q[best] - others[other])
    if gap < _SAME_VALUE * max(1.0, abs(float(q[best]))):
        return f"{names[best]}: worth as much as {names[other]}"
    return f"{names[best]}: worth {gap:.2f} more than {names[other]}"


def values_by_name(names: Sequence[str], q: Float[np.ndarray, " A"]) -> dict[str, float | None]:
    """Q of each action by name; None where it is not possible."""
    return {name: float(value) if isfinite(value) else None for name, value in zip(names, q, strict=True)}
