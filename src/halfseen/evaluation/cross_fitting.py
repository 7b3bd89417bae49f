"""What is fitted without one fold of the trajectories, and the doubly robust value by what never saw a trajectory.

*Cross-fitting*: no trajectory is judged by what it shaped [Chernozhukov2018]_.

*Delete-a-group jackknife* [Kott2001]_: all is fitted without each fold, and the value worked out on the other
trajectories. The scatter of these values tells the standard error of the whole procedure. That of the influence values,
which takes Ĝ, m and Q for given, is too small wherever the answer rests on them: stages that are hardly ever seen to
end are imputed, and the error of the regression that does so is common to all trajectories.

*Fitted Q evaluation* under censoring [Le2019]_ is eq. 3 with the policy's own action in place of the best one.

The doubly robust value of a policy under censoring, trajectory by trajectory.

    φ_i = V̂_1(S_i1) + Σ_t w_it (Y_it − Q̂_t(S_it, A_it))

*Doubly robust towards cuts* (AIPCW): Y is the pseudo-outcome of `learning.imputation`, which every begun
stage has, and w_it = ρ_it / Ĝ(U_{i,t−1}⁻). Given that a stage began, E[Y | S_t, A_t] = E[X | S_t, A_t] if Ĝ is right or
if the regressions m of X and of the duration are. So

* if ρ and Ĝ are right, E[V̂_1] + Σ_t E[ρ_t (R_t + V̂_{t+1}(S_{t+1}) − Q̂_t(S_t, A_t))] telescopes to the value,
  whatever Q̂ is, for E[ρ_{t+1} Q̂_{t+1}(S_{t+1}, A_{t+1})] = E[ρ_t V̂_{t+1}(S_{t+1})];
* if Q̂ and m are right, each term has mean 0 given (S_t, A_t), whatever ρ and Ĝ are, as long as what cuts a stage
  depends on no more than the trajectory until then.

*Simple*: w_it = ρ_it δ_it / Ĝ(U_it⁻) and Y is X = R_t + V̂_{t+1}(S_{t+1}), of completed stages alone. The first of the
two holds; the second only where durations say nothing of X beyond (S_t, A_t), for slow stages are cut more often.

The weights are self-normalised (`weights`), and Ĝ, Q̂ and m are fitted without the trajectory's own fold
[Chernozhukov2018]_. On
decisions without cuts this is the estimator of [JiangLi2016]_ and [ThomasBrunskill2016]_; the pseudo-outcomes are those
of [Robins1992]_.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from halfseen.censoring import CensoringSpec
from halfseen.errors import HalfseenError
from halfseen.evaluation.estimate import jackknife_error
from halfseen.evaluation.weights import StageWeights
from halfseen.learning.judging import FittedValues, judged
from halfseen.learning.q_model import QModel
from halfseen.learning.recursion import fit_q
from halfseen.learning.rows import Imputation, TrajectoryArrays, Transitions
from halfseen.shapes import Bool, Float, Int
from halfseen.workers.threads import one_thread


class Nuisances(NamedTuple):
    """What stands for cuts, fitted to some of the trajectories, for all of them."""

    uncut: Float[np.ndarray, "n T"]
    """δ_t / Ĝ(U_t⁻)."""
    weight: Float[np.ndarray, "n T"]
    """Of each stage in eq. 3."""
    imputation: Imputation | None


def nuisances_of(
    model: QModel, trajectories: TrajectoryArrays, is_fitted: Bool[np.ndarray, " n"] | None = None
) -> Nuisances:
    """What a fitted model says stands for cuts; durations are fitted to some trajectories, or to all."""
    cuts = model.cut_model
    uncut = trajectories.is_completed.astype(float) if cuts is None else cuts.weights(trajectories.clocks)
    return Nuisances(uncut, *model.weights_and_imputation(trajectories, is_fitted))


def nuisances_by_folds(
    model: QModel, trajectories: TrajectoryArrays, whole: Nuisances, fold: Int[np.ndarray, " n"]
) -> Iterator[Nuisances]:
    """Fit what stands for cuts without each fold in turn.

    No weight is larger than the largest of the whole log: where a fold held the last that was watched, Ĝ of the others
    may end before it. Where too little is left to fit anything, that of the whole log serves.
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
    """What each trajectory's stages are worth by the Q that never saw it."""
    return FittedValues(*(leaf[fold, np.arange(len(fold))] for leaf in judged))


def cross_fitted(
    judged: FittedValues, weights: Sequence[StageWeights], fold: Int[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " K"]]:
    """φ of every trajectory by what never saw it; and the value without each of K folds, by the others alone.

    Parameters
    ----------
    judged
        What each of at least K Qs says, fitted without one fold.
    weights
        Of the stages that have a target, without each fold.
    fold
        Of each trajectory.
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

    Parameters
    ----------
    value
        V̂_1(S_1) of every trajectory: by the Qs that were fitted without each fold, and last by that of all
        trajectories.
    fold
        Of each trajectory.
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
    """Fit Q without a fold, and let it judge every trajectory."""
    k, given = numbered
    log = log._replace(weight=given.weight, imputation=given.imputation)
    regression = replace(model, pessimism=0.0).regression(*log.is_possible.shape[::2])
    with one_thread():
        q = fit_q(log.counted((fold != k).astype(np.float64)), regression)
        return judged(q, log, regression.block_of_action, regression.stages, reward)
