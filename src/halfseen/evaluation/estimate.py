"""A number with its interval, from what each trajectory adds to it."""

from dataclasses import dataclass, replace

import numpy as np

from halfseen.errors import ArgumentError
from halfseen.evaluation.student_t import crossing, upper_tail
from halfseen.shapes import Float

LARGEST_LEVEL = 0.999999
"""Beyond it an interval speaks of tails that no log shows, and 1 − level of rounding."""


@dataclass(frozen=True)
class Estimate:
    """A value and how well it is known.

    Parameters
    ----------
    value
        The estimate, in units of the reward.
    low, high
        Ends of the interval at the level that was asked for.
    standard_error
        Of `value`.
    effective_sample_size
        Trajectories of equal weight that would say as much.
    degrees_of_freedom
        Of the t distribution behind the interval.
    bias
        Bias either way that the interval allows for.
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
        """Of the truth being 0, two-sided, whatever the bias; by the same distribution as the interval.

        1 for an estimate of 0 that nothing can change.
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
    """Mean of what trajectories add, with a t interval of as many degrees of freedom as effective ones, less one.

    Heavy weights make few trajectories carry the mean, and the spread is then known no better than from those few.
    Where the values without each group of trajectories are known, the interval is no narrower than theirs by the
    jackknife.

    Parameters
    ----------
    influence
        What each trajectory adds; the estimate is the mean.
    effective_sample_size
        Trajectories of equal weight that would say as much.
    level
        Of the interval.
    without
        The value by all but each of K groups of trajectories.
    bias
        To be allowed for, either way.
    least_error
        That the standard error is known to be no less than.
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
    """A t interval around a value; its standard error has `freedom` degrees of freedom, at least 1.

    With a bias β of either sign it is the shortest symmetric one that holds the truth as often as `level` says
    [ArmstrongKolesar2018]_.
    """
    known = max(float(freedom), 1.0)
    shift = bias / standard_error if standard_error > 0.0 else np.inf
    reach = bias if np.isinf(shift) else _quantile(level, shift, known) * standard_error
    return Estimate(value, value - reach, value + reach, standard_error, float(effective_sample_size), known, bias)


def within(estimate: Estimate, low: float, high: float) -> Estimate:
    """The same, with an interval that ends where the value is known to."""
    return replace(estimate, low=max(estimate.low, low), high=min(estimate.high, high))


def _beyond(x: float, shift: float, freedom: float) -> float:
    """P(|T + shift| > x)."""
    return upper_tail(x - shift, freedom) + upper_tail(x + shift, freedom)


def _quantile(level: float, shift: float, freedom: float) -> float:
    """The x that |T + shift| does not exceed with probability `level`."""
    high = 1.0 + shift
    while _beyond(high, shift, freedom) > 1.0 - level:
        high *= 2.0
    return crossing(lambda x: 1.0 - level - _beyond(x, shift, freedom), 0.0, high)


def check_level(level: float) -> None:
    """Refuse a level that is not above 0, or above `LARGEST_LEVEL`."""
    if not 0.0 < level <= LARGEST_LEVEL:
        raise ArgumentError(f"level is {level}; it lies between 0 and 1, and is {LARGEST_LEVEL} at most")
