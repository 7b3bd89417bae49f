"""What each trajectory adds to a mean under cuts, and bounds on that mean that hold at all times at once.

A trajectory i brings Y_i in all, which is seen where it was not cut, δ_i = 1. With Ĝ and a forecast s of Y from the
trajectories before it alone,

    ξ_i = s + w_i (Y_i − s),    w_i = min(δ_i / Ĝ(T_i⁻ | z_i), c_i),

has the mean of Y, and lies within s + c (low − s) and s + c (high − s) for Y within low and high
[WaudbySmithEtAl2024]_. The forecast takes most of the noise of the weights away, and makes an error of Ĝ or the bound c
a matter of second order. The bound c_i is the largest weight among the trajectories before: 1 where nothing is cut.

Bounds may be looked at after every trajectory: P(there is a t at which the mean lies outside) ≤ α for outcomes
x_i ∈ [low_i, high_i] of one mean, whose range is known before they are seen; outcomes may depend on those before them.
A gambler bets against each candidate m, with K_t(m) = Π_i (1 ± λ_i (x_i − m)); the sequence holds the m against which
nobody has multiplied the stake by 2/α. λ_i is a predictable plug-in from the mean and the variance so far
[WaudbySmithRamdas2024]_.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from halfseen.censoring.clocks import StageClocks, stacked
from halfseen.censoring.cut_model import CensoringSpec, CutModel
from halfseen.errors import ArgumentError, HalfseenError
from halfseen.shapes import Bool, Float

MOST_BET = 0.75
"""Share of the stake that one outcome may lose."""


class Course(NamedTuple):
    """Bounds after each outcome."""

    lower: Float[np.ndarray, " n"]
    upper: Float[np.ndarray, " n"]


class BettingBounds:
    """The hedged betting sequence, on a grid of candidates.

    Parameters
    ----------
    low, high
        Between what the mean lies.
    alpha
        Chance that the mean is ever outside.
    num_points
        Candidates between `low` and `high`; bounds are rounded outwards to them.
    """

    def __init__(self, low: float, high: float, alpha: float = 0.05, num_points: int = 401) -> None:
        if not (np.isfinite([low, high]).all() and low < high):
            raise ArgumentError(
                f"low is {low} and high {high}; the mean lies between two finite numbers, the lower first"
            )
        if not 0.0 < alpha < 1.0:
            raise ArgumentError(f"alpha is {alpha}; it lies between 0 and 1")
        self.low, self.high = float(low), float(high)
        self.lower, self.upper = self.low, self.high
        self.grid = np.linspace(self.low, self.high, num_points)
        self._log_need = float(np.log(2.0 / alpha))
        self._log_up, self._log_down = np.zeros(num_points), np.zeros(num_points)
        self.num = 0
        # Mean and variance so far, begun with one outcome that says nothing.
        self._total, self._squares = 0.5 * (self.low + self.high), 0.25 * (self.high - self.low) ** 2

    def add(
        self, values: ArrayLike | float, lows: ArrayLike | float | None = None, highs: ArrayLike | float | None = None
    ) -> Course:
        """Go on with the next outcomes.

        Parameters
        ----------
        values
            The outcomes in their order, shape (n,).
        lows, highs
            Between what each had to lie, as known before it was seen; by default where the mean lies.

        Raises
        ------
        ArgumentError
            An outcome lies outside of its range, or its range does not hold that of the mean.
        """
        x = np.atleast_1d(np.asarray(values, dtype=np.float64))
        below = np.broadcast_to(np.asarray(self.low if lows is None else lows, dtype=np.float64), x.shape)
        above = np.broadcast_to(np.asarray(self.high if highs is None else highs, dtype=np.float64), x.shape)
        self._refuse_outside(x, below, above)
        bet, m = self._bets(x)[:, None], self.grid
        with np.errstate(divide="ignore"):
            up = np.minimum(bet, MOST_BET / np.maximum(m - below[:, None], 0.0))
            down = np.minimum(bet, MOST_BET / np.maximum(above[:, None] - m, 0.0))
        log_up = self._log_up + np.cumsum(np.log1p(up * (x[:, None] - m)), axis=0)
        log_down = self._log_down + np.cumsum(np.log1p(-down * (x[:, None] - m)), axis=0)
        if len(x):
            self._log_up, self._log_down = log_up[-1], log_down[-1]
        lower = np.maximum.accumulate(np.maximum(self._last_out(log_up, m), self.lower))
        upper = np.minimum.accumulate(np.minimum(self._last_out(log_down[:, ::-1], m[::-1]), self.upper))
        if len(x):
            self.lower, self.upper = float(lower[-1]), float(upper[-1])
        return Course(lower, upper)

    def _bets(self, x: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """λ of these outcomes (eq. 26), by the variance before each; they are then counted."""
        t = self.num + np.arange(1, len(x) + 1)
        means = (self._total + np.cumsum(x)) / (t + 1)
        squares = np.append(self._squares, self._squares + np.cumsum((x - means) ** 2))
        self.num, self._squares = self.num + len(x), float(squares[-1])
        self._total += float(x.sum())
        return np.sqrt(2.0 * self._log_need / (np.maximum(squares[:-1] / t, 1e-12) * t * np.log1p(t)))

    def _last_out(
        self, log_capital: Float[np.ndarray, "n M"], candidates: Float[np.ndarray, " M"]
    ) -> Float[np.ndarray, " n"]:
        """The last of the first candidates that are all ruled out; the first where none is."""
        num_out = np.logical_and.accumulate(log_capital >= self._log_need, axis=1).sum(axis=1)
        return candidates[np.maximum(num_out - 1, 0)]

    def _refuse_outside(self, x: np.ndarray, below: np.ndarray, above: np.ndarray) -> None:
        room = 1e-9 * (above - below)
        wrong = ~((x >= below - room) & (x <= above + room) & (below <= self.low + room) & (above >= self.high - room))
        if wrong.any():
            at = int(np.argmax(wrong))
            raise ArgumentError(
                f"outcome {self.num + at + 1} is {x[at]} in a range of {below[at]} to {above[at]}, and the mean lies "
                f"within {self.low} to {self.high}; give a range that holds both"
            )


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
