"""Silhouettes: what a solid covers of the image, and how far away it is there."""

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError
from skimage.draw import polygon2mask

from halfseen.arrays import Points
from halfseen.perception.plane import Plane
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
    return polygon2mask(shape, corners[:, ::-1])


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


def middle_depth_m(solid: Vessel | Hull, plane: Plane, image: RangeImage) -> Float[np.ndarray, "H W"]:
    """Depth at which each pixel's ray passes the middle of a solid [m].

    It is the plane through the axis that faces the camera most: what is seen before it hides the solid, what is seen
    behind it does not.

    Parameters
    ----------
    solid, plane, image
        The solid, the table that it stands on, and the image.
    """
    middle = plane.camera_points(solid.middle_m[None])[0]
    axis = solid.axis[:2] @ plane.axes() + solid.axis[2] * plane.normal
    facing = middle - (middle @ axis) * axis
    K = image.intrinsics
    rows, columns = np.ogrid[: image.depth_m.shape[0], : image.depth_m.shape[1]]
    closing = facing[0] * (columns - K[0, 2]) / K[0, 0] + facing[1] * (rows - K[1, 2]) / K[1, 1] + facing[2]
    return np.where(closing > 1e-6, (facing @ middle) / np.maximum(closing, 1e-6), np.inf)
