"""Wealth from bets against "nothing has changed", and its anytime-valid p-values.

A test martingale multiplies its wealth by payoffs whose mean is at most 1 while nothing has changed. The probability
that it ever reaches 1/α is at most α (Ville's inequality). So 1 / (largest wealth so far) is an anytime-valid p-value,
and Holm's procedure [Holm1979]_ over several of them errs with probability at most α in a whole lifetime.

A gambler starts to bet at a random time, drawn from a prior of the change point, with one of several strategies. Its
wealth is the mean over times and strategies, so the logarithm of the wealth loses about the negative logarithm of the
prior probability of the change. A lifetime has no end, so the prior has a long tail. Wealth is kept until it is bet.
"""

from bisect import bisect_left
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.special import ndtri

from halfseen.shapes import Float, Int

FROM_FIRST = 0.2
"""Prior probability of a change before the first trajectory."""
SHAPE, SCALE = 0.5, 100.0
"""Prior hazard of a change at trajectory t: SHAPE / (SCALE + t − 1)."""
STAKE = 0.9
"""Largest share of the wealth that a bet may lose."""
POWER, SHIFT = 0.65, 0.5
"""Bets on low ranks: exponent of a beta density, and shift of a normal density [standard deviations]. They were chosen
on other policies than those of `benchmarks/service.py`."""
MOST_PAID = 1e100
"""Largest payoff of a trajectory, so that one of thousands of stages leaves the wealth a number."""
LEAST = 1e-12
"""Smallest p-value, since the densities are unbounded at 0."""

NUM_STATES = 7
LOSSES = np.array([0.0, 0.05, 0.1, 0.2, 0.3, 0.6, 1.0])
"""Fraction of the largest bet in each state, for bets in one direction."""
LEVELS = np.array([0.1, 0.3, 1.0])
"""The same for bets in either direction."""


def log_wealth(payoffs: Float[np.ndarray, "n F S"]) -> Float[np.ndarray, "n F"]:
    """Logarithm of the wealth of F gamblers after each round.

    Parameters
    ----------
    payoffs
        Factor of each gambler's wealth, by round and state; 1 in the first state, which waits.
    """
    num, num_gamblers, num_states = payoffs.shape
    shares = np.full((num_gamblers, num_states), FROM_FIRST / (num_states - 1))
    shares[:, 0] = 1.0 - FROM_FIRST
    totals = np.empty((num, num_gamblers))
    for k, payoff in enumerate(payoffs):
        begins = shares[:, :1] * (SHAPE / (SCALE + k))
        shares[:, :1] -= begins
        shares[:, 1:] += begins / (num_states - 1)
        shares *= payoff
        totals[k] = shares.sum(axis=1)
        shares /= totals[k][:, None]
    return np.cumsum(np.log(totals), axis=0)


def rank_payoffs(p: Float[np.ndarray, "n F"], *, is_less: bool = False) -> Float[np.ndarray, "n F S"]:
    """Payoffs of bets that p-values are small, large, at both ends or in the middle; 1 where a p-value is NaN.

    Parameters
    ----------
    p
        p-values.
    is_less
        Bet on small p-values only.
    """
    there = np.nan_to_num(p, nan=0.5)
    small, ends = _low_densities(there), STAKE * np.cos(2.0 * np.pi * there)
    # Repeat two strategies three times, for as many states as the other gamblers have.
    ways = 3 * small if is_less else [*small, *_low_densities(1.0 - there), 1.0 + ends, 1.0 - ends]
    payoffs = np.stack([np.ones_like(there), *ways], axis=2)
    return np.where(np.isnan(p)[..., None], 1.0, payoffs)


def _low_densities(p: Float[np.ndarray, "n F"]) -> list[Float[np.ndarray, "n F"]]:
    p = np.clip(p, LEAST, 1.0 - LEAST)
    return [POWER * p ** (POWER - 1.0), np.exp(-SHIFT * ndtri(p) - 0.5 * SHIFT**2)]


def mean_payoffs(
    values: Float[np.ndarray, "n F"], highs: Float[np.ndarray, "n F"], means: Float[np.ndarray, " F"]
) -> Float[np.ndarray, "n F S"]:
    """Payoffs of bets that outcomes of at most `highs` have means below `means`; 1 where an outcome is NaN."""
    return 1.0 + _loss_bets(values, highs, means)[..., None] * LOSSES


