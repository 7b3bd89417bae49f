"""Whether what went before a stage foretells its outcome beyond what its state and action do.

Weights by states (`marginal`) stand on S_t carrying all that matters of the history. Residuals Y_t − Q̂_t of stages
from the second on, by a Q̂ that never saw the trajectory, and the history h_t = (A_{t−1}, φ(S_{t−1}), R_{t−1}) are both
freed from what φ(S_t) and A_t say linearly, and then should have nothing to do with each other: with U_i = Σ_t h̃_it
r̃_it,

    W = (Σ_i U_i)ᵀ (Σ_i U_i U_iᵀ)⁻¹ (Σ_i U_i)

is χ² with as many degrees of freedom as h has columns, whatever stages of one trajectory share [LiangZeger1986]_. It is
told as the normal deviate that is as rare [WilsonHilferty1931]_. A log is large enough for this long before it is for
the weights that the policy needs, for every stage counts alike.
"""

import numpy as np

from halfseen.learning.rows import TrajectoryArrays
from halfseen.shapes import Bool, Float

CLEARLY = 3.72
"""From this deviate on, which chance exceeds once in 10,000 logs, states are not believed to tell all."""

ROWS_PER_COLUMN = 5
"""Fewer stages than so many for each column, and φ(S_t) counts the same after every action."""


def history_deviate(
    residual: Float[np.ndarray, "n T"],
    has_target: Bool[np.ndarray, "n T"],
    trajectories: TrajectoryArrays,
    beyond: Float[np.ndarray, "n T G"],
) -> float:
    """W as a normal deviate; −∞ where no stage has one before it.

    Parameters
    ----------
    residual
        Y_t − Q̂_t, held out.
    has_target
        Stages that have one.
    trajectories
        The log.
    beyond
        Covariates of each stage that Q does not look at.
    """
    trajectory, before = np.nonzero(has_target[:, 1:])
    if not len(trajectory):
        return -np.inf
    now, taken = before + 1, np.eye(trajectories.is_possible.shape[-1])
    states = np.concatenate([trajectories.features[:, :, 0], beyond], axis=2)
    known = _known(states[trajectory, now], taken[trajectories.action[trajectory, now]])
    history = np.column_stack(
        [
            taken[trajectories.action[trajectory, before]][:, 1:],
            states[trajectory, before],
            trajectories.reward[trajectory, before],
        ]
    )
    freed = _freed(np.column_stack([history, residual[trajectory, now]]), known)
    history, left = _varied(freed[:, :-1], history), freed[:, -1]
    score = np.zeros((trajectories.num_trajectories, history.shape[1]))
    np.add.at(score, trajectory, history * left[:, None])
    return _deviate(*wald(score))


def wald(score: Float[np.ndarray, "n H"]) -> tuple[float, int]:
    """W, and its degrees of freedom: directions in which scores differ."""
    if not score.shape[1]:
        return 0.0, 0
    spread, directions = np.linalg.eigh(score.T @ score)
    kept = spread > 1e-8 * spread.max()
    along = directions[:, kept].T @ score.sum(axis=0)
    return float(np.sum(along**2 / spread[kept])), int(kept.sum())


def _deviate(squared: float, freedom: int) -> float:
    if freedom == 0:
        return -np.inf
    part = 2.0 / (9.0 * freedom)
    return float(((squared / freedom) ** (1.0 / 3.0) - (1.0 - part)) / np.sqrt(part))


def _known(features: Float[np.ndarray, "m F"], taken: Float[np.ndarray, "m A"]) -> Float[np.ndarray, "m C"]:
    """A constant and φ(S_t) for each action, or φ(S_t) for all of them where stages are few."""
    wide = np.column_stack([np.ones(len(features)), features])
    if taken.shape[1] * wide.shape[1] * ROWS_PER_COLUMN > len(features):
        return np.column_stack([taken, features])
    return (taken[:, :, None] * wide[:, None, :]).reshape(len(features), -1)


def _freed(columns: Float[np.ndarray, "m H"], known: Float[np.ndarray, "m C"]) -> Float[np.ndarray, "m H"]:
    """What a regression on `known` leaves of each column."""
    return columns - known @ np.linalg.lstsq(known, columns, rcond=1e-9)[0]


def _varied(freed: Float[np.ndarray, "m H"], whole: Float[np.ndarray, "m H"]) -> Float[np.ndarray, "m G"]:
    """Columns of which something is left, with standard deviation 1."""
    spread = freed.std(axis=0)
    kept = spread > 1e-3 * np.maximum(whole.std(axis=0), 1e-12)
    return freed[:, kept] / spread[kept]
