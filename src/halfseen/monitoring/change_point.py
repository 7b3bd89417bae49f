"""Since when: the most likely place of a change of the mean, and the places that are about as likely.

Values are taken for normal, with one mean before and another after the change. With S(τ) the sum of squares around the
two means and n values, each place τ has the likelihood S(τ)^(−n/2); the interval holds the likeliest places that have
95 % of all likelihood together, so it is a credible one under a prior that knows nothing. A reference stands for that
many values before the first.
"""

from typing import NamedTuple

import numpy as np

from halfseen.shapes import Float

LEVEL = 0.95


class ChangePoint(NamedTuple):
    """Where values have changed, counted from 0: the first one of the new kind, and between which it lies."""

    at: int
    low: int
    high: int


def change_point(values: Float[np.ndarray, " n"], mean: float = 0.0, weight: float | int = 0.0) -> ChangePoint:
    """Find where the mean of values has changed; NaN are no values.

    Parameters
    ----------
    values
        In their order.
    mean, weight
        Of a reference: its mean, and how many values it stands for.
    """
    there = np.flatnonzero(~np.isnan(values))
    x = values[there]
    num = len(x)
    if num < 2:
        return ChangePoint(0, 0, max(len(values) - 1, 0))
    before = weight + np.arange(num)
    totals = weight * mean + np.append(0.0, np.cumsum(x)[:-1])
    squares = weight * mean**2 + np.append(0.0, np.cumsum(x * x)[:-1])
    after, rest, rest_squares = num - np.arange(num), x.sum() - (totals - weight * mean), (x @ x) + weight * mean**2
    left = squares - totals**2 / np.maximum(before, 1e-12)
    right = rest_squares - squares - rest**2 / after
    scatter = np.maximum(left + right, 1e-12 * max(rest_squares, 1e-300))
    log_likelihood = -0.5 * (num + min(weight, num)) * np.log(scatter)
    chance = np.exp(log_likelihood - log_likelihood.max())
    order = np.argsort(-chance, kind="stable")
    enough = int(np.searchsorted(np.cumsum(chance[order]) / chance.sum(), LEVEL)) + 1
    held = there[order[:enough]]
    return ChangePoint(int(there[order[0]]), int(held.min()), int(held.max()))
