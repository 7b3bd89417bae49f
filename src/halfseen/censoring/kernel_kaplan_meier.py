"""Local Kaplan–Meier: Beran's conditional product-limit estimate for the censoring time C (design, §2).

The bandwidth is chosen by the likelihood of held-out trajectories.

========  ==============================================================================================
symbol    here
========  ==============================================================================================
z_i       ``covariates``: row i, in standard deviations
h         ``bandwidth_``: width of the neighbourhood, in standard deviations
K_i(z)    kernel weight of trajectory i at the query z: 1 at z_i = z, falling with |z − z_i| / h
s         ``times_``: the distinct times at which trajectories were cut [s]
Ĝ(u⁻|z)   ``survival(u, z)`` = Π_{s<u} (1 − Σ_i K_i(z) 1{i cut at s} / Σ_i K_i(z) 1{i at risk at s})
========  ==============================================================================================
"""

from collections.abc import Iterator
from dataclasses import dataclass
from numbers import Real
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from halfseen.arrays import RowMask, Rows
from halfseen.censoring.clocks import tied
from halfseen.censoring.inputs import (
    checked_covariates,
    checked_ends,
    checked_question,
    just_before,
    precision_of,
    refuse_constant,
    refuse_other_order,
)
from halfseen.censoring.kaplan_meier import CutOrder, cut_order
from halfseen.errors import ArgumentError, PositivityError
from halfseen.estimator import Estimator, check_generator, is_count
from halfseen.shapes import Float

# In standard deviations; at infinity the covariates have no effect.
BANDWIDTHS = (0.1, 0.18, 0.32, 0.56, 1.0, 1.8, 3.2, np.inf)
NUM_BINS = 10
# Held-out trajectories to evaluate, at most: enough to choose among eight bandwidths.
MAX_QUESTIONS = 1000
# Proportion of each predicted distribution that is uniform, so that one improbable cut does not decide alone.
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
    likelihood Ĝ(t_b) − Ĝ(t_{b+1}) given its covariates, and a trajectory that finished at x has Ĝ(x⁻), because its cut
    would come later. If cut and finish are independent given the covariates, this is a proper score without weights.

    Parameters
    ----------
    ends
        Observed end of each trajectory [s].
    finished
        False if cut; at least one is.
    covariates
        Standardised covariates.
    kernel
        One of `KERNELS`.
    num_folds
        Folds; each is predicted from the others.
    rng
        Generator that assigns trajectories to folds, and samples them if there are more than `MAX_QUESTIONS`.
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
    """Sum over trajectories; where no prediction exists, only the uniform part counts."""
    num_bins = len(edges) + 1
    one, none = np.ones((len(ends), 1)), np.zeros((len(ends), 1))
    levels = np.concatenate([one, after_edges, none], axis=1)
    mine = np.searchsorted(edges, ends, side="left")
    rows = np.arange(len(ends))
    forecast = np.where(finished, at_end, levels[rows, mine] - levels[rows, mine + 1])
    even = np.where(finished, (num_bins - mine) / num_bins, 1.0 / num_bins)
    forecast = np.where(np.isnan(forecast), 0.0, forecast)
    return float(np.log((1.0 - UNIFORM_PROPORTION) * forecast + UNIFORM_PROPORTION * even).sum())


# Floats in one block of queries × trajectories: 32 MB.
BLOCK_SIZE = 4_000_000
# A trajectory farther away than this many bandwidths has no effect: exp(−8²/2) is 1e-14.
GAUSSIAN_REACH = 8.0


KERNELS = {
    "gaussian": lambda squared: np.where(squared <= GAUSSIAN_REACH**2, np.exp(-squared / 2), 0.0),
    "epanechnikov": lambda squared: np.maximum(1.0 - squared, 0.0),
}
"""Of squared distances in bandwidths."""


