"""How wide a neighbourhood should be, by cross-validation: the likelihood of trajectories that were held out."""

import numpy as np

from halfseen.arrays import RowMask, Rows
from halfseen.censoring.local_curve import LocalCurve
from halfseen.shapes import Float

# In standard deviations; at infinity the covariates say nothing.
BANDWIDTHS = (0.1, 0.18, 0.32, 0.56, 1.0, 1.8, 3.2, np.inf)
NUM_BINS = 10
# Held-out trajectories that are asked about, at most: enough to choose among eight widths.
MAX_QUESTIONS = 1000
# Proportion of each forecast that is spread uniformly, so that one improbable cut does not decide alone.
UNIFORM_PROPORTION = 0.01


def cross_validated(
    ends: Rows,
    finished: RowMask,
    covariates: Float[np.ndarray, "n p"],
    kernel: str,
    num_folds: int,
    rng: np.random.Generator,
) -> dict[float, float]:
    """Mean log-likelihood of a held-out trajectory for each of `BANDWIDTHS`.

    The cut times are coarsened to ten bins (t_b, t_{b+1}] between their quantiles. A trajectory cut in bin b has
    likelihood Ĝ(t_b) − Ĝ(t_{b+1}) given its covariates, and a trajectory that finished at x has Ĝ(x⁻): the cut comes no
    sooner. Where cut and finish are independent given the covariates, this is a proper score, and needs no weights.

    Parameters
    ----------
    ends
        Observed end of each trajectory [s].
    finished
        False where cut; some trajectory is.
    covariates
        Standardised covariates.
    kernel
        One of `KERNELS`.
    num_folds
        Folds; each is foretold from the others.
    rng
        Deals the trajectories to folds, and draws those that are asked about where there are more than `MAX_QUESTIONS`.
    """
    fold = rng.permutation(np.arange(len(ends)) % num_folds)
    asked = np.zeros(len(ends), dtype=bool)
    asked[rng.permutation(len(ends))[:MAX_QUESTIONS]] = True
    edges = _edges(ends[~finished])
    totals = dict.fromkeys(BANDWIDTHS, 0.0)
    for held_out in range(num_folds):
        train, test = fold != held_out, (fold == held_out) & asked
        curve = LocalCurve.of_trajectories(ends[train], finished[train], covariates[train])
        u = np.column_stack([np.tile(np.nextafter(edges, np.inf), (test.sum(), 1)), ends[test]])
        for width in BANDWIDTHS:
            seen = curve.survival(u, covariates[test], width, kernel)
            totals[width] += _log_likelihood(seen[:, :-1], seen[:, -1], ends[test], finished[test], edges)
    return {width: total / int(asked.sum()) for width, total in totals.items()}


def _edges(cut_ends: Rows) -> Float[np.ndarray, " e"]:
    """Right ends of the bins [s]; the last is open, and holds the last cut."""
    inner = np.quantile(cut_ends, np.arange(1, NUM_BINS) / NUM_BINS, method="inverted_cdf")
    return np.unique(inner)


def _log_likelihood(
    after_edges: Float[np.ndarray, "m e"], at_end: Rows, ends: Rows, finished: RowMask, edges: Float[np.ndarray, " e"]
) -> float:
    """Sum over trajectories; a forecast that does not exist counts as the even one alone."""
    num_bins = len(edges) + 1
    one, none = np.ones((len(ends), 1)), np.zeros((len(ends), 1))
    levels = np.concatenate([one, after_edges, none], axis=1)
    mine = np.searchsorted(edges, ends, side="left")
    rows = np.arange(len(ends))
    forecast = np.where(finished, at_end, levels[rows, mine] - levels[rows, mine + 1])
    even = np.where(finished, (num_bins - mine) / num_bins, 1.0 / num_bins)
    forecast = np.where(np.isnan(forecast), 0.0, forecast)
    return float(np.log((1.0 - UNIFORM_PROPORTION) * forecast + UNIFORM_PROPORTION * even).sum())
