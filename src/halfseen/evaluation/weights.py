"""How likely the logging policy was to take what it took: as logged, or estimated.

The estimate is a conditional logit of the logged actions (`learning.behaviour`). Each stage has its own, or
pooled stages share one.

What each trajectory stands for, stage by stage, under the policy that is evaluated and had nothing been cut.

With ρ_t = Π_{s≤t} π(A_s | S_s) / b(A_s | S_s), a stage that was completed weighs ρ_t δ_t / Ĝ(U_t⁻), and one that was
begun ρ_t / Ĝ(U_{t−1}⁻). A trajectory that has come to its own end stays in the sums with its last weight, for a cut
would not have changed what comes after: nothing. So the weights of every stage have mean 1, and dividing by their mean
takes out much of their noise (self-normalised, or weighted, importance sampling).

Marginal ratios: how much more often the policy comes to a state, instead of what the way to it weighs.

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

from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import numpy as np

from halfseen.errors import ArgumentError, LogError
from halfseen.evaluation.states import mean_by_state
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
            "so how likely its action was is not known; log it, or estimate it (--propensity estimated, in Python "
            "propensity='estimated')"
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


@dataclass(frozen=True)
class StageWeights:
    """Weights of the stages of a log.

    Parameters
    ----------
    weight
        Of each stage that counts, 0 elsewhere.
    standing
        The same, and of a trajectory that has ended, its last weight.
    """

    weight: Float[np.ndarray, "n T"]
    standing: Float[np.ndarray, "n T"]

    @property
    def normalised(self) -> Float[np.ndarray, "n T"]:
        """Weights by their mean over trajectories; 0 in a stage that no trajectory stands for."""
        mean = self.standing.mean(axis=0)
        return np.where(mean > 0, self.weight / np.where(mean > 0, mean, 1.0), 0.0)

    @property
    def effective_sample_size(self) -> float:
        """Effective sample size, in the stage where it is least [Kish1965]_."""
        squares = (self.standing**2).sum(axis=0)
        each = np.where(squares > 0, self.standing.sum(axis=0) ** 2 / np.where(squares > 0, squares, 1.0), 0.0)
        return float(each.min())

    def take(self, rows: Bool[np.ndarray, " n"]) -> "StageWeights":
        """Keep these trajectories."""
        return StageWeights(self.weight[rows], self.standing[rows])

    def influence(self, of_stage: Float[np.ndarray, "n T"]) -> Float[np.ndarray, " n"]:
        """What each trajectory adds to the sum over stages of the weighted means of `of_stage`; its mean is that sum.

        The noise of the weights' means is part of it, so that its standard deviation over √n is the standard error.
        """
        mean = self.standing.mean(axis=0)
        scale = np.where(mean > 0, mean, 1.0)
        average = (self.weight * of_stage).mean(axis=0) / scale
        centred = (self.weight * of_stage - self.standing * average) / scale
        return centred.sum(axis=1) + average.sum()


def likelihood_ratios(single: Float[np.ndarray, "n T"], trajectories: TrajectoryArrays) -> Float[np.ndarray, "n T"]:
    """ρ_t of each begun stage whose action is known, given the ratio of each stage; 0 elsewhere."""
    return np.where(trajectories.is_begun & trajectories.has_action, np.cumprod(single, axis=1), 0.0)


def mean_squared_ratio(single: Float[np.ndarray, "n T"], trajectories: TrajectoryArrays) -> float:
    """E[ρ²], by what is logged of each stage: so many uncut trajectories that were logged are worth one of the policy.

    Of ρ² itself a log knows little where few trajectories do as the policy would to their end. So it is put together
    from the stages, Π_t E[(π/b)²], as if they had nothing to do with one another, and averaged over the lengths of the
    trajectories.
    """
    known, finished = trajectories.is_begun & trajectories.has_action, trajectories.clocks.is_finished
    mean = np.where(known, single**2, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    whole = known[finished] if finished.any() else known
    return float(np.prod(np.where(whole, mean, 1.0), axis=1).mean())


def single_ratios(
    probabilities: Float[np.ndarray, "n T A"], propensity: Float[np.ndarray, "n T"], trajectories: TrajectoryArrays
) -> Float[np.ndarray, "n T"]:
    """π/b of each begun stage whose action is known; 1 elsewhere."""
    taken = np.take_along_axis(probabilities, trajectories.action[..., None], axis=2)[..., 0]
    return np.where(trajectories.is_begun & trajectories.has_action, taken / propensity, 1.0)


def completed_weights(
    ratio: Float[np.ndarray, "n T"], uncut: Float[np.ndarray, "n T"], trajectories: TrajectoryArrays
) -> StageWeights:
    """ρ_t δ_t / Ĝ(U_t⁻), given the last factors in `uncut`."""
    weight = np.where(trajectories.is_completed, ratio * uncut, 0.0)
    return StageWeights(weight, _stand_on(weight, trajectories))


def begun_weights(
    ratio: Float[np.ndarray, "n T"], uncut: Float[np.ndarray, "n T"], trajectories: TrajectoryArrays
) -> StageWeights:
    """ρ_t / Ĝ(U_{t−1}⁻) of begun stages; once a trajectory has ended, ρ_L / Ĝ(U_L⁻) stands for it."""
    weight = np.where(trajectories.is_begun, ratio * uncut_before(uncut), 0.0)
    ended = _stand_on(np.where(trajectories.is_completed, ratio * uncut, 0.0), trajectories)
    return StageWeights(weight, np.where(trajectories.is_begun, weight, ended))


def uncut_before(uncut: Float[np.ndarray, "*B n T"]) -> Float[np.ndarray, "*B n T"]:
    """δ_{t−1} / Ĝ(U_{t−1}⁻), which is 1 in the first stage."""
    return np.concatenate([np.ones_like(uncut[..., :1]), uncut[..., :-1]], axis=-1)


def _stand_on(weight: Float[np.ndarray, "n T"], trajectories: TrajectoryArrays) -> Float[np.ndarray, "n T"]:
    last = trajectories.is_begun.sum(axis=1) - 1
    has_ended = trajectories.clocks.is_finished[:, None] & (np.arange(weight.shape[1]) > last[:, None])
    return np.where(has_ended, weight[np.arange(len(weight)), last][:, None], weight)


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
