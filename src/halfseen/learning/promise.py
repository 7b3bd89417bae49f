"""A Q that promises more than the log makes likely is not believed.

Errors of Q add up backwards: the largest of several Qs is the likelier one that errs upwards, and is the target of the
stage before. Over many stages a smooth Q may rise beyond all that was seen, and its policy then waits for what never
comes. What V̂ promises is a mean. Where there are many stages, and it is more than nineteen in twenty of the
trajectories that finished have brought, it is not believed, and Q is linear, unless that promises as much. Of few
stages it may be right: what the log does may be far from the best.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from halfseen.learning.discrete_policy import DiscretePolicy
from halfseen.learning.q_model import QModel
from halfseen.learning.q_space import KernelQ, LinearQ
from halfseen.learning.streaming import Learned, sample_of
from halfseen.logs import Logs, LogStream

MANY_STAGES = 10
RARE = 0.95
"""Quantile of what finished trajectories brought."""
FEWEST_FINISHED = 20
"""Trajectories below which nothing is said."""


def believable(learn: Callable[[QModel], Learned], model: QModel, logs: Logs | LogStream) -> Learned:
    """Learn; of many stages with a linear Q where nobody asked for the smooth one, and it promises too much.

    Parameters
    ----------
    learn
        Learns from the log as a model says.
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
    linear = learn(replace(model, space=LinearQ(), space_chosen=(f"Q is linear: a smooth one promises {hope}",)))
    return smooth if too_hopeful(linear.model.policy(linear.q_functions), some) else linear


def too_hopeful(policy: object, logs: Logs) -> str:
    """Say what V̂ of the first stage promises, where that is more than the log makes likely; nothing where it is not."""
    finished = logs.trajectory_ids[logs.is_finished]
    if not isinstance(policy, DiscretePolicy) or len(finished) < FEWEST_FINISHED:
        return ""
    first: Any = logs.stages[logs.stages["stage"] == 1]
    promised = float(np.where(policy.is_possible[0], policy.q_values(first, 1), -np.inf).max(axis=1).mean())
    brought = logs.stages.groupby("trajectory", sort=False)["reward"].sum().loc[finished]
    rare = float(np.quantile(brought, RARE))
    return "" if promised <= rare else f"{promised:.3g} a trajectory, and one in twenty brought more than {rare:.3g}"
