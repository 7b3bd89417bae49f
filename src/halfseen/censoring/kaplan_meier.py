"""Kaplan–Meier for the censoring time C, with completions before cuts at equal times (design, §2).

========  ========================================================
symbol    here
========  ========================================================
X_i       ``time``: the observed end of trajectory i [s]
δ_i       ``is_finished``: False = cut
s         ``times_``: the distinct times at which trajectories were cut [s]
Ĝ(s)      ``survival_``: just after the cuts at s
Ĝ(u⁻)     ``survival(u)``: just before the cuts at u, P(C ≥ u)
========  ========================================================
"""

import numpy as np
from numpy.typing import ArrayLike

from halfseen.arrays import RowMask, Rows
from halfseen.censoring.inputs import checked_ends, checked_times
from halfseen.censoring.tied_times import tied
from halfseen.errors import ArgumentError
from halfseen.estimator import Estimator
from halfseen.shapes import Float


class KaplanMeier(Estimator):
    """Product-limit estimate of the survival function of the censoring time, the same for all trajectories.

    Ĝ(u⁻) = Π_{s<u} (1 − cuts(s) / (at_risk(s) − finished(s))), where a trajectory that finishes at s leaves before
    those that are cut at s [KaplanMeier1958]_. Beyond the last observed end Ĝ keeps its last value: 0 when the last
    trajectories were cut, and otherwise a value that no trajectory speaks for, so ask no further than ``last_time_``.

    Attributes
    ----------
    times_ : Float[ndarray, "k"]
        Distinct times at which trajectories were cut [s], increasing.
    survival_ : Float[ndarray, "k"]
        Ĝ just after each of `times_`: the steps of the right-continuous curve.
    num_trajectories_ : int
        Number of trajectories that the curve was fitted to.
    num_cut_ : int
        Number of those that were cut.
    last_time_ : float
        The last observed end [s]; nothing was seen beyond it.
    tolerance_s_ : float
        Times that differ by no more count as equal [s]; 0 where no times of the fit do.

    Examples
    --------
    >>> KaplanMeier().fit([1.0, 2.0, 2.0, 3.0], [True, False, True, True]).survival([2.0, 2.5])
    array([1. , 0.5])
    """

    uses_covariates = False

    times_: Float[np.ndarray, " k"]
    survival_: Float[np.ndarray, " k"]
    num_trajectories_: int
    num_cut_: int
    last_time_: float
    tolerance_s_: float

    def fit(self, time: ArrayLike, is_finished: ArrayLike, covariates: object = None) -> "KaplanMeier":
        """Fit the curve, given as in `CensoringModel.fit`; a covariate that changes nothing would be a false promise.

        Raises
        ------
        ArgumentError
            A time is not finite and positive, the lengths differ, or covariates were given.
        """
        _refuse_covariates(covariates)
        ends, finished = checked_ends(time, is_finished)
        ends, self.tolerance_s_ = tied(ends)
        self.times_, self.survival_ = _steps(ends, finished)
        self.num_trajectories_ = len(ends)
        self.num_cut_ = int(len(ends) - np.count_nonzero(finished))
        self.last_time_ = float(ends.max())
        return self

    def survival(self, u: ArrayLike, covariates: object = None) -> Float[np.ndarray, "..."]:
        """Ĝ(u⁻) = P(C ≥ u), asked as in `CensoringModel.survival`.

        Raises
        ------
        ArgumentError
            The model is not fitted, or a time is NaN.
        """
        _refuse_covariates(covariates)
        if not hasattr(self, "times_"):
            raise ArgumentError("this KaplanMeier is not fitted; call fit(time, is_finished) first")
        times = checked_times(u)
        levels = np.concatenate(([1.0], self.survival_))
        # Searching in the order of the times is several times faster than jumping about in a long curve.
        order = np.argsort(times, axis=None)
        seen = np.empty(times.size)
        seen[order] = levels[np.searchsorted(self.times_, times.ravel()[order] - self.tolerance_s_, side="left")]
        return seen.reshape(times.shape)


def _steps(ends: Rows, finished: RowMask) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Find the times of the cuts and Ĝ after each: those still watched at s end in a cut ≥ s or finish > s."""
    cut_ends, own_ends = np.sort(ends[~finished]), np.sort(ends[finished])
    first = np.flatnonzero(np.diff(cut_ends, prepend=-np.inf))
    times = cut_ends[first]
    cuts = np.diff(first, append=len(cut_ends))
    num_watched = (len(cut_ends) - first) + (len(own_ends) - np.searchsorted(own_ends, times, side="right"))
    return times, np.cumprod((num_watched - cuts) / num_watched)


def _refuse_covariates(covariates: object) -> None:
    if covariates is not None:
        raise ArgumentError("KaplanMeier takes no covariates; leave them out, or choose a model that uses them")
