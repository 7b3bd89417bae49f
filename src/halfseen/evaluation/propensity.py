"""How likely the logging policy was to take what it took: as logged, or estimated.

The estimate is a conditional logit of the logged actions (`learning.behaviour`). Each stage has its own, or
pooled stages share one.
"""

from typing import Literal, get_args

import numpy as np

from halfseen.errors import ArgumentError, LogError
from halfseen.learning.behaviour import conditional_logit
from halfseen.learning.rows import TrajectoryArrays
from halfseen.shapes import Bool, Float, Int

Propensity = Literal["logged", "estimated"]


def check_propensity(propensity: str) -> None:
    """Refuse what is neither ``"logged"`` nor ``"estimated"``."""
    if propensity not in get_args(Propensity):
        raise ArgumentError(f"propensity is {propensity!r}; it is 'logged' or 'estimated'")


def logged_propensity(trajectories: TrajectoryArrays, is_needed: Bool[np.ndarray, "n T"]) -> Float[np.ndarray, "n T"]:
    """Take the column ``probability``; 1 where it is not needed.

    Raises
    ------
    LogError
        It is null where it is needed; trajectory and stage are named.
    """
    missing = is_needed & np.isnan(trajectories.probability)
    if missing.any():
        trajectory, stage = np.argwhere(missing)[0]
        raise LogError(
            f"trajectory {trajectories.trajectory_ids[trajectory]}, stage {stage + 1}: its probability was not logged, "
            "so how likely its action was is not known; log it, or estimate it with propensity 'estimated'"
        )
    return np.where(is_needed, trajectories.probability, 1.0)


def estimated_propensity(
    trajectories: TrajectoryArrays, is_needed: Bool[np.ndarray, "n T"], blocks: Int[np.ndarray, " A"], is_pooled: bool
) -> Float[np.ndarray, "n T"]:
    """Estimate b(A_t | S_t) from the actions of all stages that are known; 1 where it is not needed.

    Parameters
    ----------
    trajectories
        The log.
    is_needed
        Stages that are asked about.
    blocks
        Block of coefficients of each action.
    is_pooled
        One model for all stages, instead of one for each.
    """
    known = trajectories.is_begun & trajectories.has_action
    likely = np.ones(known.shape)
    num_stages = known.shape[1]
    for stages in [slice(None)] if is_pooled else [slice(t, t + 1) for t in range(num_stages)]:
        rows = np.zeros_like(known)
        rows[:, stages] = known[:, stages]
        if rows.any():
            taken = trajectories.action[rows]
            each = conditional_logit(trajectories.features[rows], trajectories.is_possible[rows], taken, blocks)
            likely[rows] = each[np.arange(len(taken)), taken]
    return np.where(is_needed, likely, 1.0)
