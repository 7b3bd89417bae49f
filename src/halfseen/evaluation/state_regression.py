"""The mean of a weight among all that are in the same state, E[ω | S], for several weightings of a log at once.

    m(s) = f(s) + Σ_c K_h(s − c) Σ_{i at c} (ω_i − f(S_i)) / Σ_c K_h(s − c) n_c,

a mean over neighbours [Nadaraya1964]_ [Watson1964]_ of what a first guess f leaves. f is 0, or linear by ridge
regression; neighbours are counted at the nearest of few places c, so that a long log costs what its rows do. Among the
two guesses and some widths h, up to one that makes neighbours of all, the one is taken that foretells the weights of
trajectories that were left out best. Weights are no less than 0, and their mean is kept: m is scaled to the sum of ω.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from halfseen.shapes import Bool, Float, Int

WIDTHS = (0.15, 0.3, 0.6, 1.2, np.inf)
"""h, in standard deviations of a covariate, by which states are neighbours."""

MOST_PLACES = 200
"""Where more states differ, so many stand for them."""

RIDGE = 1.0
"""Of the linear guess on standardised covariates: a prior of one row."""


class Neighbours(NamedTuple):
    """Which places states are near."""

    nearest: Int[np.ndarray, " m"]
    """Place of each row."""
    squared: Float[np.ndarray, "m C"]
    """Mean squared difference to each place, over covariates."""


def mean_by_state(
    weight: Float[np.ndarray, "B m"], states: Sequence[Float[np.ndarray, "m _"]], is_fitted: Bool[np.ndarray, "B m"]
) -> Float[np.ndarray, "B m"]:
    """Work out m of every row, for each of B weightings.

    Parameters
    ----------
    weight
        ω of each row.
    states
        Covariates; where there are several sets of them, the one is taken that foretells the weights best.
    is_fitted
        Rows that each weighting is fitted to; by the others the form is chosen.
    """
    scaled = [standardised(some) for some in states]
    each = [found for some in scaled for found in _forms(weight, some, neighbours(some), is_fitted)]
    errors = [float(np.sum(np.where(is_fitted, 0.0, weight - found) ** 2)) for found in each]
    return _with_sums(each[int(np.argmin(errors))], weight, is_fitted)


def standardised(states: Float[np.ndarray, "m F"]) -> Float[np.ndarray, "m G"]:
    """Covariates that differ, with mean 0 and standard deviation 1."""
    spread = states.std(axis=0)
    differs = spread > 1e-9 * np.maximum(1.0, np.abs(states).max(axis=0, initial=0.0))
    return (states[:, differs] - states[:, differs].mean(axis=0)) / spread[differs]


def neighbours(scaled: Float[np.ndarray, "m F"]) -> Neighbours:
    """Find the places that stand for states: all that differ, or as many of them as are allowed, drawn."""
    places = np.unique(scaled, axis=0)
    if len(places) > MOST_PLACES:
        places = places[np.random.default_rng(0).choice(len(places), MOST_PLACES, replace=False)]
    lengths = (scaled**2).sum(axis=1)[:, None] + (places**2).sum(axis=1) - 2.0 * scaled @ places.T
    squared = np.maximum(lengths, 0.0) / max(scaled.shape[1], 1)
    return Neighbours(squared.argmin(axis=1), squared)


def _forms(
    weight: Float[np.ndarray, "B m"],
    scaled: Float[np.ndarray, "m F"],
    near: Neighbours,
    is_fitted: Bool[np.ndarray, "B m"],
) -> Iterator[Float[np.ndarray, "B m"]]:
    """Give m by each guess and width."""
    is_at = np.zeros(near.squared.shape)
    is_at[np.arange(len(is_at)), near.nearest] = 1.0
    counts = is_fitted @ is_at
    for guess in (np.zeros_like(weight), linear(weight, scaled, is_fitted)):
        sums = np.where(is_fitted, weight - guess, 0.0) @ is_at
        mean = sums.sum(axis=1, keepdims=True) / np.maximum(counts.sum(axis=1, keepdims=True), 1.0)
        for width in WIDTHS:
            kernel = np.exp(-near.squared / (2.0 * width**2))
            mass = counts @ kernel.T
            is_near = mass > 1e-9
            local = np.where(is_near, sums @ kernel.T / np.where(is_near, mass, 1.0), mean)
            yield np.maximum(guess + local, 0.0)


def linear(
    weight: Float[np.ndarray, "B m"], scaled: Float[np.ndarray, "m F"], is_fitted: Bool[np.ndarray, "B m"]
) -> Float[np.ndarray, "B m"]:
    """Foretell weights by a linear function of covariates, with a ridge on all but the constant."""
    design = np.column_stack([np.ones(len(scaled)), scaled])
    penalty = np.diag([1e-9, *[RIDGE] * scaled.shape[1]])
    gram = np.einsum("bm,mp,mq->bpq", is_fitted, design, design, optimize=True) + penalty
    cross = np.where(is_fitted, weight, 0.0) @ design
    return np.linalg.solve(gram, cross[..., None])[..., 0] @ design.T


def _with_sums(
    found: Float[np.ndarray, "B m"], weight: Float[np.ndarray, "B m"], is_fitted: Bool[np.ndarray, "B m"]
) -> Float[np.ndarray, "B m"]:
    """The same, with the sum of the weights that it was fitted to."""
    has, wanted = (np.where(is_fitted, each, 0.0).sum(axis=1, keepdims=True) for each in (found, weight))
    return np.where(has > 0, found * wanted / np.where(has > 0, has, 1.0), weight)