@dataclass(frozen=True)
class LocalCurve:
    """Trajectories in the order in which they leave."""

    covariates: Float[np.ndarray, "n p"]
    """Standardised covariates of the trajectories, in that order."""
    trajectories: CutOrder
    """The order, and the positions of the cuts."""

    @classmethod
    def of_trajectories(cls, ends: Rows, finished: RowMask, covariates: Float[np.ndarray, "n p"]) -> "LocalCurve":
        """Sort trajectories by their ends [s], finishes before cuts at equal times."""
        trajectories = cut_order(ends, finished)
        return cls(covariates[trajectories.order], trajectories)

    @property
    def times(self) -> Float[np.ndarray, " k"]:
        """Distinct times at which trajectories were cut [s]."""
        return self.trajectories.times

    def survival(
        self, u: Float[np.ndarray, "m q"], covariates: Float[np.ndarray, "m p"], bandwidth: float, kernel: str
    ) -> Float[np.ndarray, "m q"]:
        """Ĝ(u⁻ | z); NaN if no trajectory near z was at risk at some cut before u."""
        distinct, question = np.unique(covariates, axis=0, return_inverse=True)
        question = question.reshape(-1)
        step = np.searchsorted(self.times, u, side="left")
        seen = np.ones(u.shape)
        rows = np.argsort(question, kind="stable")
        bounds = np.searchsorted(question[rows], np.arange(len(distinct) + 1))
        for block in _blocks(len(distinct), len(self.covariates)):
            levels = self._levels(distinct[block], bandwidth, kernel)
            mine = rows[bounds[block.start] : bounds[block.stop]]
            seen[mine] = levels[question[mine, None] - block.start, step[mine]]
        return seen

    def _levels(self, covariates: Float[np.ndarray, "b p"], bandwidth: float, kernel: str) -> Float[np.ndarray, "b K"]:
        """Ĝ before the first cut and after each, one row per query."""
        trajectories = self.trajectories
        ones = np.ones((len(covariates), 1))
        if len(trajectories.times) == 0:
            return ones
        from scipy.spatial.distance import cdist

        with np.errstate(over="ignore"):
            near = KERNELS[kernel](np.square(cdist(covariates, self.covariates) / bandwidth))
        # One extra column: the risk set after the last trajectory is empty.
        watched = np.pad(np.cumsum(near[:, ::-1], axis=1)[:, ::-1], ((0, 0), (0, 1)))
        before, after = watched[:, trajectories.first], watched[:, trajectories.first + trajectories.num_cuts]
        stays = np.divide(after, before, out=np.full(before.shape, np.nan), where=before > 0)
        return np.concatenate([ones, np.cumprod(stays, axis=1)], axis=1)


