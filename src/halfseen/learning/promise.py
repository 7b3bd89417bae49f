"""A Q that promises more than the log makes plausible is rejected.

Errors of Q accumulate backwards: the maximum over several Qs favours those that err upwards, and it is the target of
the stage before. Over many stages a smooth Q may exceed everything that was observed, and its policy then waits for
rewards that never come. V̂ of the first stage is a mean. If there are many stages and V̂ exceeds the returns of 95 % of
the finished trajectories, it is rejected and Q is linear, unless a linear Q promises as much. With few stages a large
V̂ may be right: the behaviour policy may be far from optimal.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from halfseen.learning.discrete_policy import DiscretePolicy
from halfseen.learning.q_model import QModel
from halfseen.learning.q_space import KernelQ, LinearQ
from halfseen.learning.streaming import Fit, sample_of
from halfseen.logs import Logs, LogStream

MANY_STAGES = 10
RARE = 0.95
"""Quantile of the returns of finished trajectories."""
FEWEST_FINISHED = 20
"""Fewest finished trajectories for this check."""


def believable(learn: Callable[[QModel], Fit], model: QModel, logs: Logs | LogStream) -> Fit:
    """Learn; with many stages, learn again with a linear Q if a default smooth one promises too much.

    Parameters
    ----------
    learn
        Function that learns from the log with a given model.
    model
        The model.
    logs
        The log.
    """
    smooth = learn(model)
    is_doubted = smooth.model.is_space_free and isinstance(smooth.model.space, KernelQ)
    if not is_doubted or model.horizon < MANY_STAGES:
        return smooth
    some = logs if isinstance(logs, Logs) else sample_of(logs, model.random_state)
    hope = too_hopeful(smooth.model.policy(smooth.q_functions), some)
    if not hope:
        return smooth
    linear = learn(replace(model, space=LinearQ(), space_chosen=(f"Q is linear: a smooth Q promises {hope}",)))
    return smooth if too_hopeful(linear.model.policy(linear.q_functions), some) else linear


def too_hopeful(policy: object, logs: Logs) -> str:
    """Describe V̂ of the first stage if it exceeds what the log makes plausible; empty if it does not."""
    finished = logs.trajectory_ids[logs.is_finished]
    if not isinstance(policy, DiscretePolicy) or len(finished) < FEWEST_FINISHED:
        return ""
    first: Any = logs.stages[logs.stages["stage"] == 1]
    promised = float(np.where(policy.is_possible[0], policy.q_values(first, 1), -np.inf).max(axis=1).mean())
    brought = logs.stages.groupby("trajectory", sort=False)["reward"].sum().loc[finished]
    rare = float(np.quantile(brought, RARE))
    return (
        ""
        if promised <= rare
        else f"{promised:.3g} a trajectory, but only one trajectory in twenty earned more than {rare:.3g}"
    )
