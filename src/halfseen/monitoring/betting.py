"""Wealth from bets against "nothing has changed", and what it says at any time.

A test martingale multiplies its wealth by payoffs whose mean is at most 1 while nothing has changed; the chance that it
ever reaches 1/α is at most α (Ville's inequality). So 1 / (largest wealth so far) is a p-value at any time, and Holm's
procedure [Holm1979]_ over several of them errs with a chance of α in a whole lifetime.

A gambler bets from a random time on, drawn from a prior of when a change comes, and in one of several ways; the wealth
is the mean over times and ways, so it costs about the logarithm of how unlikely the prior held the change. A lifetime
has no end, so the prior has a long tail. Whatever is not bet yet is kept.

On states taken together a classifier bets, on which of two is the newer one. Each new state is put aside, or, by a
coin, paired with the oldest that is aside: a state of the policy's log at first. While nothing has changed the two are
exchangeable, so 2 σ(θ · (φ(new) − φ(old))) has the mean 1 for any θ known before; θ is learned from the pairs before by
logistic regression [PodkopaevRamdas2023]_. φ are covariates and their products.
"""

from bisect import bisect_left
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.special import ndtri

from halfseen.shapes import Float, Int

FROM_FIRST = 0.2
"""Chance, by the prior, of a change before the first trajectory."""
SHAPE, SCALE = 0.5, 100.0
"""Hazard of a change with trajectory t if there was none: SHAPE / (SCALE + t − 1)."""
STAKE = 0.9
"""Share of the wealth that a bet may lose."""
POWER, SHIFT = 0.65, 0.5
"""Bets that ranks are low: density of a beta distribution, and of normal values that lie so many deviations lower; they
were chosen on other policies than those of `benchmarks/service.py`."""
LEAST = 1e-12
"""Of a p-value, where a density has no bound."""

NUM_STATES = 7
LOSSES = np.array([0.0, 0.05, 0.1, 0.2, 0.3, 0.6, 1.0])
"""Of what a bet may lose, by state, where there is one way to bet."""
LEVELS = np.array([0.1, 0.3, 1.0])
"""The same, where there are two ways."""


def log_wealth(payoffs: Float[np.ndarray, "n F S"]) -> Float[np.ndarray, "n F"]:
    """Logarithm of the wealth of F gamblers after each round.

    Parameters
    ----------
    payoffs
        By round, what each gambler's wealth in each state is multiplied by; 1 in the first state, which waits.
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
    """Bets that p-values are small, large, at both ends or in the middle; none where there is no p-value (NaN).

    Parameters
    ----------
    p
        p-values.
    is_less
        Bet on small ones alone.
    """
    there = np.nan_to_num(p, nan=0.5)
    small, ends = _low_densities(there), STAKE * np.cos(2.0 * np.pi * there)
    # As many states as the others, two ways three times.
    ways = 3 * small if is_less else [*small, *_low_densities(1.0 - there), 1.0 + ends, 1.0 - ends]
    payoffs = np.stack([np.ones_like(there), *ways], axis=2)
    return np.where(np.isnan(p)[..., None], 1.0, payoffs)


def _low_densities(p: Float[np.ndarray, "n F"]) -> list[Float[np.ndarray, "n F"]]:
    p = np.clip(p, LEAST, 1.0 - LEAST)
    return [POWER * p ** (POWER - 1.0), np.exp(-SHIFT * ndtri(p) - 0.5 * SHIFT**2)]


def mean_payoffs(
    values: Float[np.ndarray, "n F"], highs: Float[np.ndarray, "n F"], means: Float[np.ndarray, " F"]
) -> Float[np.ndarray, "n F S"]:
    """Bets that outcomes of at most `highs` have smaller means than these; none where there is no outcome (NaN)."""
    return 1.0 + _loss_bets(values, highs, means)[..., None] * LOSSES


def residual_payoffs(
    values: Float[np.ndarray, " m"],
    trajectory: Int[np.ndarray, " m"],
    num: int,
    tolerance: Float[np.ndarray, " m"],
    reach: float,
) -> Float[np.ndarray, "n 1 S"]:
    """Bets that residuals, clipped to ±`reach`, have a mean below −`tolerance`, or above it.

    There is a bet on each residual, and those of a trajectory are multiplied: a mean over a trajectory, which may go on
    because something failed, would not be 0.

    Parameters
    ----------
    values
        Residuals in their order.
    trajectory
        Place of the trajectory of each.
    num
        Number of trajectories.
    tolerance
        Of each residual; known before it is seen.
    reach
        Where they are clipped.
    """
    clipped, payoffs = np.clip(values, -reach, reach), np.ones((num, NUM_STATES))
    less, more = (_loss_bets(sign * clipped, reach, -tolerance)[:, None] for sign in (1.0, -1.0))
    each = 1.0 + np.concatenate([0.0 * less, less * LEVELS, more * LEVELS], axis=1)
    np.multiply.at(payoffs, trajectory, each)
    return payoffs[:, None]


def _loss_bets(values: np.ndarray, highs: Any, means: Any) -> np.ndarray:
    """The largest bets; what would win more than it may lose wins no more, which costs a little and is safe."""
    bets = STAKE * (means - values) / np.maximum(highs - means, 1e-12)
    return np.nan_to_num(np.maximum(bets, -STAKE))


def rank_p_values(
    bins: Int[np.ndarray, " n"], num_bins: int, counts: Sequence[float] | np.ndarray, draws: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Conformal p-values: the place of each value among those before it and in a reference, ties broken at random.

    Independent and uniform while all are exchangeable.

    Parameters
    ----------
    bins
        Bin of each value, in the order of values; −1 where there is none, which gives NaN.
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
    """p-value of each gambler after each round, which never rises."""
    return np.exp(-np.maximum.accumulate(np.maximum(log_wealths, 0.0), axis=0))


def holm(p: Float[np.ndarray, " F"], alpha: float) -> np.ndarray:
    """Which hypotheses are rejected, by Holm's procedure.

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
    """Round (from 0) in which Holm's procedure first rejects a hypothesis that it rejects in the last.

    Parameters
    ----------
    p
        Of all hypotheses after each round; they never rise.
    alpha
        Level.
    hypothesis
        Which, by column.
    """
    return bisect_left(range(len(p)), True, key=lambda at: bool(holm(p[at], alpha)[hypothesis]))


