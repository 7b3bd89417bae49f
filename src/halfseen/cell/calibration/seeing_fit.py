"""How much of an object must have been in view until it tells: curves from labels that were cut short.

An object tells at some share V of its surface: a stain is found when so much has been in view, or never. What is known
of V is an interval, from what had been seen before the label that said DIRTY to what was seen with it; or that V lies
beyond all that was seen. The curve P(V ≤ v) is a straight line between knots; its steps maximise the likelihood, found
by self-consistency [Turnbull1976]_.
"""

from collections.abc import Iterable

import numpy as np
import pandas as pd

from halfseen.errors import LogError
from halfseen.perception.labels import FACING_SHARE
from halfseen.shapes import Float
from halfseen.world.seeing import SAME_VIEW, PersistentSeeing

VIEWS = (0.25 * FACING_SHARE, 0.5 * FACING_SHARE, 0.75 * FACING_SHARE, FACING_SHARE, 1.0)
"""Shares of the surface at which curves are fitted: quarters of what a look on the table shows, and all."""
_NUM_STEPS, _SMALLEST_CHANGE = 2000, 1e-10

Interval = tuple[float, float]
"""An object told after the first share had been seen, and by the second; infinite where it never did."""


def fit_seeing(glances: pd.DataFrame) -> PersistentSeeing:
    """Fit both curves.

    Parameters
    ----------
    glances
        One row an object, as `trials.glances` gives them.

    Raises
    ------
    LogError
        No object is dirty, or none is clean.
    """
    curves = []
    for is_dirty in (True, False):
        rows = pd.DataFrame(glances[glances["is_dirty"] == is_dirty])
        if rows.empty:
            kind = "dirty" if is_dirty else "clean"
            raise LogError(
                f"objects: none of {len(glances)} is {kind}; labels are calibrated on dirty and on clean ones"
            )
        curves.append(tuple(found_by(intervals(rows)).tolist()))
    return PersistentSeeing(FACING_SHARE, VIEWS, curves[0], curves[1])


def intervals(rows: pd.DataFrame) -> list[Interval]:
    """What each object tells of the share at which it told.

    Parameters
    ----------
    rows
        With `trials.GLANCES`.
    """
    columns = (rows[name] for name in ("glance_occlusions", "glance_held", "glance_dirty"))
    return [_interval(zip(*each, strict=True)) for each in zip(*columns, strict=True)]


def _interval(labels: Iterable[tuple[float, bool, bool]]) -> Interval:
    seen = 0.0
    for occlusion, is_held, says_dirty in labels:
        shown = 1.0 if is_held else FACING_SHARE * (1.0 - occlusion)
        # What shows no more than was seen before is no news: it repeats itself, or errs by noise.
        if shown <= seen + SAME_VIEW:
            continue
        if says_dirty:
            return seen, shown
        seen = shown
    return seen, np.inf


def found_by(told: list[Interval]) -> Float[np.ndarray, " knots"]:
    """P(V ≤ v) at each of `VIEWS`, by maximum likelihood.

    Parameters
    ----------
    told
        One interval an object.
    """
    knots = np.array([0.0, *VIEWS])
    low, high = np.array(told, dtype=np.float64).reshape(-1, 2).T
    # How much of each piece an interval holds; the last column is "never".
    begins, ends = np.maximum(knots[:-1], low[:, None]), np.minimum(knots[1:], high[:, None])
    inside = np.clip(ends - begins, 0.0, None) / np.diff(knots)
    share = np.column_stack([inside, np.isinf(high)])
    share = share[share.sum(axis=1) > 0]
    mass = np.full(share.shape[1], 1.0 / share.shape[1])
    for _ in range(_NUM_STEPS):
        weight = share * mass
        after = (weight / weight.sum(axis=1, keepdims=True)).mean(axis=0)
        is_settled = np.abs(after - mass).max() < _SMALLEST_CHANGE
        mass = after
        if is_settled:
            break
    return np.minimum(np.cumsum(mass[:-1]), 1.0)
