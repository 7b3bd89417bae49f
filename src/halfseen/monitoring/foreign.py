"""What a log holds that the policy in service does not know or did not do, in words.

Where a category stands that the log never showed, the policy steps back. No model says anything of such a state, so
that nothing is held against one there; how often it comes is watched as that of any other category.

In a log of the service, no other action has as large a probability as the policy's own, so what was done with more than
one half, and not by the rule in its place, is its own. A log of which most is not is another's.
"""

from typing import Any

import numpy as np

from halfseen.errors import closest
from halfseen.learning.covariates import Covariates
from halfseen.logs import Logs
from halfseen.logs.columns import STEPPED_BACK, shown
from halfseen.policies.shares import own_stages
from halfseen.shapes import Bool
from halfseen.wording import counted

HALF = 0.5
"""Probability beyond which an action was hardly drawn; and share of such actions beyond which a log is another's."""
ERRORS = 3.0
"""Standard errors of that share, at most, below which it is no chance."""


def has_known_states(looks_at: Covariates, logs: Logs) -> Bool[np.ndarray, " n"]:
    """Which trajectories show no category but those that are known."""
    strange: Any = logs.stages.loc[~looks_at.knows(logs.stages), "trajectory"]
    return ~np.isin(logs.trajectory_ids, strange.to_numpy())


def unknown_actions(policy: Any, logs: Logs) -> tuple[str, ...]:
    """Name each action that is none of the policy's, and how often it was taken."""
    counts: Any = logs.stages["action"].value_counts()
    others = {action: int(count) for action, count in counts.items() if count and action not in policy.actions}
    return tuple(_not_known(shown(action), count, int(counts.sum()), policy) for action, count in others.items())


def _not_known(action: str, count: int, num: int, policy: Any) -> str:
    meant = closest(action.strip("'"), policy.actions)
    remedy = "" if meant is None else f" Write {meant!r} if that is meant."
    known = ", ".join(map(str, policy.actions))
    are = "are" if count > 1 else "is"
    return f"{count:,} of {num:,} actions {are} {action}, which is none of the policy's ({known}).{remedy}"


def not_its_own(policy: Any, looks_at: Covariates, logs: Logs, is_of_policy: Bool[np.ndarray, " n"]) -> str:
    """Say that a log is of no service of the policy; "" where it may be.

    Parameters
    ----------
    policy
        A policy of named actions.
    looks_at
        Its covariates.
    logs
        The log.
    is_of_policy
        Which of its trajectories are said to be the policy's.
    """
    is_asked = np.isin(logs.stages["trajectory"], logs.trajectory_ids[is_of_policy])
    stages: Any = logs.stages[is_asked & logs.stages["action"].notna().to_numpy() & looks_at.knows(logs.stages)]
    if not len(stages):
        return ""
    is_own = own_stages(policy, stages)
    is_other = ~is_own & ~_is_explained(stages)
    if is_other.mean() <= HALF + ERRORS * 0.5 / np.sqrt(len(stages)):
        return ""
    return (
        f"Only {is_own.mean():.0%} of the actions are the policy's: this log is not of its service, and is not judged "
        "by its promise"
    )


def _is_explained(stages: Any) -> Bool[np.ndarray, " m"]:
    """Where the policy may have done something else: the rule decided in its place, or the action was drawn."""
    is_explained = np.zeros(len(stages), dtype=bool)
    if STEPPED_BACK in stages.columns:
        is_explained |= stages[STEPPED_BACK].notna().to_numpy()
    if "probability" in stages.columns:
        is_explained |= stages["probability"].to_numpy(dtype=float, na_value=1.0) <= HALF
    return is_explained


def unknown_categories(looks_at: Covariates, logs: Logs) -> tuple[str, ...]:
    """Name each category that the log never showed, and how often it is there."""
    found = []
    for name in looks_at.columns:
        if name not in looks_at.categories:
            continue
        values: Any = logs.stages[name].astype(object).map(str)
        counts = values[~values.isin(looks_at.categories[name])].value_counts()
        found += [
            f"Covariate {name} is {category!r} in {counted(int(count), 'stage')}, which the log that was learned from "
            "never showed: the policy steps back there, and such trajectories say nothing of what it earns."
            for category, count in counts.items()
        ]
    return tuple(found)
