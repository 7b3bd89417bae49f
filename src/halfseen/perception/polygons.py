"""Pixels of a convex polygon."""

import numpy as np
from skimage.measure import points_in_poly

from halfseen.shapes import Float, Int

# Pixels this far inside or outside of where a row crosses the polygon need no closer look [px].
SURE_PX = 1.0
# A row this near to a corner may run along a side, and is looked at whole [px].
LEVEL_PX = 1e-6


def convex_pixels(corners_px: Float[np.ndarray, "v 2"], shape: tuple[int, int]) -> Int[np.ndarray, " px"]:
    """Flat indices of the pixels within a convex polygon, rising.

    The same, pixel for pixel, as scikit-image's ``polygon2mask``, which asks all pixels of the box around it; here,
    those at the border alone are asked.

    Parameters
    ----------
    corners_px
        Corners in order, as (column, row); they may lie outside of the image [px].
    shape
        Rows and columns of the image [px].
    """
    last_px = np.array([shape[1], shape[0]]) - 1
    low = np.clip(np.floor(corners_px.min(axis=0)), 0, last_px + 1).astype(int)
    high = np.clip(np.ceil(corners_px.max(axis=0)), -1, last_px).astype(int)
    column, row = (np.arange(first, last + 1) for first, last in zip(low, high, strict=True))
    left_px, right_px = _crossings_px(corners_px, row)
    is_level = (np.abs(row[:, None] - corners_px[:, 1]) < LEVEL_PX).any(axis=1)[:, None]
    is_sure = ~is_level & (column > left_px + SURE_PX) & (column < right_px - SURE_PX)
    is_asked = is_level | ((column > left_px - SURE_PX) & (column < right_px + SURE_PX) & ~is_sure)
    rows, columns = np.nonzero(is_asked)
    is_sure[rows, columns] = points_in_poly(np.column_stack([column[columns], row[rows]]).astype(float), corners_px)
    rows, columns = np.nonzero(is_sure)
    return row[rows] * shape[1] + column[columns]


def _crossings_px(
    corners_px: Float[np.ndarray, "v 2"], row: Int[np.ndarray, " rows"]
) -> tuple[Float[np.ndarray, "rows 1"], Float[np.ndarray, "rows 1"]]:
    """First and last column at which each row crosses the border; none, from infinity on."""
    column, height = corners_px.T
    across, down = (np.roll(corners_px, -1, axis=0) - corners_px).T
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (row[:, None] - height) / down
        is_crossed = (share >= 0) & (share <= 1)
        at = column + share * across
    left = np.where(is_crossed, at, np.inf).min(axis=1, keepdims=True)
    return left, np.where(is_crossed, at, -np.inf).max(axis=1, keepdims=True)
