"""Kaplan–Meier in a neighbourhood: Beran's conditional product-limit estimate for the censoring time C (design, §2).

========  ==============================================================================================
symbol    here
========  ==============================================================================================
z_i       ``covariates``: row i, in standard deviations
h         ``bandwidth_``: width of the neighbourhood, in standard deviations
K_i(z)    kernel weight of trajectory i for the question z: 1 at z_i = z, falling with |z − z_i| / h
s         ``times_``: the distinct times at which trajectories were cut [s]
Ĝ(u⁻|z)   ``survival(u, z)`` = Π_{s<u} (1 − Σ_i K_i(z) 1{i cut at s} / Σ_i K_i(z) 1{i watched at s})
========  ==============================================================================================
"""

from numbers import Real
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from halfseen.censoring.bandwidth import BANDWIDTHS, cross_validated
from halfseen.censoring.covariates import checked_covariates, checked_question, refuse_constant
from halfseen.censoring.inputs import checked_ends
from halfseen.censoring.local_curve import KERNELS, LocalCurve
from halfseen.errors import ArgumentError, PositivityError
from halfseen.estimator import Estimator
from halfseen.shapes import Float


class KernelKaplanMeier(Estimator):
    """Product-limit estimate among the trajectories that are like the one asked about [Beran1981]_.

    A trajectory that finishes at s leaves before those that are cut at s. As the bandwidth grows, Ĝ becomes
    `KaplanMeier`'s; at infinity it is the same. A question near which nobody is watched any more when others are cut
    has no answer, and is refused rather than answered from afar.

    Parameters
    ----------
    bandwidth
        Width of the neighbourhood in standard deviations of the covariates, > 0; or ``"cv"``, which chooses among
        `BANDWIDTHS` by the likelihood of held-out trajectories (see `cross_validated`).
    kernel
        ``"gaussian"``: exp(−d²/2) for a distance of d bandwidths, and 0 beyond 8; ``"epanechnikov"``: 1 − d² within 1.
    num_folds
        Folds of the cross-validation.
    random_state
        Seed, or a Generator, that deals the trajectories to folds.

    Attributes
    ----------
    bandwidth_ : float
        The bandwidth in use, in standard deviations.
    cv_scores_ : dict of float to float
        Mean log-likelihood of a held-out trajectory for each bandwidth that was tried; empty if one was given.
    covariates_ : list of str
        What the columns are called.
    times_ : Float[ndarray, "k"]
        Distinct times at which trajectories were cut [s], increasing.
    num_trajectories_ : int
        Number of trajectories that the model was fitted to.
    num_cut_ : int
        Number of those that were cut.
    last_time_ : float
        The last observed end [s]; nothing was seen beyond it.

    Notes
    -----
    Each question costs O(n), so the weights of n trajectories cost O(n²); memory stays bounded.

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
        """Keep the trajectories, and choose the bandwidth; given as in `CensoringModel.fit`.

        Raises
        ------
        ArgumentError
            A time is not finite and positive, the lengths differ, a covariate is missing or constant, or a parameter
            has a value that it cannot take.
        """
        self._check_parameters()
        ends, finished = checked_ends(time, is_finished)
        values, names = checked_covariates(covariates, len(ends), "KernelKaplanMeier")
        self._means, self._scales = values.mean(axis=0), np.ones(len(names))
        if not finished.all():
            refuse_constant(values, names)
            self._scales = values.std(axis=0)
        scaled = (values - self._means) / self._scales
        self.cv_scores_ = self._scores(ends, finished, scaled)
        self.bandwidth_ = self._chosen()
        self._curve = LocalCurve.of_trajectories(ends, finished, scaled)
        self.covariates_, self.times_ = names, self._curve.times
        self.num_trajectories_, self.num_cut_ = len(ends), int(np.count_nonzero(~finished))
        self.last_time_ = float(ends.max())
        return self

    def survival(self, u: ArrayLike, covariates: Any = None) -> Float[np.ndarray, "..."]:
        """Ĝ(u⁻ | z) = P(C ≥ u | z), asked as in `CensoringModel.survival`.

        Raises
        ------
        ArgumentError
            The model is not fitted, a time is NaN, or the covariates do not match.
        PositivityError
            Some trajectory was cut before u, and none near z was still watched then.
        """
        if not hasattr(self, "times_"):
            raise ArgumentError("this KernelKaplanMeier is not fitted; call fit(time, is_finished, covariates) first")
        times, values = checked_question(u, covariates, "KernelKaplanMeier", self.covariates_)
        scaled = (values - self._means) / self._scales
        per_row = times.reshape(len(scaled), -1) if times.size else np.empty((len(scaled), 0))
        seen = self._curve.survival(per_row, scaled, self.bandwidth_, self.kernel)
        wrong = np.argwhere(np.isnan(seen))
        if len(wrong):
            row, column = wrong[0]
            raise PositivityError(
                f"covariates, row {row}: no trajectory near it was still watched when others were cut before "
                f"{per_row[row, column]:g} s, so P(C ≥ {per_row[row, column]:g} s) is not identified at bandwidth "
                f"{self.bandwidth_:g}; give a larger bandwidth, ask for an earlier time, or use Cox"
            )
        return seen.reshape(times.shape)

    def _scores(self, ends: np.ndarray, finished: np.ndarray, scaled: np.ndarray) -> dict[float, float]:
        if self.bandwidth != "cv" or finished.all() or len(ends) < 2:
            return {}
        num_folds, seed = min(self.num_folds, len(ends)), self.random_state
        return cross_validated(ends, finished, scaled, self.kernel, num_folds, np.random.default_rng(seed))

    def _chosen(self) -> float:
        """Choose the widest of the best bandwidths; where no trajectory was cut, any will do."""
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
                f"bandwidth is {self.bandwidth!r}; it is a number of standard deviations > 0, or 'cv' to choose one"
            )
        if self.kernel not in KERNELS:
            raise ArgumentError(f"kernel is {self.kernel!r}; it is 'gaussian' or 'epanechnikov'")
        if self.bandwidth == "cv" and self.num_folds < 2:
            raise ArgumentError(f"num_folds is {self.num_folds}; cross-validation needs at least 2")
