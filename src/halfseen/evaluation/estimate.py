"""An estimate with its interval, from the contributions of trajectories.

The range of possible returns follows from the rewards in a log. Backwards over stages, with R_t over completed stages,

    M_t = max(max R_t of those with which a trajectory finished, M_{t+1} + max R_t of the others),   M_{T+1} = 0,

and the minimum likewise. The mean return of every policy lies inside, unless it earns rewards that were never observed.
So an estimate outside is moved to the nearer end, and intervals are clipped to the range.
"""

from dataclasses import dataclass, replace
from numbers import Real
from typing import Any, NamedTuple

import numpy as np

from halfseen.errors import ArgumentError
from halfseen.learning.rows import TrajectoryArrays
from halfseen.shapes import Float

LARGEST_LEVEL = 0.999999
"""Above it, an interval depends on tails that no log can show, and 1 − level on rounding."""


@dataclass(frozen=True)
class Estimate:
    """A value and its uncertainty.

    Parameters
    ----------
    value
        The estimate, in units of the reward.
    low, high
        Ends of the interval at the requested level.
    standard_error
        Of `value`.
    effective_sample_size
        Number of trajectories of equal weight with the same information.
    degrees_of_freedom
        Of the t distribution behind the interval.
    bias
        Bias, of either sign, that the interval allows for.
    """

    value: float
    low: float
    high: float
    standard_error: float
    effective_sample_size: float
    degrees_of_freedom: float = np.inf
    bias: float = 0.0

    @property
    def p_value(self) -> float:
        """Two-sided p-value of a true value of 0, at the worst bias; by the distribution of the interval.

        1 for an estimate of 0 without uncertainty.
        """
        if self.standard_error == 0.0:
            return float(abs(self.value) <= self.bias)
        return _beyond(abs(self.value) / self.standard_error, self.bias / self.standard_error, self.degrees_of_freedom)


def estimate_of(
    influence: Float[np.ndarray, " n"],
    effective_sample_size: float | int,
    level: float,
    without: Float[np.ndarray, " K"] | None = None,
    bias: float = 0.0,
    least_error: float = 0.0,
) -> Estimate:
    """Mean of the contributions of trajectories, with a t interval of (effective sample size − 1) degrees of freedom.

    With heavy weights few trajectories dominate the mean, and its spread is estimated from those few. If the values
    without each group of trajectories are known, the standard error is at least that of the jackknife.

    Parameters
    ----------
    influence
        Contribution of each trajectory; the estimate is the mean.
    effective_sample_size
        Number of trajectories of equal weight with the same information.
    level
        Of the interval.
    without
        The value without each of K groups of trajectories.
    bias
        Bias to allow for, of either sign.
    least_error
        Lower bound of the standard error.
    """
    value, error = float(np.mean(influence)), float(np.std(influence, ddof=1) / np.sqrt(len(influence)))
    by_trajectories = around(
        value, max(error, least_error), effective_sample_size, effective_sample_size - 1.0, level, bias
    )
    if without is None:
        return by_trajectories
    by_groups = around(value, jackknife_error(without), effective_sample_size, len(without) - 1, level, bias)
    return max(by_trajectories, by_groups, key=lambda one: one.high - one.low)


def jackknife_error(without: Float[np.ndarray, " K"]) -> float:
    """Standard error by the delete-a-group jackknife [Kott2001]_, given the value without each of K groups."""
    num_groups = len(without)
    return float(np.sqrt((num_groups - 1.0) / num_groups * np.sum((without - without.mean()) ** 2)))


def around(
    value: float,
    standard_error: float,
    effective_sample_size: float | int,
    freedom: float | int,
    level: float,
    bias: float = 0.0,
) -> Estimate:
    """A t interval around a value whose standard error has `freedom` degrees of freedom, at least 1.

    With a bias of at most β, of either sign, it is the shortest symmetric interval with coverage `level`
    [ArmstrongKolesar2018]_.
    """
    known = max(float(freedom), 1.0)
    shift = bias / standard_error if standard_error > 0.0 else np.inf
    reach = bias if np.isinf(shift) else _quantile(level, shift, known) * standard_error
    return Estimate(value, value - reach, value + reach, standard_error, float(effective_sample_size), known, bias)


def within(estimate: Estimate, low: float, high: float) -> Estimate:
    """The same estimate, with its interval clipped to the known range."""
    return replace(estimate, low=max(estimate.low, low), high=min(estimate.high, high))


def _beyond(x: float, shift: float, freedom: float) -> float:
    """P(|T + shift| > x)."""
    from scipy.special import stdtr

    return float(stdtr(freedom, shift - x) + stdtr(freedom, -shift - x))


def _quantile(level: float, shift: float, freedom: float) -> float:
    """The x that |T + shift| exceeds with probability 1 − `level`."""
    from scipy.optimize import brentq

    high = 1.0 + shift
    while _beyond(high, shift, freedom) > 1.0 - level:
        high *= 2.0
    reach: Any = brentq(lambda x: 1.0 - level - _beyond(x, shift, freedom), 0.0, high, xtol=1e-300)
    return float(reach)


def check_level(level: float) -> None:
    """Refuse a level that is not positive, or above `LARGEST_LEVEL`."""
    if not isinstance(level, Real) or not 0.0 < level <= LARGEST_LEVEL:
        raise ArgumentError(f"level is {level!r}; give a number above 0 and at most {LARGEST_LEVEL}")


class Possible(NamedTuple):
    """The smallest and the largest possible return."""

    low: float
    high: float

    def moved_within(self, values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Values with their mean moved to the nearer end if it lies outside."""
        mean = float(values.mean())
        within = min(max(mean, self.low), self.high)
        return values if within == mean else values + (within - mean)


def possible(trajectories: TrajectoryArrays) -> Possible:
    """Range of possible returns, from the observed rewards."""
    return Possible(-_most(-trajectories.reward, trajectories), _most(trajectories.reward, trajectories))


def _most(reward: Float[np.ndarray, "n T"], trajectories: TrajectoryArrays) -> float:
    """M_1; a stage that no trajectory completed contributes nothing."""
    later = 0.0
    for t in reversed(range(reward.shape[1])):
        ends, goes_on = trajectories.is_last[:, t], trajectories.is_completed[:, t] & ~trajectories.is_last[:, t]
        each = [after + reward[rows, t].max() for rows, after in ((ends, 0.0), (goes_on, later)) if rows.any()]
        later = max(each, default=later)
    return float(later)
