"""Censoring-adjusted outcomes of trajectories, and time-uniform confidence bounds on their mean.

The total reward Y_i of trajectory i is observed if it was not cut, δ_i = 1. With Ĝ and a forecast s of Y from earlier
trajectories only,

    ξ_i = s + w_i (Y_i − s),    w_i = min(δ_i / Ĝ(T_i⁻ | z_i), c_i),

has the mean of Y, and lies between s + c (low − s) and s + c (high − s) for Y in [low, high] [WaudbySmithEtAl2024]_.
The forecast removes most of the noise of the weights, and makes an error of Ĝ or the bound c a second-order effect.
The bound c_i is the largest weight among earlier trajectories: 1 without cuts.

The bounds hold after every trajectory: P(there is a t at which the mean lies outside) ≤ α for outcomes
x_i ∈ [low_i, high_i] with a common mean and ranges known in advance; outcomes may depend on earlier ones. A gambler
bets against each candidate m, with K_t(m) = Π_i (1 ± λ_i (x_i − m)). The confidence sequence holds every m against
which neither bet has multiplied the stake by 2/α. λ_i is a predictable plug-in from the mean and the variance so far
[WaudbySmithRamdas2024]_.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from halfseen.censoring.clocks import StageClocks, stacked
from halfseen.censoring.cut_model import CensoringSpec, CutModel
from halfseen.censoring.inputs import as_floats
from halfseen.errors import ArgumentError, HalfseenError
from halfseen.estimator import is_count, is_number
from halfseen.shapes import Bool, Float

MOST_BET = 0.75
"""Largest share of the stake that one outcome may lose."""


class Course(NamedTuple):
    """Bounds after each outcome."""

    lower: Float[np.ndarray, " n"]
    upper: Float[np.ndarray, " n"]


class BettingBounds:
    """Hedged betting confidence sequence, on a grid of candidates.

    Parameters
    ----------
    low, high
        Range of the mean.
    alpha
        Probability that the mean is ever outside the bounds.
    num_points
        Number of candidates from `low` to `high`; bounds are rounded outwards to them.
    """

    def __init__(self, low: float, high: float, alpha: float = 0.05, num_points: int = 401) -> None:
        if not (is_number(low) and is_number(high) and low < high):
            raise ArgumentError(
                f"low is {low!r} and high {high!r}; give two finite numbers around the mean, the lower first"
            )
        if not (is_number(alpha) and 0.0 < alpha < 1.0):
            raise ArgumentError(f"alpha is {alpha!r}; give a number between 0 and 1")
        if not is_count(num_points) or num_points < 2:
            raise ArgumentError(f"num_points is {num_points!r}; give a whole number of at least 2")
        self.low, self.high = float(low), float(high)
        self.lower, self.upper = self.low, self.high
        self.grid = np.linspace(self.low, self.high, num_points)
        self._log_need = float(np.log(2.0 / alpha))
        self._log_up, self._log_down = np.zeros(num_points), np.zeros(num_points)
        self.num = 0
        # Mean and variance so far, regularised by one pseudo-outcome.
        self._total, self._squares = 0.5 * (self.low + self.high), 0.25 * (self.high - self.low) ** 2

    def add(
        self, values: ArrayLike | float, lows: ArrayLike | float | None = None, highs: ArrayLike | float | None = None
    ) -> Course:
        """Update the bounds with the next outcomes.

        Parameters
        ----------
        values
            The outcomes in order, shape (n,).
        lows, highs
            Range of each outcome, known in advance; by default the range of the mean.

        Raises
        ------
        ArgumentError
            An outcome lies outside its range, or its range does not contain that of the mean.
        """
        x = np.atleast_1d(as_floats(values, "values"))
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
        """λ of these outcomes (eq. 26), from the variance before each; updates mean and variance."""
        t = self.num + np.arange(1, len(x) + 1)
        means = (self._total + np.cumsum(x)) / (t + 1)
        squares = np.append(self._squares, self._squares + np.cumsum((x - means) ** 2))
        self.num, self._squares = self.num + len(x), float(squares[-1])
        self._total += float(x.sum())
        return np.sqrt(2.0 * self._log_need / (np.maximum(squares[:-1] / t, 1e-12) * t * np.log1p(t)))

    def _last_out(
        self, log_capital: Float[np.ndarray, "n M"], candidates: Float[np.ndarray, " M"]
    ) -> Float[np.ndarray, " n"]:
        """The last candidate of the leading run that is ruled out; the first candidate if none is."""
        num_out = np.logical_and.accumulate(log_capital >= self._log_need, axis=1).sum(axis=1)
        return candidates[np.maximum(num_out - 1, 0)]

    def _refuse_outside(self, x: np.ndarray, below: np.ndarray, above: np.ndarray) -> None:
        room = 1e-9 * (above - below)
        wrong = ~((x >= below - room) & (x <= above + room) & (below <= self.low + room) & (above >= self.high - room))
        if wrong.any():
            at = int(np.argmax(wrong))
            raise ArgumentError(
                f"outcome {self.num + at + 1} is {x[at]} in a range of {below[at]} to {above[at]}, but the mean is "
                f"within {self.low} to {self.high}; give a range that holds both"
            )


LARGEST_WEIGHT = 4.0
"""Default upper limit of c."""
FEWEST = 20
"""Number of trajectories for the first estimate of Ĝ; earlier ones get no weight."""
LOST = 0.1
"""Share of the weights' mass that cuts may take, besides 1/√n by chance of n trajectories: where few stay until late, a
bounded weight does not make up for those that were cut, and outcomes lean to trajectories that end soon."""
MORE = 1.5
"""Factor by which the number of trajectories grows between two estimates of Ĝ."""


class Outcomes(NamedTuple):
    """ξ and the range of each; NaN for the first, until one has finished, and after too many cuts."""

    values: Float[np.ndarray, " n"]
    lows: Float[np.ndarray, " n"]
    highs: Float[np.ndarray, " n"]
    forecasts: Float[np.ndarray, " n"]
    """s."""

    @property
    def is_weighed(self) -> Bool[np.ndarray, " n"]:
        """Whether each trajectory has an outcome."""
        return ~np.isnan(self.values)


class CensoredOutcomes:
    """Computes ξ of trajectories one by one or in batches, from earlier ones only; the batches do not matter.

    Parameters
    ----------
    low, high
        Range of a trajectory's total reward.
    censoring
        How Ĝ is estimated.
    largest_weight
        Upper limit of every c_i, ≥ 1.
    """

    def __init__(
        self,
        low: float,
        high: float,
        censoring: CensoringSpec | None = None,
        largest_weight: float = LARGEST_WEIGHT,
    ) -> None:
        if not (is_number(low) and is_number(high) and low < high):
            raise ArgumentError(
                f"low is {low!r} and high {high!r}; give two finite numbers around the rewards of a trajectory, "
                "the lower first"
            )
        chosen = CensoringSpec() if censoring is None else censoring
        if not isinstance(chosen, CensoringSpec):
            raise ArgumentError(f"censoring is {censoring!r}; give CensoringSpec(…), or None for Kaplan–Meier")
        self.low, self.high, self.largest_weight = float(low), float(high), float(largest_weight)
        self.censoring = CensoringSpec(chosen.model, chosen.by, chosen.covariates, self.largest_weight)
        self._clocks: StageClocks | None = None
        self._totals = np.zeros(0)
        self._model: CutModel | None = None
        self._next, self._reach, self._weight, self._weighted = FEWEST, 1.0, 0.0, 0.0
        self.num_too_cut = 0
        """Number of trajectories that are not weighted because too many before them were cut."""
        self._is_too_cut = False

    @property
    def num(self) -> int:
        """Number of trajectories so far."""
        return len(self._totals)

    def add(self, clocks: StageClocks, totals: ArrayLike) -> Outcomes:
        """Compute the outcomes of the next trajectories.

        Parameters
        ----------
        clocks
            Their clocks, and the covariates that cuts may depend on.
        totals
            Total reward of each, shape (n,); ignored for a cut trajectory.

        Raises
        ------
        ArgumentError
            A total lies outside the range.
        """
        total = np.atleast_1d(as_floats(totals, "totals"))
        if len(total) != clocks.num_trajectories:
            raise ArgumentError(
                f"totals has {len(total)} rows for {clocks.num_trajectories} trajectories; give one each"
            )
        wrong = clocks.is_finished & ~((total >= self.low) & (total <= self.high))
        if wrong.any():
            at = int(np.argmax(wrong))
            raise ArgumentError(
                f"trajectory {clocks.trajectory_ids[at]}: its rewards add up to {total[at]:g}, outside {self.low:g} "
                f"to {self.high:g}; give bounds that contain what a trajectory can bring"
            )
        begun = self.num
        self._totals = np.append(self._totals, np.where(clocks.is_finished, total, 0.0))
        self._clocks = clocks if self._clocks is None else _joined(self._clocks, clocks)
        parts = []
        while begun < self.num:
            if begun >= self._next:
                past = self._clocks.take(slice(0, begun))
                # While none has finished, nothing is known of what one brings.
                self._model = self._fitted(past) if past.is_finished.any() else None
                if self._model is not None:
                    self._learn_reach(self._model.weights(past), past.is_finished)
                self._next = max(int(MORE * begun), begun + 1)
            end = min(self.num, self._next)
            self.num_too_cut += (end - begun) * self._is_too_cut
            parts.append(self._weighed(slice(begun, end)))
            begun = end
        return Outcomes(*(np.concatenate(each) for each in zip(*parts, strict=True))) if parts else _nothing(0)

    def _learn_reach(self, weights: Float[np.ndarray, "n T"], is_finished: Bool[np.ndarray, " n"]) -> None:
        """Learn the largest weight, and whether weights make up for the cuts, from earlier trajectories."""
        self._reach = max(1.0, float(weights.max()))
        lost = 1.0 - float(np.where(is_finished, weights.max(axis=1), 0.0).mean())
        self._is_too_cut = lost > LOST + 1.0 / np.sqrt(len(weights))

    def _fitted(self, past: StageClocks) -> CutModel:
        try:
            return self.censoring.fit_cuts(past)
        except HalfseenError:
            # Too few trajectories for the covariates of cuts.
            return CensoringSpec(truncate_at=self.largest_weight).fit_cuts(past)

    def _weighed(self, which: slice) -> Outcomes:
        if self._model is None or self._clocks is None or self._is_too_cut:
            return _nothing(which.stop - which.start)
        clocks, total = self._clocks.take(which), self._totals[which]
        finished = np.where(clocks.is_finished, self._model.weights(clocks).max(axis=1), 0.0).clip(max=self._reach)
        weight = self._weight + np.cumsum(finished)
        weighted = self._weighted + np.cumsum(finished * total)
        before, before_weighted = np.append(self._weight, weight)[:-1], np.append(self._weighted, weighted)[:-1]
        # Regularised by one pseudo-trajectory at the middle of the range.
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
