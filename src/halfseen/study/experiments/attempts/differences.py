"""A mean over attempts that many repetitions of one log scored, and how well it is known.

Repetitions share their tables, so they are no independent draws, and a test that took them as such would be too sure of
itself [BengioGrandvalet2004]_. With D_tr the sum over the attempts of table t in repetition r, W_tr that of their
weights, the mean is θ = Σ D / Σ W and its residuals are e_tr = D_tr − θ W_tr. Residuals of one table go together, as
its objects and a model's errors on them do; so do those of one repetition, as they share what was learned from. The
variance allows for both [CameronGelbachMiller2011]_:

    V = (V_tables + V_repetitions − V_both) / (Σ W)²,    V_tables = G / (G − 1) · Σ_t (Σ_r e_tr)²,

and likewise the others, V no less than either alone; the interval is Student's, by the smaller number of clusters less
one. What is learned from large logs shares most of its tables in all repetitions: of these the interval says how models
of such logs do on fresh tables [Bayle2020]_, not on fresh logs.
"""

import numpy as np

from halfseen.evaluation.estimate import Estimate, around
from halfseen.shapes import Float
from halfseen.study.statistics import LEVEL

ByTable = Float[np.ndarray, "tables repetitions"]


def mean_of(sums: ByTable, weights: ByTable) -> Estimate:
    """Give the mean with its 95 % interval.

    Parameters
    ----------
    sums
        Weighted sums over the attempts at each table in each repetition; 0 where it was not held out.
    weights
        Of the attempts; 0 likewise.
    """
    is_met = weights.sum(axis=1) > 0
    sums, weights = sums[is_met], weights[is_met]
    total = float(weights.sum())
    mean = float(sums.sum() / total)
    residuals = sums - mean * weights
    by_table, by_repetition = residuals.sum(axis=1), residuals.sum(axis=0)
    tables, repetitions, both = (_sum_of_squares(each) for each in (by_table, by_repetition, residuals[weights > 0]))
    variance = max(tables + repetitions - both, tables, repetitions) / total**2
    num_clusters = min(residuals.shape)
    return around(mean, float(np.sqrt(variance)), num_clusters, num_clusters - 1, LEVEL)


def _sum_of_squares(residuals: Float[np.ndarray, " clusters"]) -> float:
    num = len(residuals)
    return float(num / max(num - 1, 1) * np.sum(np.square(residuals)))
