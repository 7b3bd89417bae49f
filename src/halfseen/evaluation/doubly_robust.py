"""The doubly robust value of a policy under censoring, trajectory by trajectory.

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

The weights are self-normalised (`ratios`), and Ĝ, Q̂ and m are fitted without the trajectory's own fold
[Chernozhukov2018]_ (`cross_fitting`). On
decisions without cuts this is the estimator of [JiangLi2016]_ and [ThomasBrunskill2016]_; the pseudo-outcomes are those
of [Robins1992]_.
"""

from collections.abc import Sequence

import numpy as np

from halfseen.evaluation.ratios import StageWeights
from halfseen.learning.judging import Judged
from halfseen.shapes import Float, Int


def doubly_robust(judged: Judged, weights: StageWeights) -> Float[np.ndarray, " n"]:
    """φ of every trajectory; the value is their mean.

    Parameters
    ----------
    judged
        What a Q says of each stage.
    weights
        Of the stages that have a target.
    """
    error = np.where(weights.weight > 0, judged.target - judged.taken, 0.0)
    return judged.value[:, 0] + weights.influence(error)


def cross_fitted(
    judged: Judged, weights: Sequence[StageWeights], fold: Int[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " K"]]:
    """φ of every trajectory by what never saw it; and the value without each of K folds, by the others alone.

    Parameters
    ----------
    judged
        What each of at least K Qs says, fitted without one fold.
    weights
        Without each fold.
    fold
        Of each trajectory.
    """
    trajectory = np.arange(len(fold))
    held_out = Judged(*(np.asarray(leaf)[fold, trajectory] for leaf in judged))
    weight, standing = (
        np.stack(each)[fold, trajectory] for each in zip(*((w.weight, w.standing) for w in weights), strict=True)
    )
    without = []
    for k, one in enumerate(weights):
        kept = fold != k
        others = Judged(*(np.asarray(leaf)[k][kept] for leaf in judged))
        without.append(doubly_robust(others, one.take(kept)).mean())
    return doubly_robust(held_out, StageWeights(weight, standing)), np.array(without)
