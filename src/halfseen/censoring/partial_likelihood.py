"""Cox's partial likelihood of the cuts, with its gradient and information, for trajectories sorted once.

A trajectory that finishes at s leaves before those that are cut at s. So in the order of the time, finishes first,
those at risk at a cut time are the trajectories from its first cut on, and every sum over them is a suffix sum.

========  ==============================================================================================
symbol    here
========  ==============================================================================================
s_k       ``times``: the distinct times at which trajectories were cut [s]
R_k       the risk set at s_k: the rows from ``first[k]`` on
D_k       cut at s_k: the ``num_cuts[k]`` rows from ``first[k]`` on
r_i       relative risk exp(z_i β)
φ_j       proportion of the risk of D_k that has left before the j-th cut: 0 for Breslow, (place in D_k)/|D_k| for Efron
D_j       ``at_risk``: Σ_{R_k} r − φ_j Σ_{D_k} r, one for each cut j
========  ==============================================================================================
"""

from dataclasses import dataclass

import numpy as np

from halfseen.arrays import RowMask, Rows
from halfseen.shapes import Float, Int

# Relative to the largest risk; the inverse and its sums still are floats.
SMALLEST_RISK = 1e-290


@dataclass(frozen=True)
class CutOrder:
    """Trajectories in the order in which they leave, and where each group of cuts stands in it.

    Parameters
    ----------
    order
        Rows of the trajectories, sorted by time, finishes before cuts at equal times.
    times
        Distinct times at which trajectories were cut [s].
    first
        Place in the order of the first trajectory cut at each time.
    num_cuts
        Number of trajectories cut at each time.
    group
        For each cut, the index of its time.
    place
        For each cut, its place among those cut at its time, from 0.
    """

    order: Int[np.ndarray, " n"]
    times: Float[np.ndarray, " k"]
    first: Int[np.ndarray, " k"]
    num_cuts: Int[np.ndarray, " k"]
    group: Int[np.ndarray, " c"]
    place: Int[np.ndarray, " c"]

    @property
    def cuts(self) -> Int[np.ndarray, " c"]:
        """Place in the order of each cut."""
        return self.first[self.group] + self.place


def cut_order(ends: Rows, finished: RowMask) -> CutOrder:
    """Sort trajectories by their ends, finishes before cuts at equal times."""
    order = np.lexsort((~finished, ends))
    cuts = np.flatnonzero(~finished[order])
    cut_ends = ends[order[cuts]]
    begins = np.flatnonzero(np.diff(cut_ends, prepend=-np.inf))
    num_cuts = np.diff(begins, append=len(cuts))
    group = np.repeat(np.arange(len(begins)), num_cuts)
    return CutOrder(order, cut_ends[begins], cuts[begins], num_cuts, group, np.arange(len(cuts)) - begins[group])


@dataclass(frozen=True)
class PartialLikelihood:
    """The partial likelihood at one β.

    Parameters
    ----------
    value
        Its logarithm.
    gradient
        Its gradient, the score.
    information
        Minus its Hessian, the observed information: positive semidefinite.
    hazard
        Step of the baseline cumulative hazard at each cut time: Σ_j 1/D_j over the cuts there.
    """

    value: float
    gradient: Float[np.ndarray, " p"]
    information: Float[np.ndarray, "p p"]
    hazard: Float[np.ndarray, " k"]


def partial_likelihood(
    beta: Float[np.ndarray, " p"], covariates: Float[np.ndarray, "n p"], trajectories: CutOrder, is_efron: bool
) -> PartialLikelihood:
    """Evaluate Cox's partial likelihood [Cox1972]_ in O(n p²), ties after [Breslow1974]_ or [Efron1977]_.

    Parameters
    ----------
    beta
        Coefficients.
    covariates
        Covariates of the trajectories, in their order of leaving.
    trajectories
        That order.
    is_efron
        Efron's treatment of ties among the cuts; otherwise Breslow's.

    Notes
    -----
    No p × p matrix is made for each trajectory. Σ_j Σ_{i ∈ R_j} r_i z_i z_iᵀ / D_j is one product Zᵀ diag(r · exposure)
    Z, where a trajectory's exposure Σ_{j: i ∈ R_j} 1/D_j grows from cut to cut while it is watched.
    """
    scores = covariates @ beta
    # Relative to the largest, so that no risk overflows.
    shift = scores.max()
    risk = np.exp(scores - shift)
    cuts, group = trajectories.cuts, trajectories.group
    at_risk = _suffix_sums(risk)[trajectories.first][group]
    at_risk_gradient = _suffix_sums(risk[:, None] * covariates)[trajectories.first][group]
    phi = trajectories.place / trajectories.num_cuts[group] if is_efron else np.zeros(len(cuts))
    if is_efron:
        at_risk = at_risk - phi * _group_sums(risk[cuts], trajectories)[group]
        cut_gradient = _group_sums(risk[cuts, None] * covariates[cuts], trajectories)[group]
        at_risk_gradient = at_risk_gradient - phi[:, None] * cut_gradient
    if at_risk.min() < SMALLEST_RISK:
        return _nowhere(len(beta), len(trajectories.times))
    mean = at_risk_gradient / at_risk[:, None]
    hazard = _group_sums(1.0 / at_risk, trajectories)
    steps = np.zeros(len(risk))
    steps[trajectories.first] = hazard
    exposure = np.cumsum(steps)
    exposure[cuts] -= _group_sums(phi / at_risk, trajectories)[group]
    return PartialLikelihood(
        value=float((scores[cuts] - shift).sum() - np.log(at_risk).sum()),
        gradient=(covariates[cuts] - mean).sum(axis=0),
        information=covariates.T @ ((risk * exposure)[:, None] * covariates) - mean.T @ mean,
        hazard=hazard * np.exp(-shift),
    )


def _nowhere(num_covariates: int, num_times: int) -> PartialLikelihood:
    """β is so large that all risk at some cut time underflows."""
    information = np.full((num_covariates, num_covariates), np.nan)
    return PartialLikelihood(-np.inf, np.full(num_covariates, np.nan), information, np.full(num_times, np.nan))


def _suffix_sums(values: np.ndarray) -> np.ndarray:
    return np.cumsum(values[::-1], axis=0)[::-1]


def _group_sums(values: np.ndarray, trajectories: CutOrder) -> np.ndarray:
    """Sum over the cuts at each time."""
    return np.add.reduceat(values, np.concatenate(([0], np.cumsum(trajectories.num_cuts)[:-1])), axis=0)
