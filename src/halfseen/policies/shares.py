"""What a policy would have done in the states of a log."""

from typing import Any

import numpy as np
import pandas as pd

from halfseen.learners.q_learning.path_arrays import stage_places
from halfseen.learners.q_learning.task import Task
from halfseen.logs import Logs


def action_shares(policy: Any, task: Task, logs: Logs) -> pd.DataFrame:
    """Count how often a policy takes each action in the states of each stage; on a table, each verb.

    Parameters
    ----------
    policy
        A policy.
    task
        What it decides.
    logs
        A log that fits it.

    Returns
    -------
    DataFrame
        One row a stage (the index): ``num_states``; ``as_logged``, the proportion of the states with a known action in
        which the policy takes that one (NaN without such states); and ``shares``, for each action its proportion.
    """
    at, horizon = stage_places(logs), horizon_of(policy)
    taken = task.target_probabilities(policy, logs, horizon)[at].argmax(axis=1)
    encoded = task.encode(logs, horizon)
    block = task.block_of_action(encoded.is_possible.shape[-1])[taken]
    is_as_logged = (taken == encoded.action[at]).astype(float)
    rows = pd.DataFrame({"stage": logs.stages["stage"].to_numpy(), "block": block, "as_logged": is_as_logged})
    rows.loc[logs.stages["action"].isna().to_numpy(), "as_logged"] = np.nan
    stages: Any = rows.groupby("stage")
    names = task.block_names
    return pd.DataFrame(
        {
            "num_states": stages.size(),
            "as_logged": stages["as_logged"].mean(),
            "shares": stages["block"].agg(lambda codes: {n: float(np.mean(codes == k)) for k, n in enumerate(names)}),
        }
    )


def horizon_of(policy: Any) -> int:
    """Stages that a learned policy is for."""
    return int(getattr(policy, "horizon", None) or policy.coefficients.shape[-3])
