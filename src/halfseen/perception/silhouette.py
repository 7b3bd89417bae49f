"""Silhouettes: what a solid covers of the image, and how far away it is there."""

import numpy as np
from scipy.spatial import ConvexHull, QhullError
from skimage.measure import points_in_poly

from halfseen.arrays import Points, Rows
from halfseen.perception.plane import Plane
from halfseen.perception.range_image import Pixels, RangeImage
from halfseen.perception.solids import Hull, Vessel
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


# Points nearer than this to the camera's own plane do not project [m].
NEAREST_M = 0.05


def covered(solid: Vessel | Hull, plane: Plane, image: RangeImage) -> Pixels:
    """Pixels that a solid would cover if it stood there alone, rising.

    Parameters
    ----------
    solid, plane, image
        The solid, the table that it stands on, and the image to project into.
    """
    outline_px = projected(plane.camera_points(solid.outline_m()), image)
    if len(outline_px) < 3:
        return np.empty(0, dtype=np.int64)
    try:
        corners = outline_px[ConvexHull(outline_px).vertices]
    except QhullError:
        return np.empty(0, dtype=np.int64)
    return convex_pixels(corners, image.depth_m.shape)


def projected(points_m: Points, image: RangeImage) -> Float[np.ndarray, "m 2"]:
    """Pixels (column, row) of points before the camera [px].

    Parameters
    ----------
    points_m
        Points in the camera frame [m].
    image
        Whose camera to use.
    """
    seen = points_m[points_m[:, 2] > NEAREST_M]
    K = image.intrinsics
    return seen[:, :2] / seen[:, 2:] * [K[0, 0], K[1, 1]] + K[:2, 2]


def middle_depth_m(
    solid: Vessel | Hull, plane: Plane, image: RangeImage, asked: Int[np.ndarray, " px"]
) -> Float[np.ndarray, " px"]:
    """Depth at which each pixel's ray passes the axis of a solid [m].

    What is seen nearer than that hides the solid, what is seen farther does not.

    Parameters
    ----------
    solid, plane, image
        The solid, the table that it stands on, and the image.
    asked
        Pixels to work out.
    """
    K, (rows, columns) = image.intrinsics, np.divmod(asked, image.depth_m.shape[1])
    right, down = (columns - K[0, 2]) / K[0, 0], (rows - K[1, 2]) / K[1, 1]
    ahead = 1.0 / np.sqrt(right * right + down * down + 1.0)
    start, end = plane.camera_points(solid.axis_ends_m())
    length = max(float(np.linalg.norm(end - start)), 1e-9)
    axis = (end - start) / length
    # The point of the axis nearest to a ray through the origin, held between the ends.
    cosine, towards = ((right * way[0] + down * way[1] + way[2]) * ahead for way in (axis, start))
    apart = np.maximum(1.0 - cosine * cosine, 1e-6)
    along = np.clip((cosine * towards - start @ axis) / apart, 0.0, length)
    return (towards + along * cosine) * ahead
