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

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from halfseen.arrays import RowMask, Rows
from halfseen.censoring.clocks import tied
from halfseen.censoring.inputs import checked_ends, checked_times, just_before, precision_of
from halfseen.errors import ArgumentError
from halfseen.estimator import Estimator
from halfseen.shapes import Float, Int


@dataclass(frozen=True)
class CutOrder:
    """Trajectories in the order in which they leave, and the positions of each group of cuts."""

    order: Int[np.ndarray, " n"]
    """Rows of the trajectories, sorted by time, finishes before cuts at equal times."""
    times: Float[np.ndarray, " k"]
    """Distinct times at which trajectories were cut [s]."""
    first: Int[np.ndarray, " k"]
    """Position of the first trajectory cut at each time; those from it on are at risk."""
    num_cuts: Int[np.ndarray, " k"]
    """Number of trajectories cut at each time."""
    group: Int[np.ndarray, " c"]
    """For each cut, the index of its time."""
    place: Int[np.ndarray, " c"]
    """For each cut, its place among the cuts at its time, from 0."""

    @property
    def cuts(self) -> Int[np.ndarray, " c"]:
        """Position of each cut in the order."""
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


class KaplanMeier(Estimator):
    """Product-limit estimate of the survival function of the censoring time, without covariates.

    Ĝ(u⁻) = Π_{s<u} (1 − cuts(s) / (at_risk(s) − finished(s))), where a trajectory that finishes at s leaves before
    those cut at s [KaplanMeier1958]_. Beyond the last observed end Ĝ keeps its last value: 0 if the last trajectories
    were cut, and otherwise an extrapolation without data, so do not use it beyond ``last_time_``.

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
        The last observed end [s]; there are no data beyond it.
    tolerance_s_ : float
        Times that differ by no more count as equal [s].

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
    _precision: float = 0.0

    def fit(self, time: ArrayLike, is_finished: ArrayLike, covariates: object = None) -> "KaplanMeier":
        """Fit the curve; parameters as in `CensoringModel.fit`, but covariates, which have no effect, are refused.

        Raises
        ------
        ArgumentError
            A time is not finite and positive, the lengths differ, or covariates were given.
        """
        _refuse_covariates(covariates)
        ends, finished = checked_ends(time, is_finished)
        ends, self.tolerance_s_ = tied(ends)
        self._precision = precision_of(time)
        order = cut_order(ends, finished)
        num_watched = len(ends) - order.first
        self.times_, self.survival_ = order.times, np.cumprod((num_watched - order.num_cuts) / num_watched)
        self.num_trajectories_, self.num_cut_ = len(ends), len(order.cuts)
        self.last_time_ = float(ends.max())
        return self

    def survival(self, u: ArrayLike, covariates: object = None) -> Float[np.ndarray, "..."]:
        """Ĝ(u⁻) = P(C ≥ u); parameters as in `CensoringModel.survival`.

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
        # Searching in sorted order is several times faster than random access in a long curve.
        order = np.argsort(times, axis=None)
        seen = np.empty(times.size)
        before = just_before(times.ravel()[order], self.tolerance_s_, max(self._precision, precision_of(u)))
        seen[order] = levels[np.searchsorted(self.times_, before, side="left")]
        return seen.reshape(times.shape)


def _refuse_covariates(covariates: object) -> None:
    if covariates is not None:
        raise ArgumentError("KaplanMeier takes no covariates; leave them out, or choose a model that uses them")
