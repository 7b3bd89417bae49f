"""What a policy would have done in the states of a log."""

from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd

from halfseen.learning.rows import stage_places
from halfseen.learning.task import Task
from halfseen.logs import Logs
from halfseen.shapes import Bool


def action_shares(policy: Any, task: Task, parts: Iterable[Logs]) -> pd.DataFrame:
    """Count how often a policy takes each action in the states of each stage; on a table, each verb.

    Parameters
    ----------
    policy
        A policy.
    task
        The task of the policy.
    parts
        A log of this task, whole or in parts.

    Returns
    -------
    DataFrame
        One row per stage (the index): ``num_states``; ``as_logged``, the proportion of states with a known action in
        which the policy takes that action (NaN without such states); and ``shares``, the proportion of each action.
    """
    found: Any = pd.concat([_counted(policy, task, part) for part in parts]).groupby("stage").sum()
    names = list(task.block_names)
    taken = (found[names].to_numpy() / found[["num_states"]].to_numpy()).tolist()
    return pd.DataFrame(
        {
            "num_states": found["num_states"],
            # NaN, and no warning, if no action is known.
            "as_logged": found["num_as_logged"] / found["num_known"].where(found["num_known"] > 0),
            "shares": [dict(zip(names, row, strict=True)) for row in taken],
        }
    )


def _counted(policy: Any, task: Task, logs: Logs) -> pd.DataFrame:
    """Count, by stage of a part of a log, the states, known actions, agreements with the policy, and its actions."""
    at, horizon = stage_places(logs), horizon_of(policy)
    taken = task.target_probabilities(policy, logs, horizon)[at].argmax(axis=1)
    encoded = task.encode(logs, horizon)
    block = task.block_of_action(encoded.is_possible.shape[-1])[taken]
    is_known = logs.stages["action"].notna().to_numpy()
    rows: dict[str, Any] = {
        "stage": logs.stages["stage"].to_numpy(),
        "num_states": np.ones(len(block), dtype=int),
        "num_known": is_known.astype(int),
        "num_as_logged": (is_known & (taken == encoded.action[at])).astype(int),
    }
    rows |= {name: (block == k).astype(int) for k, name in enumerate(task.block_names)}
    each: Any = pd.DataFrame(rows)
    return each.groupby("stage", as_index=False).sum()


def horizon_of(policy: Any) -> int:
    """Horizon of a learned policy."""
    return int(getattr(policy, "horizon", None) or policy.coefficients.shape[-3])


def own_stages(policy: Any, rows: Any) -> Bool[np.ndarray, " m"]:
    """Rows of a log in which the policy would have taken the same action; none beyond its horizon."""
    is_own, stages = np.zeros(len(rows), dtype=bool), rows["stage"].to_numpy()
    for stage in np.unique(stages[stages <= policy.horizon]).tolist():
        at = np.flatnonzero(stages == stage)
        some = rows.iloc[at]
        is_own[at] = np.asarray(policy.decide(some, stage)) == some["action"].to_numpy()
    return is_own
