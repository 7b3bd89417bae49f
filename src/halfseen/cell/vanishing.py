"""Whether an object that no look finds again is hidden, or no longer there."""

import numpy as np

from halfseen.arrays import Points
from halfseen.perception.silhouette import NEAREST_M, projected
from halfseen.perception.view import View

SAME_DEPTH_M = 0.015
"""Depths that differ by less are the same place [m]: they err, and cups stand within millimetres."""
MOSTLY = 0.5
"""More than this share of what was seen of an object must tell that it is not there; and as much must return at all."""


def has_vanished(surface_m: Points, view: View) -> bool:
    """Whether a view sees past where an object was, or sees another object there.

    What stands before that place hides it, and tells nothing; nor does a pixel in which nothing returns.

    Parameters
    ----------
    surface_m
        What was seen of the object, in the frame of the image's camera [m].
    view
        In which it was not found again.
    """
    before, (num_rows, num_columns) = surface_m[surface_m[:, 2] > NEAREST_M], view.image.depth_m.shape
    columns, rows = np.rint(projected(before, view.image)).astype(np.int64).T
    is_inside = (columns >= 0) & (columns < num_columns) & (rows >= 0) & (rows < num_rows)
    at = rows[is_inside], columns[is_inside]
    farther_m = view.image.depth_m[at] - before[is_inside, 2]
    is_past, is_taken = farther_m > SAME_DEPTH_M, (np.abs(farther_m) <= SAME_DEPTH_M) & (view.labels[at] >= 0)
    num_returns = np.count_nonzero(np.isfinite(farther_m))
    is_enough = num_returns > MOSTLY * len(surface_m)
    return bool(is_enough and np.count_nonzero(is_past | is_taken) > MOSTLY * num_returns)
