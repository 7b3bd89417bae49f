"""Importance weights of trajectories for the policy to evaluate, and the doubly robust value.

*Propensities* of the logged actions under the logging policy are logged, or estimated by a conditional logit
(`learning.behaviour`), one per stage or one for all pooled stages.

*Weights* correct for the policy and for cuts. With ρ_t = Π_{s≤t} π(A_s | S_s) / b(A_s | S_s), a completed stage has
weight ρ_t δ_t / Ĝ(U_t⁻), and a stage that began has ρ_t / Ĝ(U_{t−1}⁻). A trajectory that has finished stays in the sums
with its last weight, because a cut could not change its future, which is empty. So the weights of every stage have
mean 1, and dividing by their sample mean removes much of their noise (self-normalised, or weighted, importance
sampling).

*The doubly robust value* of a policy under censoring has the contributions

    φ_i = V̂_1(S_i1) + Σ_t w_it (Y_it − Q̂_t(S_it, A_it))

of trajectories. In the version that is doubly robust towards cuts (AIPCW), Y is the pseudo-outcome of
`learning.imputation`, defined for every stage that began, and w_it = ρ_it / Ĝ(U_{i,t−1}⁻). Given that a stage began,
E[Y | S_t, A_t] = E[X | S_t, A_t] if Ĝ is right or if the regressions m of X and of the duration are. So

* if ρ and Ĝ are right, E[V̂_1] + Σ_t E[ρ_t (R_t + V̂_{t+1}(S_{t+1}) − Q̂_t(S_t, A_t))] telescopes to the value,
  whatever Q̂ is, because E[ρ_{t+1} Q̂_{t+1}(S_{t+1}, A_{t+1})] = E[ρ_t V̂_{t+1}(S_{t+1})];
* if Q̂ and m are right, each term has mean 0 given (S_t, A_t), whatever ρ and Ĝ are, as long as the cut of a stage
  depends only on the trajectory until then.

In the simple version, w_it = ρ_it δ_it / Ĝ(U_it⁻) and Y is X = R_t + V̂_{t+1}(S_{t+1}), of completed stages alone. The
first statement holds; the second only if durations carry no information on X beyond (S_t, A_t), because slow stages are
cut more often. Without cuts this is the estimator of [JiangLi2016]_ and [ThomasBrunskill2016]_; the pseudo-outcomes are
those of [Robins1992]_. *Fitted Q evaluation* under censoring [Le2019]_ is eq. 3 with the policy's action instead of the
maximum.

*Cross-fitting*: Ĝ, Q̂ and m are fitted without the trajectory's own fold [Chernozhukov2018]_. *Delete-a-group
jackknife* [Kott2001]_: everything is fitted without each fold, and the value computed on the other trajectories. The
scatter of these values gives the standard error of the whole procedure. That of the influence values, which treats Ĝ, m
and Q as known, is too small where the result depends on them: stages that are rarely observed to end are imputed, and
the error of that regression is common to all trajectories.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from halfseen.censoring import CensoringSpec
from halfseen.errors import HalfseenError, LogError
from halfseen.evaluation.estimate import jackknife_error
from halfseen.learning.behaviour import conditional_logit
from halfseen.learning.judging import FittedValues, judged
from halfseen.learning.q_model import QModel
from halfseen.learning.recursion import fit_q
from halfseen.learning.rows import Imputation, TrajectoryArrays, Transitions
from halfseen.shapes import Bool, Float, Int
from halfseen.workers.threads import one_thread

Propensity = Literal["logged", "estimated"]


def logged_propensity(trajectories: TrajectoryArrays, is_needed: Bool[np.ndarray, "n T"]) -> Float[np.ndarray, "n T"]:
    """Return the column ``probability``; 1 where it is not needed."""
    missing = is_needed & np.isnan(trajectories.probability)
    if missing.any():
        trajectory, stage = np.argwhere(missing)[0]
        raise LogError(
            f"trajectory {trajectories.trajectory_ids[trajectory]}, stage {stage + 1}: the probability of its action "
            "was not logged; log it, or estimate it (--propensity estimated, in Python propensity='estimated')"
        )
    return np.where(is_needed, trajectories.probability, 1.0)


def estimated_chances(
    trajectories: TrajectoryArrays,
    blocks: Int[np.ndarray, " A"],
    is_pooled: bool,
    is_fitted: Bool[np.ndarray, " n"] | None = None,
) -> Float[np.ndarray, "n T A"]:
    """Estimate b(a | S_t) of all known stages, by one model or one per stage; 0 elsewhere.

    `is_fitted` are the trajectories whose actions are used; None for all.
    """
    known = trajectories.is_begun & trajectories.has_action
    chances = np.zeros(trajectories.is_possible.shape)
    used = np.ones(len(known)) if is_fitted is None else is_fitted.astype(float)
    weight = np.broadcast_to(used[:, None], known.shape)
    num_stages = known.shape[1]
    for stages in [slice(None)] if is_pooled else [slice(t, t + 1) for t in range(num_stages)]:
        rows = np.zeros_like(known)
        rows[:, stages] = known[:, stages]
        if weight[rows].any():
            chances[rows] = conditional_logit(
                trajectories.features[rows],
                trajectories.is_possible[rows],
                trajectories.action[rows],
                blocks,
                weight[rows],
            )
    return chances


def held_out_chances(
    trajectories: TrajectoryArrays,
    blocks: Int[np.ndarray, " A"],
    is_pooled: bool,
    fold: Int[np.ndarray, " n"],
    num_folds: int,
) -> Float[np.ndarray, "n T A"]:
    """Estimate b(a | S_t) of all known stages without the actions of the trajectory's own fold."""
    chances, fold = np.zeros(trajectories.is_possible.shape), fold % num_folds
    for k in range(num_folds):
        chances[fold == k] = estimated_chances(trajectories, blocks, is_pooled, fold != k)[fold == k]
    return chances


