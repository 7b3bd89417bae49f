"""Silhouettes: what a solid covers of the image, and how far away it is there."""

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from halfseen.arrays import Points
from halfseen.perception.plane import Plane
from halfseen.perception.polygons import convex_pixels
from halfseen.perception.range_image import Pixels, RangeImage
from halfseen.perception.solids import Hull, Vessel
from halfseen.shapes import Float, Int

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