def _blocks(num_questions: int, num_trajectories: int) -> Iterator[slice]:
    size = max(1, BLOCK_SIZE // max(1, num_trajectories))
    for start in range(0, num_questions, size):
        yield slice(start, min(start + size, num_questions))


class KernelKaplanMeier(Estimator):
    """Product-limit estimate among the trajectories with similar covariates [Beran1981]_.

    A trajectory that finishes at s leaves before those cut at s. As the bandwidth grows, Ĝ approaches `KaplanMeier`'s;
    at infinity they are equal. A query is refused, rather than extrapolated, if no trajectory near it is at risk at
    some cut.

    Parameters
    ----------
    bandwidth
        Width of the neighbourhood in standard deviations of the covariates, > 0; or ``"cv"`` to choose among
        `BANDWIDTHS` by the likelihood of held-out trajectories (see `cross_validated`).
    kernel
        ``"gaussian"``: exp(−d²/2) for a distance of d bandwidths, and 0 beyond 8; ``"epanechnikov"``: 1 − d² within 1.
    num_folds
        Folds of the cross-validation.
    random_state
        Seed or Generator that assigns trajectories to folds.

    Attributes
    ----------
    bandwidth_ : float
        The bandwidth in use, in standard deviations.
    cv_scores_ : dict of float to float
        Mean log-likelihood of a held-out trajectory for each bandwidth tried; empty if one was given.
    covariates_ : list of str
        Names of the columns.
    times_ : Float[ndarray, "k"]
        Distinct times at which trajectories were cut [s], increasing.
    num_trajectories_ : int
        Number of trajectories that the model was fitted to.
    num_cut_ : int
        Number of those that were cut.
    last_time_ : float
        The last observed end [s]; there are no data beyond it.
    tolerance_s_ : float
        Times that differ by no more count as equal [s].

    Notes
    -----
    Each query costs O(n), so the weights of n trajectories cost O(n²); memory stays bounded.

    Examples
    --------
    >>> clutter = [[0.1], [0.2], [0.3], [0.7], [0.8], [0.9]]
    >>> near = KernelKaplanMeier(bandwidth=0.5).fit([6.0, 5.0, 7.0, 2.0, 3.0, 4.0], [1, 1, 1, 0, 0, 1], clutter)
    >>> near.survival([4.0, 4.0], [[0.1], [0.9]]).round(2)
    array([1.  , 0.44])
    """

    uses_covariates = True

    bandwidth_: float
    cv_scores_: dict[float, float]
    covariates_: list[str]
    times_: Float[np.ndarray, " k"]
    num_trajectories_: int
    num_cut_: int
    last_time_: float
    tolerance_s_: float
    _precision: float = 0.0

    def __init__(
        self,
        bandwidth: float | int | Literal["cv"] = "cv",
        kernel: Literal["gaussian", "epanechnikov"] = "gaussian",
        num_folds: int = 5,
        random_state: int | np.random.Generator = 0,
    ) -> None:
        self.bandwidth = bandwidth
        self.kernel = kernel
        self.num_folds = num_folds
        self.random_state = random_state

    def fit(self, time: ArrayLike, is_finished: ArrayLike, covariates: Any = None) -> "KernelKaplanMeier":
        """Store the trajectories and choose the bandwidth; parameters as in `CensoringModel.fit`.

        Raises
        ------
        ArgumentError
            A time is not finite and positive, the lengths differ, a covariate is missing or constant, or a parameter is
            invalid.
        """
        self._check_parameters()
        refuse_other_order(time=time, covariates=covariates)
        ends, finished = checked_ends(time, is_finished)
        values, names = checked_covariates(covariates, len(ends), "KernelKaplanMeier")
        self._means, self._scales = values.mean(axis=0), np.ones(len(names))
        if not finished.all():
            refuse_constant(values, names)
            self._scales = values.std(axis=0)
        scaled = (values - self._means) / self._scales
        ends, self.tolerance_s_ = tied(ends)
        self._precision = precision_of(time)
        self.cv_scores_ = self._scores(ends, finished, scaled)
        self.bandwidth_ = self._chosen()
        self._curve = LocalCurve.of_trajectories(ends, finished, scaled)
        self.covariates_, self.times_ = names, self._curve.times
        self.num_trajectories_, self.num_cut_ = len(ends), int(np.count_nonzero(~finished))
        self.last_time_ = float(ends.max())
        return self

    def survival(self, u: ArrayLike, covariates: Any = None) -> Float[np.ndarray, "..."]:
        """Ĝ(u⁻ | z) = P(C ≥ u | z); parameters as in `CensoringModel.survival`.

        Raises
        ------
        ArgumentError
            The model is not fitted, a time is NaN, or the covariates do not match.
        PositivityError
            A trajectory was cut before u, and none near z was still at risk then.
        """
        if not hasattr(self, "times_"):
            raise ArgumentError("this KernelKaplanMeier is not fitted; call fit(time, is_finished, covariates) first")
        times, values = checked_question(u, covariates, "KernelKaplanMeier", self.covariates_)
        scaled = (values - self._means) / self._scales
        per_row = times.reshape(len(scaled), -1) if times.size else np.empty((len(scaled), 0))
        before = just_before(per_row, self.tolerance_s_, max(self._precision, precision_of(u)))
        seen = self._curve.survival(before, scaled, self.bandwidth_, self.kernel)
        wrong = np.argwhere(np.isnan(seen))
        if len(wrong):
            row, column = wrong[0]
            raise PositivityError(
                f"covariates, row {row}: no trajectory near it was still at risk when others were cut before "
                f"{per_row[row, column]:g} s, so P(C ≥ {per_row[row, column]:g} s) is not identified at "
                f"bandwidth {self.bandwidth_:g}; give a larger bandwidth, ask for an earlier time, or use Cox"
            )
        return seen.reshape(times.shape)

    def _scores(self, ends: np.ndarray, finished: np.ndarray, scaled: np.ndarray) -> dict[float, float]:
        if self.bandwidth != "cv" or finished.all() or len(ends) < 2:
            return {}
        num_folds, seed = min(self.num_folds, len(ends)), self.random_state
        return cross_validated(ends, finished, scaled, self.kernel, num_folds, np.random.default_rng(seed))

    def _chosen(self) -> float:
        """Choose the largest of the best bandwidths; if no trajectory was cut, all are equal."""
        if self.bandwidth != "cv":
            return float(self.bandwidth)
        if not self.cv_scores_:
            return BANDWIDTHS[-1]
        best = max(self.cv_scores_.values())
        return max(width for width, score in self.cv_scores_.items() if score == best)

    def _check_parameters(self) -> None:
        is_number = isinstance(self.bandwidth, Real) and not isinstance(self.bandwidth, bool)
        if self.bandwidth != "cv" and not (is_number and float(self.bandwidth) > 0):
            raise ArgumentError(
                f"bandwidth is {self.bandwidth!r}; give a number of standard deviations > 0, or 'cv' to choose one"
            )
        check_generator(self.random_state)
        if self.kernel not in KERNELS:
            raise ArgumentError(f"kernel is {self.kernel!r}; give 'gaussian' or 'epanechnikov'")
        if self.bandwidth == "cv" and not (is_count(self.num_folds) and self.num_folds >= 2):
            raise ArgumentError(f"num_folds is {self.num_folds!r}; cross-validation needs at least 2")
