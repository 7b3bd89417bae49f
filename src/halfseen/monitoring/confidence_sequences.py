"""Bounds on a mean that hold at all times at once, so that they may be looked at after every trajectory.

P(there is a t at which the mean lies outside) ≤ α for outcomes x_i ∈ [low_i, high_i] of one mean, whose range is known
before they are seen; outcomes may depend on those before them. A gambler bets against each candidate m, with
K_t(m) = Π_i (1 ± λ_i (x_i − m)); the sequence holds the m against which nobody has multiplied the stake by 2/α. λ_i is
a predictable plug-in from the mean and the variance so far [WaudbySmithRamdas2024]_.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from halfseen.errors import ArgumentError
from halfseen.shapes import Float

MOST_BET = 0.75
"""Share of the stake that one outcome may lose."""


class Course(NamedTuple):
    """Bounds after each outcome."""

    lower: Float[np.ndarray, " n"]
    upper: Float[np.ndarray, " n"]


class _Moments:
    """Mean and variance so far, begun with one outcome that says nothing."""

    def __init__(self, low: float, high: float) -> None:
        self.num, self.total, self.squares = 0, 0.5 * (low + high), 0.25 * (high - low) ** 2

    def variances(self, values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """As they were before each of these outcomes, which are then counted."""
        count = self.num + np.arange(1, len(values) + 1)
        means = (self.total + np.cumsum(values)) / (count + 1)
        squares = self.squares + np.cumsum((values - means) ** 2)
        before = np.append(self.squares, squares)[:-1] / count
        if len(values):
            self.num, self.squares = int(count[-1]), float(squares[-1])
            self.total += float(values.sum())
        return before


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
        self._moments, self._log_need = _Moments(self.low, self.high), float(np.log(2.0 / alpha))
        self._log_up, self._log_down = np.zeros(num_points), np.zeros(num_points)

    @property
    def num(self) -> int:
        """Number of outcomes so far."""
        return self._moments.num

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
        """λ of these outcomes (eq. 26), which are then counted."""
        t = self.num + np.arange(1, len(x) + 1)
        return np.sqrt(2.0 * self._log_need / (np.maximum(self._moments.variances(x), 1e-12) * t * np.log1p(t)))

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
