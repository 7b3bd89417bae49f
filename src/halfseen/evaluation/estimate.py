"""A number with its interval, from what each path adds to it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy import stats

from halfseen.errors import ArgumentError


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
        Paths of equal weight that would say as much.
    degrees_of_freedom
        Of the t distribution behind the interval.
    """

    value: float
    low: float
    high: float
    standard_error: float
    effective_sample_size: float
    degrees_of_freedom: float = np.inf


def estimate_of(
    influence: Float[np.ndarray, " n"],
    effective_sample_size: float | int,
    level: float,
    without: Float[np.ndarray, " K"] | None = None,
) -> Estimate:
    """Mean of what paths add, with a t interval of as many degrees of freedom as there are effective paths, less one.

    Heavy weights make few paths carry the mean, and the spread is then known no better than from those few. Where the
    values without each group of paths are known, the interval is no narrower than theirs by the jackknife.

    Parameters
    ----------
    influence
        What each path adds; the estimate is the mean.
    effective_sample_size
        Paths of equal weight that would say as much.
    level
        Of the interval.
    without
        The value by all but each of K groups of paths.
    """
    value, error = float(np.mean(influence)), float(np.std(influence, ddof=1) / np.sqrt(len(influence)))
    by_paths = around(value, error, effective_sample_size, effective_sample_size - 1.0, level)
    if without is None:
        return by_paths
    by_groups = around(value, jackknife_error(without), effective_sample_size, len(without) - 1, level)
    return max(by_paths, by_groups, key=lambda one: one.high - one.low)


def jackknife_error(without: Float[np.ndarray, " K"]) -> float:
    """Standard error by the delete-a-group jackknife [Kott2001]_, given the value without each of K groups."""
    num_groups = len(without)
    return float(np.sqrt((num_groups - 1.0) / num_groups * np.sum((without - without.mean()) ** 2)))


def around(
    value: float, standard_error: float, effective_sample_size: float | int, freedom: float | int, level: float
) -> Estimate:
    """A t interval around a value; its standard error has `freedom` degrees of freedom, at least 1."""
    known = max(float(freedom), 1.0)
    reach = float(stats.t.ppf((1.0 + level) / 2.0, known)) * standard_error
    return Estimate(value, value - reach, value + reach, standard_error, float(effective_sample_size), known)


def check_level(level: float) -> None:
    """Refuse a level that is not between 0 and 1."""
    if not 0.0 < level < 1.0:
        raise ArgumentError(f"level is {level}; it lies between 0 and 1")
