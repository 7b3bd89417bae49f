"""Clouds as range images: every stage after this one works on pixels, organised cloud or not."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import KDTree

from halfseen.arrays import Intrinsics, Points, RowIds, Rows
from halfseen.errors import CloudError
from halfseen.perception.clouds import Cloud, Vector
from halfseen.perception.sensor import XTION, DepthSensor
from halfseen.shapes import Bool, Float, Int

# A virtual pixel is this much wider than the median distance between neighbouring rays, so that few stay empty.
VIRTUAL_PIXEL_SCALE = 1.3
# Rays whose neighbour distances are measured for the virtual pixel; the median of so many is stable.
NUM_RAYS_MEASURED = 4000
# Longest side of a virtual image [px]: one stray point far to the side must not make an image of gigabytes.
LARGEST_VIRTUAL_SIDE_PX = 1280
# Largest distance between an organised point and its pixel's ray that still counts as a pinhole image [px].
LARGEST_REPROJECTION_PX = 2.0
# Fewest returns from which a table can be told [points].
FEWEST_RETURNS = 200

PixelPoints = Float[np.ndarray, "H W 3"]
PixelMask = Bool[np.ndarray, "H W"]
# Flat indices of pixels.
Pixels = Int[np.ndarray, " _"]


@dataclass(frozen=True, eq=False)
class RangeImage:
    """Points of a cloud, pixel by pixel.

    Parameters
    ----------
    points_m
        Point of each pixel in the frame of the camera of this image [m]; NaN where nothing returned.
    intrinsics
        Pinhole matrix of that camera [px].
    pixel_of_point
        Flat pixel index of each point of the cloud; −1 for rays without return.
    cloud_from_camera
        Rotation that takes directions of this camera into the frame of the cloud.
    is_virtual
        True if the camera was made up because the cloud is not organised.
    name
        Where the cloud comes from.
    sensor
        What returned it.
    """

    points_m: PixelPoints
    intrinsics: Intrinsics
    pixel_of_point: Int[np.ndarray, " n"]
    cloud_from_camera: Float[np.ndarray, "3 3"]
    is_virtual: bool
    name: str
    sensor: DepthSensor = XTION

    @cached_property
    def depth_m(self) -> Float[np.ndarray, "H W"]:
        """Distance along the optical axis [m]; NaN where nothing returned."""
        return np.ascontiguousarray(self.points_m[..., 2])

    @cached_property
    def is_return(self) -> PixelMask:
        """Pixels at which something returned."""
        return np.isfinite(self.depth_m)


def range_image(cloud: Cloud, sensor: DepthSensor = XTION) -> RangeImage:
    """See a cloud as an image: its own if it is organised, else one of a virtual camera at its eye.

    Parameters
    ----------
    cloud
        What a camera returned.
    sensor
        Which camera.

    Raises
    ------
    CloudError
        There are too few points to tell anything.
    """
    if cloud.num_returns < FEWEST_RETURNS:
        raise CloudError(
            f"{cloud.name}: {cloud.num_returns} of {len(cloud.points_m)} points are finite and a table takes "
            f"{FEWEST_RETURNS}; check the camera's range and exposure"
        )
    if cloud.shape is not None:
        points = _from_eye(cloud)
        K = cloud.intrinsics if cloud.intrinsics is not None else _fitted_intrinsics(points, cloud.shape)
        if K is not None:
            return _organised(cloud, sensor, points, K)
    return _virtual(cloud, sensor)


def _from_eye(cloud: Cloud) -> Points:
    return cloud.points_m - cloud.eye_m if cloud.eye_m.any() else cloud.points_m


def _organised(cloud: Cloud, sensor: DepthSensor, points: Points, K: Intrinsics) -> RangeImage:
    assert cloud.shape is not None
    pixel_of_point = np.where(np.isfinite(points[:, 2]), np.arange(len(points)), -1)
    image = points.reshape(*cloud.shape, 3)
    return RangeImage(image, K, pixel_of_point, np.eye(3), False, cloud.name, sensor)


def _fitted_intrinsics(points: Points, shape: tuple[int, int]) -> Intrinsics | None:
    """Pinhole matrix that explains an organised cloud, or None if none does (another frame, a wide lens)."""
    pixels = np.flatnonzero(np.isfinite(points[:, 2]) & (points[:, 2] > 0))
    if len(pixels) < FEWEST_RETURNS:
        return None
    K = np.eye(3)
    for axis, pixel in ((0, pixels % shape[1]), (1, pixels // shape[1])):
        slope = points[pixels, axis] / points[pixels, 2]
        design = np.stack([slope, np.ones(len(slope))], axis=1)
        (focal, centre), *_ = np.linalg.lstsq(design, pixel.astype(np.float64), rcond=None)
        if focal <= 0 or np.median(np.abs(design @ [focal, centre] - pixel)) > LARGEST_REPROJECTION_PX:
            return None
        K[axis, axis], K[axis, 2] = focal, centre
    return K


def _virtual(cloud: Cloud, sensor: DepthSensor) -> RangeImage:
    """Image of a pinhole camera at the eye of the cloud, with pixels just wide enough to hold a point each."""
    points = _from_eye(cloud)
    cloud_from_camera = _virtual_rotation(points)
    rows = np.flatnonzero(np.isfinite(points[:, 2]))
    seen = points[rows] @ cloud_from_camera
    in_front = seen[:, 2] > 0
    rows, seen = rows[in_front], seen[in_front]
    slope = seen[:, :2] / seen[:, 2:]
    low, high = np.percentile(slope, [0.1, 99.9], axis=0)
    pitch = max(_ray_pitch(slope) * VIRTUAL_PIXEL_SCALE, float((high - low).max()) / LARGEST_VIRTUAL_SIDE_PX)
    if not np.isfinite(pitch):
        raise CloudError(f"{cloud.name}: all points lie on one ray from the camera; check its calibration and its lens")
    low = low - 4 * pitch
    num_columns, num_rows = np.ceil((high + 4 * pitch - low) / pitch).astype(int).tolist()
    pixel = np.floor((slope - low) / pitch).astype(np.int64)
    inside = ((pixel >= 0) & (pixel < [num_columns, num_rows])).all(axis=1)
    rows, seen = rows[inside], seen[inside]
    flat = pixel[inside, 1] * num_columns + pixel[inside, 0]
    image = np.full((num_rows * num_columns, 3), np.nan)
    nearest = _nearest(flat, seen, len(image))
    image[flat[nearest]] = seen[nearest]
    pixel_of_point = np.full(len(points), -1, dtype=np.int64)
    pixel_of_point[rows] = flat
    K = np.array([[1 / pitch, 0, -low[0] / pitch - 0.5], [0, 1 / pitch, -low[1] / pitch - 0.5], [0, 0, 1]])
    shaped = image.reshape(num_rows, num_columns, 3)
    return RangeImage(shaped, K, pixel_of_point, cloud_from_camera, True, cloud.name, sensor)


def _nearest(pixel: Pixels, seen: Points, num_pixels: int) -> Int[np.ndarray, " m"]:
    """Nearest point of each pixel; equal depths are told apart by coordinates, never by the order in the file."""
    left = np.arange(len(pixel))
    for axis in (2, 0, 1):
        at, value = pixel[left], seen[left, axis]
        least = np.full(num_pixels, np.inf)
        np.minimum.at(least, at, value)
        left = left[value == least[at]]
    return left


def _virtual_rotation(points: Points) -> Float[np.ndarray, "3 3"]:
    """Take the camera frame itself if all points lie before it, else a frame that looks at their middle."""
    finite = points[np.isfinite(points[:, 2])]
    if (finite[:, 2] > 0).all():
        return np.eye(3)
    forward = _unit(np.median(finite, axis=0))
    down = np.array([0.0, 0.0, -1.0]) if abs(forward[2]) < 0.9 else np.array([0.0, 1.0, 0.0])
    right = _unit(np.cross(down, forward))
    return np.stack([right, np.cross(forward, right), forward], axis=1)


def _unit(vector: Vector) -> Vector:
    return vector / max(float(np.linalg.norm(vector)), 1e-12)


def _ray_pitch(slope: Float[np.ndarray, "n 2"]) -> float:
    """Median distance from a ray to its nearest neighbour, as tangents."""
    ordered = slope[_order(*np.ascontiguousarray(slope.T))]
    is_new = np.ones(len(ordered), dtype=bool)
    np.any(ordered[1:] != ordered[:-1], axis=1, out=is_new[1:])
    ordered = ordered[is_new]
    asked = ordered[:: max(1, len(ordered) // NUM_RAYS_MEASURED)]
    # The tree is for few questions: built fast, not for speed of answers.
    distance, _ = KDTree(ordered, balanced_tree=False, compact_nodes=False).query(asked, k=2)
    return max(float(np.median(distance[:, 1])), 1e-5)


def _order(first: Rows, second: Rows) -> RowIds:
    """Order by one number, and by another where that is equal, which is rare: one sort is faster than two."""
    order = np.argsort(first)
    ranked = first[order]
    is_tie = np.zeros(len(order), dtype=bool)
    is_tie[1:] = ranked[1:] == ranked[:-1]
    is_tie[:-1] |= is_tie[1:]
    tied = order[is_tie]
    order[is_tie] = tied[np.lexsort((second[tied], first[tied]))]
    return order
