"""Marginal ratios: how much more often the policy comes to a state, instead of what the way to it weighs.

Products of ratios over stages carry the luck of all that went before. Where what comes next depends on the past through
S_t alone, only their mean given S_t matters, the ratio of how often policy and log are in a state [XieMaWang2019]_
[KallusUehara2020]_. With one stage's weight made of the one before,

    w_t = min(ρ̄_t(S_t) π(A_t | S_t) / b(A_t | S_t), √n),
    ρ̄_1 = 1,  ρ̄_{t+1}(s) = E[w_t δ_t / K̂_t | S_{t+1} = s],  K̂_t = Ĝ(U_t⁻) / Ĝ(U_{t−1}⁻),

no product is ever formed. The mean is that of `state_regression`, fitted without the trajectory's own fold. S_t is all
that the log tells of a stage, whether or not Q̂ looks at it: so weights may be right where Q̂ is not. In the doubly
robust value an error of ρ̄ is multiplied by one of Q̂; on products of ratios Q̂ may be what it likes, and a past that
S_t does not tell may matter. So where a log shows that it does (`history`), products are taken, and whole: Q̂ is wrong
there, too, and what is cut off would leave it uncorrected.

A weight beyond √n belongs to fewer than √n of n trajectories, and is cut off there [Ionides2008]_: what it takes away
is at most an error of Q̂ times the weight that is lost, which `Marginal.lost` tells.
"""

from typing import NamedTuple

import numpy as np

from halfseen.evaluation.ratios import StageWeights, uncut_before
from halfseen.evaluation.state_regression import mean_by_state
from halfseen.learning.rows import TrajectoryArrays
from halfseen.shapes import Bool, Float, Int


class Marginal(NamedTuple):
    """Weights by states."""

    by_fold: tuple[StageWeights, ...]
    """Fitted without each fold, and last to all trajectories."""
    lost: float
    """Stages of a trajectory, weighted as under the policy, that were cut off."""


def marginal_weights(
    single: Float[np.ndarray, "n T"],
    uncut: Float[np.ndarray, "B n T"],
    trajectories: TrajectoryArrays,
    beyond: Float[np.ndarray, "n T G"],
    fold: Int[np.ndarray, " n"],
    is_imputed: bool,
) -> Marginal:
    """Work out w_t of the stages of a log.

    Parameters
    ----------
    single
        π/b of each stage, not multiplied; what it holds for an unknown action does not count.
    uncut
        δ_t / Ĝ(U_t⁻), fitted without each fold, and last to all trajectories.
    trajectories
        The log.
    beyond
        Covariates of each stage that Q does not look at.
    fold
        Of each trajectory.
    is_imputed
        Whether begun stages have a target; else completed ones, which weigh w_t / K̂_t.
    """
    known = trajectories.is_begun & trajectories.has_action
    is_fitted = fold != np.arange(len(uncut))[:, None]
    last, is_finished = trajectories.is_begun.sum(axis=1) - 1, trajectories.clocks.is_finished
    passed = _passed(uncut)
    weight, standing = np.zeros_like(uncut), np.zeros_like(uncut)
    by_state, ended, lost = np.ones(uncut.shape[:2]), np.zeros(uncut.shape[:2]), 0.0
    for t in range(single.shape[1]):
        whole = np.where(known[:, t], by_state * single[:, t], 0.0)
        begun = np.minimum(whole, np.sqrt(len(single)))
        completed = begun * passed[..., t]
        lost += float((whole - begun)[-1].mean())
        weight[..., t] = begun if is_imputed else completed
        standing[..., t] = np.where(trajectories.is_begun[:, t], weight[..., t], ended)
        ended = np.where(is_finished & (last == t), completed, ended)
        by_state = _next_by_state(completed, t + 1, trajectories, beyond, is_fitted)
    return Marginal(tuple(StageWeights(*each) for each in zip(weight, standing, strict=True)), lost)


def _next_by_state(
    completed: Float[np.ndarray, "B n"],
    stage: int,
    trajectories: TrajectoryArrays,
    beyond: Float[np.ndarray, "n T G"],
    is_fitted: Bool[np.ndarray, "B n"],
) -> Float[np.ndarray, "B n"]:
    """ρ̄ of the states of a stage (from 0); 0 where it was not begun."""
    answer = np.zeros_like(completed)
    if stage < trajectories.action.shape[1] and trajectories.is_begun[:, stage].any():
        rows = np.flatnonzero(trajectories.is_begun[:, stage])
        looked_at, others = trajectories.features[rows, stage, 0], beyond[rows, stage]
        sets = [looked_at, np.column_stack([looked_at, others])] if others.shape[1] else [looked_at]
        answer[:, rows] = mean_by_state(completed[:, rows], sets, is_fitted[:, rows])
    return answer


def _passed(uncut: Float[np.ndarray, "B n T"]) -> Float[np.ndarray, "B n T"]:
    """δ_t / K̂_t, of the last factors."""
    before = uncut_before(uncut)
    return np.where(before > 0, uncut / np.where(before > 0, before, 1.0), 0.0)
