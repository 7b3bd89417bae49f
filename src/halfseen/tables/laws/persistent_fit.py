"""The persistent law of seeing, its numbers fitted to labels and to what washing showed, by maximum likelihood.

========  ==========================================================================================================
symbol    here
========  ==========================================================================================================
v         share of an object's surface that was in view
V         the share at which it tells: P(V ≤ v) is sens(v) if it is dirty, fp(v) if it is clean
k         a piece of the surface, between two of the shares at which the curves are given
h_k       P(V is in piece k, if it is in none before)
π         share of dirty objects
========  ==========================================================================================================

A curve is P(V ≤ v) = Σ_k c_k(v)·m_k, with c_k(v) the share of piece k that v covers and m_k = h_k·Π_{j<k} (1 − h_j)
(what is left, Π_k (1 − h_k), is never found). It rises for any h in (0, 1), and each h is the expit of a free number.

A look that shows v' > v finds something with probability (P(V ≤ v') − P(V ≤ v)) / (1 − P(V ≤ v)). The product over the
looks at one object leaves P(v < V ≤ v') if the last one said DIRTY, and 1 − P(V ≤ v) if none did by v: intervals, as
`halfseen.cell.calibration` takes them [Turnbull1976]_. With D and C this probability if it is dirty and if it is clean,
an object adds to the log-likelihood

    log π + log D                   where washing showed that it was dirty,
    log(1 − π) + log C              where washing showed that it was clean,
    log(π·D + (1 − π)·C)            where nothing was shown,

for which see `halfseen.tables.laws.seeing_fit`. What maximises it also pays a weak normal prior (`centre`, `SPREAD`),
which weighs as much as a few objects do: a look in full view finds a stain on half of the dirty objects and something
on a tenth of the clean ones, as likely in one part as in another, and so does lifting of the rest.

How much of its surface an object shows in full view is no parameter. It is what the recorder counted.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize
from scipy.special import expit, log_expit

from halfseen.arrays import RowMask, Rows
from halfseen.tables.laws.labels import Labels
from halfseen.world.seeing import SAME_VIEW, PersistentSeeing

Theta = Float[np.ndarray, "2 pieces"]
"""Logits of h: of dirty objects, and of clean ones."""

QUARTERS = np.array([0.25, 0.5, 0.75, 1.0])
"""Parts of what an object shows in full view at which the curves are given; they are given at 1 too."""

FOUND = np.array([0.5, 0.1])
"""Share of the dirty objects, and of the clean ones, that the prior takes a look in full view to find."""

SPREAD = 1.5
"""Standard deviation of the prior."""


class Intervals(NamedTuple):
    """What is known of the share at which each of n objects tells."""

    covered: Float[np.ndarray, "n pieces+1"]
    """How much of each piece of the surface that share may lie in; the last column is "never"."""
    was_dirty: RowMask
    was_clean: RowMask


def fit_persistent(told: Labels, dirty_share: float) -> PersistentSeeing:
    """Fit both curves; without labels they are the prior's.

    Parameters
    ----------
    told
        The labels, of a recorder who counts what was seen.
    dirty_share
        π, which is known.
    """
    facing = facing_of(told)
    views, known = views_of(facing), intervals_of(told, facing)
    middle = centre(facing)

    def loss(theta: Rows) -> tuple[float, Rows]:
        value, gradient = negative_log_posterior(theta.reshape(middle.shape), known, middle, dirty_share)
        return value, gradient.ravel()

    bounds = [(-12.0, 12.0)] * middle.size
    found = minimize(loss, middle.ravel(), jac=True, method="L-BFGS-B", bounds=bounds)
    curves = np.cumsum(masses(found.x.reshape(middle.shape))[:, :-1], axis=1)
    sensitivity, false_alarms = (tuple(np.minimum(curve, 1.0).tolist()) for curve in curves)
    return PersistentSeeing(facing, tuple(views.tolist()), sensitivity, false_alarms)


def facing_of(told: Labels) -> float:
    """Share of the surface that an object in full view shows, as the recorder counted it; 1 where nothing tells.

    It shows where a look at an object on the table found nothing: what counts as seen is then that share of what was
    not hidden.
    """
    is_plain = ~told.is_held & ~told.says_dirty & (told.seen_after > told.seen + SAME_VIEW) & (told.occlusion < 1.0)
    if not is_plain.any():
        return 1.0
    shares = told.seen_after[is_plain] / (1.0 - told.occlusion[is_plain])
    # As exact as views are told apart: what was recorded has the rounding of its arithmetic.
    return float(np.clip(np.round(np.median(shares), 6), SAME_VIEW, 1.0))


def views_of(facing: float) -> Float[np.ndarray, " pieces"]:
    """Shares of the surface at which the curves are given."""
    return np.unique(np.append(facing * QUARTERS, 1.0))


def centre(facing: float) -> Theta:
    """Mode of the prior."""
    is_on_table = views_of(facing) <= facing
    hazard = np.where(is_on_table, -np.expm1(np.log1p(-FOUND)[:, None] / len(QUARTERS)), FOUND[:, None])
    return np.log(hazard) - np.log1p(-hazard)


def intervals_of(told: Labels, facing: float) -> Intervals:
    """Take the labels of each object together.

    Parameters
    ----------
    told
        The labels.
    facing
        Share of the surface that an object in full view shows.
    """
    _, from_end = np.unique(told.object[::-1], return_index=True)
    last = Labels(*(values[::-1][from_end] for values in told))
    shown = np.where(last.is_held, 1.0, facing * (1.0 - last.occlusion))
    views = views_of(facing)
    seen_by, shown_by = (_covered(share, views) for share in (last.seen, np.maximum(shown, last.seen)))
    inside = np.where(last.says_dirty[:, None], shown_by - seen_by, 1.0 - shown_by)
    covered = np.column_stack([inside, ~last.says_dirty])
    is_possible = covered.any(axis=1)
    return Intervals(covered[is_possible], last.was_dirty[is_possible], last.was_clean[is_possible])


def _covered(share: Rows, views: Float[np.ndarray, " pieces"]) -> Float[np.ndarray, "n pieces"]:
    begins = np.append(0.0, views[:-1])
    return np.clip((share[:, None] - begins) / (views - begins), 0.0, 1.0)


def masses(theta: Theta) -> Float[np.ndarray, "2 pieces+1"]:
    """Probability that V lies in each piece, and that it is in none: of dirty objects, and of clean ones."""
    left = np.cumsum(log_expit(-theta), axis=1)
    before = np.column_stack([np.zeros(len(theta)), left])
    return np.exp(before + np.column_stack([log_expit(theta), np.zeros(len(theta))]))


def negative_log_posterior(theta: Theta, known: Intervals, middle: Theta, dirty_share: float) -> tuple[float, Theta]:
    """What `fit_persistent` minimises, and its gradient."""
    shift = (theta - middle) / SPREAD
    mass = masses(theta)
    share = np.where(
        np.column_stack([known.was_clean, known.was_dirty]), 0.0, np.array([dirty_share, 1.0 - dirty_share])
    )
    likelihood = (share * (known.covered @ mass.T)).sum(axis=1)
    # Objects that are dirty, and clean, and tell in each piece, as many as are to be expected.
    count = mass * ((share / likelihood[:, None]).T @ known.covered)
    later = count.sum(axis=1, keepdims=True) - np.cumsum(count, axis=1)
    hazard = expit(theta)
    gradient = count[:, :-1] * (1.0 - hazard) - later[:, :-1] * hazard
    return float((shift**2).sum() / 2.0 - np.log(likelihood).sum()), shift / SPREAD - gradient