def residual_payoffs(
    values: Float[np.ndarray, " m"],
    trajectory: Int[np.ndarray, " m"],
    num: int,
    tolerance: Float[np.ndarray, " m"],
    reach: float,
) -> Float[np.ndarray, "n 1 S"]:
    """Payoffs of bets that residuals, clipped to ±`reach`, have a mean below −`tolerance` or above `tolerance`.

    Each residual has its own bet, and the payoffs of a trajectory are multiplied. A mean over a trajectory would not
    have expectation 0, since a trajectory may continue because something failed.

    Parameters
    ----------
    values
        Residuals in order.
    trajectory
        Index of the trajectory of each residual.
    num
        Number of trajectories.
    tolerance
        Tolerance of each residual; known before it is seen.
    reach
        Absolute value at which residuals are clipped.
    """
    clipped, payoffs = np.clip(values, -reach, reach), np.ones((num, NUM_STATES))
    less, more = (_loss_bets(sign * clipped, reach, -tolerance)[:, None] for sign in (1.0, -1.0))
    each = 1.0 + np.concatenate([0.0 * less, less * LEVELS, more * LEVELS], axis=1)
    with np.errstate(over="ignore"):
        np.multiply.at(payoffs, trajectory, each)
    return np.minimum(payoffs, MOST_PAID)[:, None]


def _loss_bets(values: np.ndarray, highs: Any, means: Any) -> np.ndarray:
    """The largest bets, before scaling; gains are capped at the largest loss, which is conservative."""
    bets = STAKE * (means - values) / np.maximum(highs - means, 1e-12)
    return np.nan_to_num(np.maximum(bets, -STAKE))


def rank_p_values(
    bins: Int[np.ndarray, " n"], num_bins: int, counts: Sequence[float] | np.ndarray, draws: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Conformal p-values: the rank of each value among earlier values and a reference, with ties broken at random.

    They are independent and uniform while all values are exchangeable.

    Parameters
    ----------
    bins
        Bin of each value, numbered in increasing order of values; −1 for no value, which gives NaN.
    num_bins
        Number of bins.
    counts
        Reference values in each bin.
    draws
        Uniform on [0, 1).
    """
    there = np.flatnonzero(bins >= 0)
    found, at = np.full(len(bins), np.nan), bins[there]
    before = np.zeros((len(there), num_bins))
    before[np.arange(len(there)), at] = 1.0
    before = np.cumsum(before, axis=0) - before + np.asarray(counts, dtype=np.float64)
    below = np.cumsum(before, axis=1)[np.arange(len(there)), at]
    same = before[np.arange(len(there)), at]
    found[there] = (below - same + draws[there] * (same + 1.0)) / (before.sum(axis=1) + 1.0)
    return found


def p_values(log_wealths: Float[np.ndarray, "n F"]) -> Float[np.ndarray, "n F"]:
    """Anytime-valid p-value of each gambler after each round; it never increases."""
    return np.exp(-np.maximum.accumulate(np.maximum(log_wealths, 0.0), axis=0))


def holm(p: Float[np.ndarray, " F"], alpha: float) -> np.ndarray:
    """Whether Holm's procedure rejects each hypothesis.

    Examples
    --------
    >>> holm(np.array([0.03, 0.001, 0.02]), 0.05).tolist()
    [True, True, True]
    >>> holm(np.array([0.03, 0.001, 0.03]), 0.05).tolist()
    [False, True, False]
    """
    order = np.argsort(p, kind="stable")
    holds = np.logical_and.accumulate(p[order] <= alpha / np.arange(len(p), 0, -1))
    rejected = np.zeros(len(p), dtype=bool)
    rejected[order] = holds
    return rejected


def first_rejected(p: Float[np.ndarray, "n F"], alpha: float, hypothesis: int) -> int:
    """Round (from 0) in which Holm's procedure first rejects a hypothesis that it rejects in the last round.

    Parameters
    ----------
    p
        p-values of all hypotheses after each round; they never increase.
    alpha
        Significance level.
    hypothesis
        Column of the hypothesis.
    """
    return bisect_left(range(len(p)), True, key=lambda at: bool(holm(p[at], alpha)[hypothesis]))
