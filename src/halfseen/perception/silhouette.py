"""Silhouettes: what a solid covers of the image, and how far away it is there."""

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError

from halfseen.arrays import Points
from halfseen.perception.plane import Plane
from halfseen.perception.polygons import convex_mask
from halfseen.perception.range_image import PixelMask, RangeImage
from halfseen.perception.solids import Hull, Vessel

# Points nearer than this to the camera's own plane do not project [m].
NEAREST_M = 0.05


def covered(solid: Vessel | Hull, plane: Plane, image: RangeImage) -> PixelMask:
    """Pixels that a solid would cover if it stood there alone.

    Parameters
    ----------
    solid, plane, image
        The solid, the table that it stands on, and the image to project into.
    """
    shape = image.depth_m.shape
    pixels = projected(plane.camera_points(solid.outline_m()), image)
    if len(pixels) < 3:
        return np.zeros(shape, dtype=bool)
    try:
        corners = pixels[ConvexHull(pixels).vertices]
    except QhullError:
        return np.zeros(shape, dtype=bool)
    return convex_mask(corners, shape)


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


def middle_depth_m(solid: Vessel | Hull, plane: Plane, image: RangeImage, asked: PixelMask) -> Float[np.ndarray, "H W"]:
    """Depth at which each pixel's ray passes the axis of a solid [m]; infinite where not asked.

    What is seen nearer than that hides the solid, what is seen farther does not.

    Parameters
    ----------
    solid, plane, image
        The solid, the table that it stands on, and the image.
    asked
        Pixels to work out.
    """
    rows, columns = np.nonzero(asked)
    K = image.intrinsics
    across, down = (columns - K[0, 2]) / K[0, 0], (rows - K[1, 2]) / K[1, 1]
    ray = np.stack([across, down, np.ones(len(rows))], axis=1)
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    start, end = plane.camera_points(solid.axis_ends_m())
    axis = end - start
    length = max(float(np.linalg.norm(axis)), 1e-9)
    axis = axis / length
    # The point of the axis nearest to a ray through the origin, held between the ends.
    cosine = ray @ axis
    apart = np.maximum(1.0 - cosine**2, 1e-6)
    along = np.clip((cosine * (ray @ start) - start @ axis) / apart, 0.0, length)
    nearest = start + along[:, None] * axis
    depth = np.full(asked.shape, np.inf)
    depth[rows, columns] = (nearest * ray).sum(axis=1) * ray[:, 2]
    return depth