def of_taken(values: Float[np.ndarray, "n T A"], trajectories: TrajectoryArrays) -> Float[np.ndarray, "n T"]:
    """Values of the logged actions."""
    return np.take_along_axis(values, trajectories.action[..., None], axis=2)[..., 0]


@dataclass(frozen=True)
class StageWeights:
    """Weights of the stages of a log."""

    weight: Float[np.ndarray, "n T"]
    """Of each weighted stage, 0 elsewhere."""
    standing: Float[np.ndarray, "n T"]
    """The same, with the last weight of each trajectory that has finished."""

    @property
    def normalised(self) -> Float[np.ndarray, "n T"]:
        """Weights divided by their mean over trajectories; 0 in a stage without weight."""
        mean = self.standing.mean(axis=0)
        return np.where(mean > 0, self.weight / np.where(mean > 0, mean, 1.0), 0.0)

    @property
    def effective_sample_size(self) -> float:
        """Effective sample size, in the stage with the smallest [Kish1965]_."""
        squares = (self.standing**2).sum(axis=0)
        each = np.where(squares > 0, self.standing.sum(axis=0) ** 2 / np.where(squares > 0, squares, 1.0), 0.0)
        return float(each.min())

    def take(self, rows: Bool[np.ndarray, " n"]) -> "StageWeights":
        """Select trajectories."""
        return StageWeights(self.weight[rows], self.standing[rows])

    def influence(self, of_stage: Float[np.ndarray, "n T"]) -> Float[np.ndarray, " n"]:
        """Contribution of each trajectory to the sum of the stages' weighted means of `of_stage`; its mean is the sum.

        It includes the noise of the weights' means, so its standard deviation over √n is the standard error.
        """
        mean = self.standing.mean(axis=0)
        scale = np.where(mean > 0, mean, 1.0)
        average = (self.weight * of_stage).mean(axis=0) / scale
        centred = (self.weight * of_stage - self.standing * average) / scale
        return centred.sum(axis=1) + average.sum()


def likelihood_ratios(single: Float[np.ndarray, "n T"], trajectories: TrajectoryArrays) -> Float[np.ndarray, "n T"]:
    """ρ_t of each stage that began and whose action is known, given the ratio of each stage; 0 elsewhere."""
    return np.where(trajectories.is_begun & trajectories.has_action, np.cumprod(single, axis=1), 0.0)