RIDGE, NEWTON_STEPS = 5.0, 6
FEWEST_PAIRS, MORE = 20, 1.3
LARGEST = 5.0
"""Of standardised covariates."""


def pair_payoffs(
    states: Float[np.ndarray, "n d"], reference: Float[np.ndarray, "k d"], coins: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n 1 S"]:
    """Payoffs after each new state; 1 for one that is put aside.

    Parameters
    ----------
    states
        New states in their order.
    reference
        States of the log.
    coins
        Uniform on [0, 1).
    """
    features = _features(np.concatenate([reference, states]), reference if len(reference) > 1 else states)
    pairs = _pairs(len(states), len(reference), coins)
    news = np.array([len(reference) + i for i, _ in pairs], dtype=int)
    apart = features[news] - features[np.array([old for _, old in pairs], dtype=int)]
    bets = np.zeros(len(states))
    bets[[i for i, _ in pairs]] = _bets(apart)
    return 1.0 + STAKE * bets[:, None, None] * LOSSES


def _pairs(num: int, num_reference: int, coins: Float[np.ndarray, " n"]) -> list[tuple[int, int]]:
    """Which new state is paired with which older one, as rows of reference and new states together."""
    aside, used, pairs = list(range(num_reference)), 0, []
    for i in range(num):
        if coins[i] < 0.5 or used == len(aside):
            aside.append(num_reference + i)
        else:
            pairs.append((i, aside[used]))
            used += 1
    return pairs


def _features(states: np.ndarray, scale_of: np.ndarray) -> Float[np.ndarray, "m P"]:
    spread = scale_of.std(axis=0)
    scaled = np.clip((states - scale_of.mean(axis=0)) / np.where(spread > 0, spread, 1.0), -LARGEST, LARGEST)
    one, other = np.triu_indices(states.shape[1])
    return np.concatenate([scaled, scaled[:, one] * scaled[:, other]], axis=1)


def _bets(apart: Float[np.ndarray, "m P"]) -> Float[np.ndarray, " m"]:
    """2 σ − 1 of each pair, by what was learned from those before."""
    bets, begun, end = np.zeros(len(apart)), 0, FEWEST_PAIRS
    while begun < len(apart):
        if begun >= FEWEST_PAIRS:
            bets[begun:end] = np.tanh(0.5 * apart[begun:end] @ _learned(apart[:begun]))
        begun, end = end, max(int(MORE * end), end + 1)
    return bets


def _learned(apart: Float[np.ndarray, "m P"]) -> Float[np.ndarray, " P"]:
    theta = np.zeros(apart.shape[1])
    for _ in range(NEWTON_STEPS):
        chance = 0.5 * (1.0 - np.tanh(0.5 * apart @ theta))
        slope = apart.T @ chance - RIDGE * theta
        curve = (apart * (chance * (1.0 - chance))[:, None]).T @ apart + RIDGE * np.eye(len(theta))
        theta = theta + np.linalg.solve(curve, slope)
    return theta
