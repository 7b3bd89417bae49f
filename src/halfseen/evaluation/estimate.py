"""An estimate with its interval, from the contributions of trajectories.

Tails of Student's t and a root finder are implemented here, because loading SciPy takes longer than the rest of a
verdict on some hundred trajectories.

The range of possible returns follows from the rewards in a log. Backwards over stages, with R_t over completed stages,

    M_t = max(max R_t of those with which a trajectory finished, M_{t+1} + max R_t of the others),   M_{T+1} = 0,

and the minimum likewise. The mean return of every policy lies inside, unless it earns rewards that were never observed.
So an estimate outside is moved to the nearer end, and intervals are clipped to the range.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from math import copysign, erfc, exp, lgamma, log, log1p, sqrt
from typing import NamedTuple

import numpy as np

from halfseen.errors import ArgumentError
from halfseen.learning.rows import TrajectoryArrays
from halfseen.shapes import Float

AS_NORMAL = 1e7
"""Degrees of freedom above which t is treated as normal, which changes a tail by 1e-7 of its size for |x| < 1."""
RESOLUTION = 1e-13
"""Relative tolerance of iterations."""
TINY = 1e-300


def upper_tail(x: float, freedom: float) -> float:
    """P(T > x) of a t distribution."""
    if freedom >= AS_NORMAL:
        return 0.5 * erfc(x / sqrt(2.0))
    beyond = 0.5 * _incomplete_beta(freedom, x * x)
    return beyond if x >= 0.0 else 1.0 - beyond


def crossing(function: Callable[[float], float], low: float, high: float) -> float:
    """Root of a function between two points at which its signs differ, by Ridders' method [Ridders1979]_."""
    at_low, at_high, before = function(low), function(high), low
    while True:
        middle = 0.5 * (low + high)
        at_middle = function(middle)
        spread = sqrt(at_middle * at_middle - at_low * at_high)
        if spread == 0.0:
            return middle if at_low * at_high else (low if at_low == 0.0 else high)
        found = middle + (middle - low) * copysign(1.0, at_low - at_high) * at_middle / spread
        value = function(found)
        step = RESOLUTION * max(abs(found), TINY)
        if value == 0.0 or (abs(found - before) <= step and function(found - step) * function(found + step) <= 0.0):
            return found
        ends = sorted([(low, at_low), (middle, at_middle), (found, value), (high, at_high)])
        (low, at_low), (high, at_high) = next(
            (left, right) for left, right in pairwise(ends) if left[1] * right[1] <= 0.0
        )
        before = found


def _incomplete_beta(freedom: float, squared: float) -> float:
    """I_z(ν/2, ½) with z = ν / (ν + x²): P(|T| > x)."""
    a, b = 0.5 * freedom, 0.5
    log_z, log_rest = -log1p(squared / freedom), -log1p(freedom / squared) if squared > 0.0 else -float("inf")
    front = exp(_log_gamma_step(a) - lgamma(b) + a * log_z + b * log_rest)
    if squared * (a + 1.0) > freedom * (b + 1.0):
        return front * _fraction(a, b, exp(log_z)) / a
    return 1.0 - front * _fraction(b, a, exp(log_rest)) / b


def _log_gamma_step(a: float) -> float:
    """Ln Γ(a + ½) − ln Γ(a), for large a by its asymptotic series, without cancellation."""
    if a < 100.0:
        return lgamma(a + 0.5) - lgamma(a)
    return 0.5 * log(a) - 1.0 / (8.0 * a) + 1.0 / (192.0 * a**3) - 1.0 / (640.0 * a**5)


def _fraction(a: float, b: float, z: float) -> float:
    """The continued fraction of I_z(a, b), by the modified Lentz method [Lentz1976]_."""
    d = 1.0 / (1.0 - (a + b) * z / (a + 1.0) or TINY)
    c, fraction, n = 1.0, d, 0
    while True:
        n += 1
        even = n * (b - n) * z / ((a + 2 * n - 1.0) * (a + 2 * n))
        odd = -(a + n) * (a + b + n) * z / ((a + 2 * n) * (a + 2 * n + 1.0))
        for numerator in (even, odd):
            d = 1.0 / (1.0 + numerator * d or TINY)
            c = 1.0 + numerator / c or TINY
            fraction *= c * d
        if abs(c * d - 1.0) <= 1e-15 or n > 10_000:
            return fraction


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
    return upper_tail(x - shift, freedom) + upper_tail(x + shift, freedom)


def _quantile(level: float, shift: float, freedom: float) -> float:
    """The x that |T + shift| exceeds with probability 1 − `level`."""
    high = 1.0 + shift
    while _beyond(high, shift, freedom) > 1.0 - level:
        high *= 2.0
    return crossing(lambda x: 1.0 - level - _beyond(x, shift, freedom), 0.0, high)


def check_level(level: float) -> None:
    """Refuse a level that is not positive, or above `LARGEST_LEVEL`."""
    if not 0.0 < level <= LARGEST_LEVEL:
        raise ArgumentError(f"level is {level}; give a number above 0 and at most {LARGEST_LEVEL}")


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
