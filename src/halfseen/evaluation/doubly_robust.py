"""The doubly robust value of a policy under censoring, path by path.

    φ_i = V̂_1(S_i1) + Σ_t w_it (Y_it − Q̂_t(S_it, A_it))

*Doubly robust towards cuts* (AIPCW): Y is the pseudo-outcome of `learners.q_learning.imputation`, which every begun
stage has, and w_it = ρ_it / Ĝ(U_{i,t−1}⁻). Given that a stage began, E[Y | S_t, A_t] = E[X | S_t, A_t] if Ĝ is right or
if the regressions m of X and of the duration are. So

* if ρ and Ĝ are right, E[V̂_1] + Σ_t E[ρ_t (R_t + V̂_{t+1}(S_{t+1}) − Q̂_t(S_t, A_t))] telescopes to the value,
  whatever Q̂ is, for E[ρ_{t+1} Q̂_{t+1}(S_{t+1}, A_{t+1})] = E[ρ_t V̂_{t+1}(S_{t+1})];
* if Q̂ and m are right, each term has mean 0 given (S_t, A_t), whatever ρ and Ĝ are, as long as what cuts a stage
  depends on no more than the path until then.

*Simple*: w_it = ρ_it δ_it / Ĝ(U_it⁻) and Y is X = R_t + V̂_{t+1}(S_{t+1}), of completed stages alone. The first of the
two holds; the second only where durations say nothing of X beyond (S_t, A_t), for slow stages are cut more often.

The weights are self-normalised (`ratios`), and Q̂ and m are fitted without the path's own fold [Chernozhukov2018]_. On
decisions without cuts this is the estimator of [JiangLi2016]_ and [ThomasBrunskill2016]_; the pseudo-outcomes are those
of [Robins1992]_.
"""

import numpy as np
from jaxtyping import Float, Int

from halfseen.evaluation.ratios import StageWeights
from halfseen.learners.q_learning.judging import Judged


def held_out(judged: Judged, fold: Int[np.ndarray, " n"]) -> Judged:
    """Of what V Qs say, each fitted without one fold, take for every path what the one says that never saw it."""
    path = np.arange(len(fold))
    return Judged(*(np.asarray(leaf)[fold, path] for leaf in judged))


def doubly_robust(judged: Judged, weights: StageWeights) -> Float[np.ndarray, " n"]:
    """φ of every path; the value is their mean.

    Parameters
    ----------
    judged
        What a Q says of each stage.
    weights
        Of the stages that have a target.
    """
    error = np.where(weights.weight > 0, judged.target - judged.taken, 0.0)
    return judged.value[:, 0] + weights.influence(error)
