"""Categories and actions that the policy in service does not know, or did not choose, in words.

In a state with a category that is not in the training log, the policy steps back. No model covers such a state, so it
is not compared with one. The frequency of the category is monitored like that of any other.

In a log of the service, the policy's own action has the largest probability. So an action with a probability above one
half is the policy's own, unless the rule took it in the policy's place. A log in which most actions are not the
policy's own comes from elsewhere.
"""

from collections.abc import Collection
from typing import Any

import numpy as np
import pandas as pd

from halfseen.errors import LogError, NothingRecordedError, closest
from halfseen.learning.covariates import Covariates
from halfseen.logs import Logs
from halfseen.logs.columns import DECIDED_BY, STEPPED_BACK, shown
from halfseen.logs.recorded import STILL_RUNNING
from halfseen.policies.shares import own_stages
from halfseen.shapes import Bool
from halfseen.wording import counted

MANY = 0.1
"""Share of the decisions above which those of its rule are reported."""
HALF = 0.5
"""Probability above which an action is hardly exploration; and share of such actions that are not the policy's above
which the log is not the policy's."""
ERRORS = 3.0
"""Number of standard errors by which that share must exceed `HALF`."""


def decided_by(digest: str, logs: Logs) -> Logs:
    """The trajectories that a policy decided; all if the log does not say who decided.

    Parameters
    ----------
    digest
        Identifier of the policy.
    logs
        The log.

    Raises
    ------
    NothingRecordedError
        It decided none.
    """
    by = logs.trajectories.get(DECIDED_BY)
    if by is None or by.isna().all():
        return logs
    is_its = by.eq(digest).fillna(False).to_numpy(dtype=bool)
    if not is_its.any():
        whose = ", ".join(sorted(map(str, by.dropna().unique())))
        raise NothingRecordedError(
            f"none of its {counted(len(by), 'trajectory')} was decided by this policy ({digest}), but by {whose}; "
            "give the log of its service"
        )
    return logs if is_its.all() else logs.select(logs.trajectory_ids[is_its])


def that_ended(logs: Logs) -> Logs:
    """The trajectories that have ended; raises `NothingRecordedError` if none has."""
    has_ended = np.asarray(logs.trajectories["cause"] != STILL_RUNNING)
    if not has_ended.any():
        raise NothingRecordedError("no trajectory has ended so far; monitor again once one has")
    return logs if has_ended.all() else logs.select(logs.trajectory_ids[has_ended])


def decided_by_others(whole_log: Logs, logs: Logs) -> list[str]:
    """Say what a policy did not decide: trajectories outside `logs`, and stages there, if many, by its rule."""
    notes, stages = [], logs.stages
    if others := whole_log.num_trajectories - logs.num_trajectories:
        notes.append(f"not counted: {counted(others, 'trajectory')} that the log does not ascribe to this policy")
    causes: Any = stages[STEPPED_BACK].value_counts() if STEPPED_BACK in stages else pd.Series(dtype=int)
    if (num := int(causes.sum())) > MANY * len(stages):
        why = ", ".join(f"{cause} {count:,}" for cause, count in causes.items() if count)
        notes.append(f"{num:,} of {len(stages):,} decisions are the rule's, in the policy's place ({why})")
    return notes


def in_known_categories(looks_at: Covariates, logs: Logs) -> Logs:
    """The log with unknown categories replaced by the first known one, as the censoring model needs it."""
    if looks_at.knows(logs.stages).all():
        return logs
    columns: dict[str, Any] = {}
    for name, known in looks_at.categories.items():
        values = logs.stages[name].astype(object).map(str)
        columns[name] = values.where(values.isin(known), known[0])
    return Logs(logs.stages.assign(**columns), logs.trajectories, reward_unit=logs.reward_unit)