def mean_squared_ratio(single: Float[np.ndarray, "n T"], trajectories: TrajectoryArrays) -> float:
    """E[ρ²], from the ratios of single stages: the number of uncut logged trajectories worth one of the policy.

    A log has little information on ρ² itself if few trajectories follow the policy to their end. So it is computed as
    Π_t E[(π/b)²], as if stages were independent, and averaged over the lengths of the trajectories.
    """
    known, finished = trajectories.is_begun & trajectories.has_action, trajectories.clocks.is_finished
    mean = np.where(known, single**2, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    whole = known[finished] if finished.any() else known
    return float(np.prod(np.where(whole, mean, 1.0), axis=1).mean())


def single_ratios(
    probabilities: Float[np.ndarray, "n T A"], propensity: Float[np.ndarray, "n T"], trajectories: TrajectoryArrays
) -> Float[np.ndarray, "n T"]:
    """π/b of each stage that began and whose action is known; 1 elsewhere."""
    taken = of_taken(probabilities, trajectories)
    return np.where(trajectories.is_begun & trajectories.has_action, taken / propensity, 1.0)


def completed_weights(
    ratio: Float[np.ndarray, "n T"], uncut: Float[np.ndarray, "n T"], trajectories: TrajectoryArrays
) -> StageWeights:
    """ρ_t δ_t / Ĝ(U_t⁻), given the cumulative factors in `uncut`."""
    weight = np.where(trajectories.is_completed, ratio * uncut, 0.0)
    return StageWeights(weight, _stand_on(weight, trajectories))


def begun_weights(
    ratio: Float[np.ndarray, "n T"], uncut: Float[np.ndarray, "n T"], trajectories: TrajectoryArrays
) -> StageWeights:
    """ρ_t / Ĝ(U_{t−1}⁻) of stages that began; after a trajectory finished, ρ_L / Ĝ(U_L⁻)."""
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


class Nuisances(NamedTuple):
    """Nuisance models of the cuts, fitted to some of the trajectories and evaluated for all of them."""

    uncut: Float[np.ndarray, "n T"]
    """δ_t / Ĝ(U_t⁻)."""
    weight: Float[np.ndarray, "n T"]
    """Of each stage in eq. 3."""
    imputation: Imputation | None


def nuisances_of(
    model: QModel, trajectories: TrajectoryArrays, is_fitted: Bool[np.ndarray, " n"] | None = None
) -> Nuisances:
    """Evaluate a fitted model of the cuts; durations are fitted to some trajectories, or to all."""
    cuts = model.cut_model
    uncut = trajectories.is_completed.astype(float) if cuts is None else cuts.weights(trajectories.clocks)
    return Nuisances(uncut, *model.weights_and_imputation(trajectories, is_fitted))


def nuisances_by_folds(
    model: QModel, trajectories: TrajectoryArrays, whole: Nuisances, fold: Int[np.ndarray, " n"]
) -> Iterator[Nuisances]:
    """Fit the nuisance models of the cuts without each fold in turn.

    Weights are bounded by the largest of the whole log, because without a fold that holds the last trajectory at risk Ĝ
    may end early. If the remaining trajectories are too few for a fit, that of the whole log is used.
    """
    targets, clocks = model.targets, trajectories.clocks
    if not isinstance(targets, CensoringSpec) or clocks.is_finished.all():
        yield from [whole] * (int(fold.max()) + 1)
        return
    largest = max(float(whole.uncut.max()), 1.0)
    for k in range(int(fold.max()) + 1):
        try:
            cuts = targets.fit_cuts(clocks.take(np.flatnonzero(fold != k)))
            bounded = replace(cuts, truncate_at=cuts.truncate_at or largest)
            yield nuisances_of(replace(model, cut_model=bounded), trajectories, fold != k)
        except HalfseenError:
            yield whole


def of_own_fold(judged: FittedValues, fold: Int[np.ndarray, " n"]) -> FittedValues:
    """Fitted values of each trajectory's stages by the Q that was fitted without it."""
    return FittedValues(*(leaf[fold, np.arange(len(fold))] for leaf in judged))


def cross_fitted(
    judged: FittedValues, weights: Sequence[StageWeights], fold: Int[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " K"]]:
    """φ of every trajectory by models fitted without it; and the value without each of K folds, by the others alone.

    There are at least K Qs and as many weights, each fitted without one fold.
    """

    def added(judged: FittedValues, weights: StageWeights) -> Float[np.ndarray, " n"]:
        error = np.where(weights.weight > 0, judged.target - judged.taken, 0.0)
        return judged.value[:, 0] + weights.influence(error)

    each = zip(*((one.weight, one.standing) for one in weights), strict=True)
    own = StageWeights(*(np.stack(leaf)[fold, np.arange(len(fold))] for leaf in each))
    others = ((fold != k, k, one) for k, one in enumerate(weights))
    without = [
        added(FittedValues(*(leaf[k][kept] for leaf in judged)), one.take(kept)).mean() for kept, k, one in others
    ]
    return added(of_own_fold(judged, fold), own), np.array(without)


def jackknifed(value: Float[np.ndarray, "B n"], fold: Int[np.ndarray, " n"]) -> tuple[float, float]:
    """Value of the policy by Q̂ alone, and its standard error.

    V̂_1(S_1) of every trajectory is by the Qs fitted without each fold, and last by that of all trajectories.
    """
    without = np.array([each[fold != k].mean() for k, each in enumerate(value[:-1])])
    return float(value[-1].mean()), jackknife_error(without)


def judged_without(
    model: QModel,
    log: Transitions,
    reward: Float[np.ndarray, "n T"],
    fold: Int[np.ndarray, " n"],
    numbered: tuple[int, Nuisances],
) -> FittedValues:
    """Fit Q without a fold, and compute its fitted values for every trajectory."""
    k, given = numbered
    log = log._replace(weight=given.weight, imputation=given.imputation)
    regression = replace(model, pessimism=0.0).regression(*log.is_possible.shape[::2])
    with one_thread():
        q = fit_q(log.counted((fold != k).astype(np.float64)), regression)
        return judged(q, log, regression.block_of_action, regression.stages, reward)
