"""What each trajectory adds to a mean under cuts, by what was known before it began.

A trajectory i brings Y_i in all, which is seen where it was not cut, δ_i = 1. With Ĝ and a forecast s of Y from the
trajectories before it alone,

    ξ_i = s + w_i (Y_i − s),    w_i = min(δ_i / Ĝ(T_i⁻ | z_i), c_i),

has the mean of Y, and lies within s + c (low − s) and s + c (high − s) for Y within low and high
[WaudbySmithEtAl2024]_. The forecast takes most of the noise of the weights away, and makes an error of Ĝ or the bound c
a matter of second order. The bound c_i is the largest weight among the trajectories before: 1 where nothing is cut.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from halfseen.censoring.clocks import StageClocks, stacked
from halfseen.censoring.cut_model import CensoringSpec, CutModel
from halfseen.errors import ArgumentError, HalfseenError
from halfseen.shapes import Bool, Float

LARGEST_WEIGHT = 4.0
"""Of c, unless another is given."""
FEWEST = 20
"""Trajectories from which Ĝ is first estimated; before, nothing is weighed."""
MORE = 1.5
"""Ĝ is estimated again once there are so many times as many trajectories."""


class Outcomes(NamedTuple):
    """ξ, and between what each had to lie; NaN, and not to be used, where nothing was weighed yet."""

    values: Float[np.ndarray, " n"]
    lows: Float[np.ndarray, " n"]
    highs: Float[np.ndarray, " n"]
    forecasts: Float[np.ndarray, " n"]
    """s."""

    @property
    def is_weighed(self) -> Bool[np.ndarray, " n"]:
        """Which there are."""
        return ~np.isnan(self.values)


class CensoredOutcomes:
    """ξ of trajectories that come one by one or in batches; by the past alone, whatever the batches.

    Parameters
    ----------
    low, high
        Between what a trajectory's rewards add up to.
    censoring
        How Ĝ is estimated.
    largest_weight
        That no c_i exceeds, ≥ 1.
    """

    def __init__(
        self,
        low: float,
        high: float,
        censoring: CensoringSpec | None = None,
        largest_weight: float = LARGEST_WEIGHT,
    ) -> None:
        if not low < high:
            raise ArgumentError(f"low is {low} and high {high}; rewards of a trajectory lie between two numbers")
        chosen = CensoringSpec() if censoring is None else censoring
        self.low, self.high, self.largest_weight = float(low), float(high), float(largest_weight)
        self.censoring = CensoringSpec(chosen.model, chosen.by, chosen.covariates, self.largest_weight)
        self._clocks: StageClocks | None = None
        self._totals = np.zeros(0)
        self._model: CutModel | None = None
        self._next, self._reach, self._weight, self._weighted = FEWEST, 1.0, 0.0, 0.0

    @property
    def num(self) -> int:
        """Number of trajectories so far."""
        return len(self._totals)

    def add(self, clocks: StageClocks, totals: ArrayLike) -> Outcomes:
        """Weigh the next trajectories.

        Parameters
        ----------
        clocks
            Their clocks, and what cuts may depend on.
        totals
            What each brought in all, shape (n,); of one that was cut it is not looked at.

        Raises
        ------
        ArgumentError
            A trajectory brought more or less than it can.
        """
        total = np.atleast_1d(np.asarray(totals, dtype=np.float64))
        wrong = clocks.is_finished & ~((total >= self.low) & (total <= self.high))
        if wrong.any():
            at = int(np.argmax(wrong))
            raise ArgumentError(
                f"trajectory {clocks.trajectory_ids[at]}: its rewards add up to {total[at]:g}, outside of {self.low:g} "
                f"to {self.high:g}; say what a trajectory can bring"
            )
        begun = self.num
        self._totals = np.append(self._totals, np.where(clocks.is_finished, total, 0.0))
        self._clocks = clocks if self._clocks is None else _joined(self._clocks, clocks)
        parts = []
        while begun < self.num:
            if begun >= self._next:
                past = self._clocks.take(slice(0, begun))
                self._model = self._fitted(past)
                self._reach = max(1.0, float(self._model.weights(past).max()))
                self._next = max(int(MORE * begun), begun + 1)
            end = min(self.num, self._next)
            parts.append(self._weighed(slice(begun, end)))
            begun = end
        return Outcomes(*(np.concatenate(each) for each in zip(*parts, strict=True))) if parts else _nothing(0)

    def _fitted(self, past: StageClocks) -> CutModel:
        try:
            return self.censoring.fit_cuts(past)
        except HalfseenError:
            # Too few trajectories for what cuts depend on.
            return CensoringSpec(truncate_at=self.largest_weight).fit_cuts(past)

    def _weighed(self, which: slice) -> Outcomes:
        if self._model is None or self._clocks is None:
            return _nothing(which.stop - which.start)
        clocks, total = self._clocks.take(which), self._totals[which]
        finished = np.where(clocks.is_finished, self._model.weights(clocks).max(axis=1), 0.0).clip(max=self._reach)
        weight = self._weight + np.cumsum(finished)
        weighted = self._weighted + np.cumsum(finished * total)
        before, before_weighted = np.append(self._weight, weight)[:-1], np.append(self._weighted, weighted)[:-1]
        # As if one trajectory more had brought what is in the middle.
        forecast = (before_weighted + 0.5 * (self.low + self.high)) / (before + 1.0)
        self._weight, self._weighted = float(weight[-1]), float(weighted[-1])
        reach = self._reach
        lows, highs = forecast + reach * (self.low - forecast), forecast + reach * (self.high - forecast)
        return Outcomes(forecast + finished * (total - forecast), lows, highs, forecast)


def _nothing(num: int) -> Outcomes:
    return Outcomes(*(np.full(num, np.nan) for _ in range(4)))


def _joined(one: StageClocks, other: StageClocks) -> StageClocks:
    num = max(one.num_stages, other.num_stages)
    return stacked([_padded(one, num), _padded(other, num)])


def _padded(clocks: StageClocks, num_stages: int) -> StageClocks:
    more = ((0, 0), (0, num_stages - clocks.num_stages))
    return clocks._replace(
        elapsed_s=np.pad(clocks.elapsed_s, more, constant_values=np.nan),
        is_begun=np.pad(clocks.is_begun, more),
        covariates=np.pad(clocks.covariates, (*more, (0, 0))),
    )