def unknown_actions(policy: Any, logs: Logs) -> tuple[str, ...]:
    """Describe each action that the policy does not have, and how often it was taken."""
    counts: Any = logs.stages["action"].value_counts()
    others = {action: int(count) for action, count in counts.items() if count and action not in policy.actions}
    return tuple(_not_known(shown(action), count, int(counts.sum()), policy) for action, count in others.items())


def not_watched(parts: Any, policy: Any, logs: Logs) -> list[str]:
    """Name the actions that are taken but were too rare in the training log for a model of what they bring."""
    rare = {str(action) for action in policy.actions} - {part["action"] for part in parts}
    counts: Any = logs.stages["action"].dropna().astype(str).value_counts()
    some = ", ".join(f"{action} ({counted(int(num), 'stage')})" for action, num in counts.items() if action in rare)
    return [f"not watched by itself, as the log it was learned from has too few: {some}"] if some else []


def refuse_unknown_alone(policy: Any, logs: Logs) -> None:
    """Refuse a log in which the policy knows none of the actions."""
    names = logs.stages["action"].dropna().unique()
    if len(names) and not set(names) & set(policy.actions):
        raise LogError(f"none of its actions is the policy's. {unknown_actions(policy, logs)[0]}")


def _not_known(action: str, count: int, num: int, policy: Any) -> str:
    known = ", ".join(map(str, policy.actions))
    are, meant = "are" if count > 1 else "is", _other_spelling(action.strip("'"), policy.actions)
    return f"{count:,} of {num:,} actions {are} {action}, which the policy does not know ({known}).{meant}"


def _other_spelling(name: str, known: Collection[Any]) -> str:
    close = closest(name, known)
    # A number may have come as text.
    return (
        "" if close is None else f" Write {shown(next(each for each in known if str(each) == close))} if that is meant."
    )


def own_actions(policy: Any, looks_at: Covariates, stages: Any) -> Bool[np.ndarray, " m"]:
    """Whether, in each stage with a known action, the policy would have done the same or stepped back."""
    is_own = np.zeros(len(stages), dtype=bool)
    if STEPPED_BACK in stages.columns:
        is_own |= stages[STEPPED_BACK].notna().to_numpy()
    is_asked = ~is_own & looks_at.knows(stages)
    is_own[is_asked] = own_stages(policy, stages[is_asked])
    return is_own


def not_its_own(policy: Any, looks_at: Covariates, logs: Logs, is_of_policy: Bool[np.ndarray, " n"]) -> str:
    """A sentence if a log does not come from the policy's service; "" if it may.

    Parameters
    ----------
    policy
        A policy of named actions.
    looks_at
        Its covariates.
    logs
        The log.
    is_of_policy
        Whether each of its trajectories is labelled as the policy's.
    """
    is_asked = np.isin(logs.stages["trajectory"], logs.trajectory_ids[is_of_policy])
    stages: Any = logs.stages[is_asked & logs.stages["action"].notna().to_numpy()]
    if not len(stages):
        return ""
    is_own = own_actions(policy, looks_at, stages)
    is_other = ~is_own
    if "probability" in stages.columns:
        is_other &= stages["probability"].to_numpy(dtype=float, na_value=1.0) > HALF
    if is_other.mean() <= HALF + ERRORS * 0.5 / np.sqrt(len(stages)):
        return ""
    return (
        f"Only {is_own.mean():.0%} of the actions are the policy's: this log is not from its service, and is not "
        "compared with its promise"
    )


def unknown_categories(looks_at: Covariates, logs: Logs) -> tuple[str, ...]:
    """Describe each category that is not in the training log, and how often it occurs."""
    found = []
    for name in looks_at.columns:
        if name not in looks_at.categories:
            continue
        values: Any = logs.stages[name].astype(object).map(str)
        counts = values[~values.isin(looks_at.categories[name])].value_counts()
        found += [
            f"Covariate {name} is {category!r} in {counted(int(count), 'stage')}, which never occurs in the training "
            f"log: there the rule decides.{_other_spelling(category, looks_at.categories[name])}"
            for category, count in counts.items()
        ]
    return tuple(found)
