"""Pixels of a convex polygon."""

import numpy as np
from skimage.measure import points_in_poly

from halfseen.arrays import Rows
from halfseen.shapes import Float, Int

# A row with a pixel this near to a side is asked pixel by pixel, as is one this near to a corner [px].
DOUBTFUL_PX = 1e-6


def convex_pixels(corners_px: Float[np.ndarray, "v 2"], shape: tuple[int, int]) -> Int[np.ndarray, " px"]:
    """Flat indices of the pixels within a convex polygon, rising.

    The same, pixel for pixel, as scikit-image's ``polygon2mask``, which asks all pixels of the box around it; here,
    each row is filled from one side to the other, unless rounding counts.

    Parameters
    ----------
    corners_px
        Corners in order, as (column, row); they may lie outside of the image [px].
    shape
        Rows and columns of the image [px].
    """
    highest, lowest = corners_px[:, 1].min() - DOUBTFUL_PX, corners_px[:, 1].max() + DOUBTFUL_PX
    row = np.arange(*np.clip([np.ceil(highest), np.floor(lowest) + 1], 0, shape[0]).astype(int))
    left_px, right_px = _sides_px(corners_px, row)
    first, last = np.maximum(np.ceil(left_px), 0).astype(int), np.minimum(np.floor(right_px), shape[1] - 1).astype(int)
    is_doubtful = (np.abs(row[:, None] - corners_px[:, 1]) < DOUBTFUL_PX).any(axis=1)
    for side_px in (left_px, right_px):
        is_doubtful |= np.abs(side_px - np.round(side_px)) < DOUBTFUL_PX
    num_px = np.where(is_doubtful, 0, np.maximum(last - first + 1, 0))
    filled = np.repeat(row * shape[1] + first - (num_px.cumsum() - num_px), num_px) + np.arange(num_px.sum())
    if not is_doubtful.any():
        return filled
    asked = (row[is_doubtful][:, None] * shape[1] + np.arange(shape[1])).ravel()
    at_px = np.stack([asked % shape[1], asked // shape[1]], axis=1).astype(float)
    return np.sort(np.concatenate([filled, asked[points_in_poly(at_px, corners_px)]]))


def _sides_px(corners_px: Float[np.ndarray, "v 2"], row: Int[np.ndarray, " rows"]) -> tuple[Rows, Rows]:
    """Columns at which each row enters and leaves the polygon: from its highest corner, sides go down either way."""
    around = np.roll(corners_px, -int(corners_px[:, 1].argmin()), axis=0)
    lowest, column, height = int(around[:, 1].argmax()), *np.concatenate([around, around[:1]]).T
    one = np.interp(row, height[: lowest + 1], column[: lowest + 1])
    other = np.interp(row, height[lowest:][::-1], column[lowest:][::-1])
    return np.minimum(one, other), np.maximum(one, other)
