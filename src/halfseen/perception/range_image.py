"""Conversion of clouds to range images; all later stages work on pixels, whether or not the cloud is organised."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import KDTree

from halfseen.arrays import Intrinsics, Points
from halfseen.errors import CloudError
from halfseen.perception.clouds import XTION, Cloud, DepthSensor, Vector
from halfseen.perception.frames import (
    FEWEST_RETURNS,
    LARGEST_REPROJECTION_PX,
    NUM_ASKED,
    Pinhole,
    aligned_pinhole,
    misfit_px,
    pixels_of_returns,
    turned_pinhole,
)
from halfseen.shapes import Bool, Float, Int

# A virtual pixel is this much wider than the median distance between neighbouring rays, so that few stay empty.
VIRTUAL_PIXEL_SCALE = 1.3
# Number of rays whose neighbour distances are measured for the virtual pixel; their median is stable.
NUM_RAYS_MEASURED = 4000
# Longest side of a virtual image [px]: a single stray point must not make an image of gigabytes.
LARGEST_VIRTUAL_SIDE_PX = 1280
# Points farther out than these percentiles [%] by more than a share of the image's side are stray.
NEARLY_ALL_PERCENT, STRAY_SHARE = (0.1, 99.9), 0.1
# Of the returns in a row or column, at least this share has another as neighbour. On a grid of rays, .98 have; points
# that were thinned at random or by voxels leave gaps, and pixels are widened by this factor until the gaps close.
# A grid of an organised cloud with fewer neighbours than the last has too many holes for surfaces to hold together.
NEIGHBOUR_SHARE, WIDENING, FEWEST_NEIGHBOURS = 0.95, 1.25, 0.65

PixelPoints = Float[np.ndarray, "H W 3"]
PixelMask = Bool[np.ndarray, "H W"]
# Flat indices of pixels.
Pixels = Int[np.ndarray, " _"]


@dataclass(frozen=True, eq=False)
class RangeImage:
    """Points of a cloud by pixel.

    Parameters
    ----------
    points_m
        Point of each pixel in the frame of this image's camera [m]; NaN where nothing returned.
    intrinsics
        Pinhole matrix of that camera [px].
    pixel_of_point
        Flat pixel index of each point of the cloud; −1 for rays without return.
    cloud_from_camera
        Rotation of directions from this camera to the frame of the cloud; mirrored if the cloud is.
    is_virtual
        True if the camera is virtual because the cloud is not organised.
    name
        Where the cloud comes from.
    sensor
        Depth camera that returned the cloud.
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
    def noise_m(self) -> Float[np.ndarray, "H W"]:
        """Standard deviation of each depth [m]; NaN where nothing returned."""
        return self.sensor.noise_m(self.depth_m)

    @cached_property
    def is_return(self) -> PixelMask:
        """Mask of the pixels with a return."""
        return np.isfinite(self.depth_m)


def range_image(cloud: Cloud, sensor: DepthSensor = XTION) -> RangeImage:
    """Convert a cloud to an image: its own grid if it is organised, otherwise that of a virtual camera at its eye.

    Parameters
    ----------
    cloud
        The cloud.
    sensor
        Depth camera that returned it.

    Raises
    ------
    CloudError
        There are too few points.
    """
    if cloud.num_returns < FEWEST_RETURNS:
        raise CloudError(
            f"{cloud.name}: {cloud.num_returns} of {len(cloud.points_m)} points are finite, but a table needs "
            f"{FEWEST_RETURNS}; check the camera's range and exposure"
        )
    points = _from_eye(cloud)
    organised = None if cloud.shape is None else _organised(cloud, sensor, points)
    return _virtual(cloud, sensor, points) if organised is None else organised


def _from_eye(cloud: Cloud) -> Points:
    """Points in the frame of the camera; unchanged if they already are."""
    points = cloud.points_m - cloud.eye_m if cloud.eye_m.any() else cloud.points_m
    return _turned(points, cloud.camera_axes)


def _turned(points: Points, axes: Float[np.ndarray, "3 3"]) -> Points:
    return points if np.array_equal(axes, np.eye(3)) else points @ axes


def _organised(cloud: Cloud, sensor: DepthSensor, points: Points) -> RangeImage | None:
    """Image on the cloud's own grid; None if that is not of a pinhole camera (a wide lens), or is full of holes."""
    assert cloud.shape is not None
    pinhole = _pinhole(cloud, points)
    if not (pinhole.is_camera and _is_filled(cloud.is_return.reshape(cloud.shape), FEWEST_NEIGHBOURS)):
        return None
    pixel_of_point = np.where(cloud.is_return, np.arange(len(points)), -1)
    image = _turned(points, pinhole.axes).reshape(*cloud.shape, 3)
    axes = cloud.camera_axes @ pinhole.axes
    return RangeImage(image, pinhole.intrinsics, pixel_of_point, axes, False, cloud.name, sensor)


def _pinhole(cloud: Cloud, points: Points) -> Pinhole:
    """Camera of an organised cloud: its intrinsics if they fit, otherwise an estimate."""
    assert cloud.shape is not None
    K, asked = cloud.intrinsics, pixels_of_returns(points, cloud.shape, NUM_ASKED)
    given = None if K is None else Pinhole(K, np.eye(3), 0.0)
    if given is not None and misfit_px(*asked, given.intrinsics) <= LARGEST_REPROJECTION_PX:
        return given
    seen = aligned_pinhole(*pixels_of_returns(points, cloud.shape))
    seen = seen if seen.is_camera else turned_pinhole(*asked)
    return seen if seen.is_camera or given is None else given


def _virtual(cloud: Cloud, sensor: DepthSensor, points: Points) -> RangeImage:
    """Image of a virtual pinhole camera at the eye of the cloud, with pixels just wide enough for one point each."""
    turned = _virtual_rotation(points)
    rows = np.flatnonzero(np.isfinite(points[:, 2]))
    seen = _turned(points[rows], turned)
    in_front = seen[:, 2] > 0
    if not in_front.all():
        rows, seen = rows[in_front], seen[in_front]
    slope = np.ascontiguousarray((seen[:, :2] / seen[:, 2:]).T)
    (flat, inside), shape, K = _pixel_grid(slope, cloud.name)
    seen = np.take(seen, inside, axis=0)
    image = np.full((shape[0] * shape[1], 3), np.nan)
    nearest = _nearest(flat, seen, len(image))
    image[flat[nearest]] = np.take(seen, nearest, axis=0)
    pixel_of_point = np.full(len(points), -1, dtype=np.int64)
    pixel_of_point[rows[inside]] = flat
    axes = cloud.camera_axes @ turned
    return RangeImage(image.reshape(*shape, 3), K, pixel_of_point, axes, True, cloud.name, sensor)


def _pixel_grid(
    slope: Float[np.ndarray, "2 n"], name: str
) -> tuple[tuple[Pixels, Int[np.ndarray, " m"]], tuple[int, int], Intrinsics]:
    """Pixel of each ray in the image and the number of that ray; rows and columns of the image; its pinhole matrix."""
    low, high = np.percentile(slope, NEARLY_ALL_PERCENT, axis=1)
    stray = STRAY_SHARE * (high - low)
    low, high = np.maximum(slope.min(axis=1), low - stray), np.minimum(slope.max(axis=1), high + stray)
    pitch = max(_ray_pitch(slope.T) * VIRTUAL_PIXEL_SCALE, float((high - low).max()) / LARGEST_VIRTUAL_SIDE_PX)
    if not np.isfinite(pitch):
        raise CloudError(f"{name}: all points lie on one ray from the camera; check its calibration and its lens")
    while True:
        first = low - 4 * pitch
        num_columns, num_rows = np.ceil((high + 4 * pitch - first) / pitch).astype(int).tolist()
        column, row = np.floor((slope - first[:, None]) / pitch).astype(np.int64)
        inside = np.flatnonzero((column >= 0) & (column < num_columns) & (row >= 0) & (row < num_rows))
        flat = (row * num_columns + column)[inside]
        is_return = np.zeros((num_rows, num_columns), dtype=bool)
        is_return.ravel()[flat] = True
        if _is_filled(is_return, NEIGHBOUR_SHARE):
            K = np.array([[1 / pitch, 0, -first[0] / pitch - 0.5], [0, 1 / pitch, -first[1] / pitch - 0.5], [0, 0, 1]])
            return (flat, inside), (num_rows, num_columns), K
        pitch *= WIDENING


def _is_filled(is_return: PixelMask, least_share: float) -> bool:
    """Whether this share of the pixels with a return has another as neighbour in its row, and in its column."""
    for image in (is_return, is_return.T):
        num_neighbours = np.count_nonzero(image[:, :-1] & image[:, 1:])
        num_others = np.count_nonzero(image) - np.count_nonzero(image.any(axis=1))
        if num_neighbours < least_share * num_others:
            return False
    return True


def _nearest(pixel: Pixels, seen: Points, num_pixels: int) -> Int[np.ndarray, " m"]:
    """Nearest point of each pixel; ties in depth are broken by coordinates, not by the order in the file."""
    left = np.arange(len(pixel))
    for axis in (2, 0, 1):
        at, value = pixel[left], seen[left, axis]
        least = np.full(num_pixels, np.inf)
        np.minimum.at(least, at, value)
        left = left[value == least[at]]
        if len(left) == np.count_nonzero(least < np.inf):
            break
    return left


def _virtual_rotation(points: Points) -> Float[np.ndarray, "3 3"]:
    """Axes of the virtual camera: the camera frame if all points are in front of it, else axes towards their middle.

    Then z is up or, if the points lie along −z as in OpenGL, y is.
    """
    is_return = np.isfinite(points[:, 2])
    if (points[is_return, 2] > 0).all():
        return np.eye(3)
    forward = _unit(np.median(points[is_return], axis=0))
    down = np.array([0.0, 0.0, -1.0] if abs(forward[2]) < 0.9 else [0.0, np.sign(forward[2]), 0.0])
    right = _unit(np.cross(down, forward))
    return np.stack([right, np.cross(forward, right), forward], axis=1)


def _unit(vector: Vector) -> Vector:
    return vector / max(float(np.linalg.norm(vector)), 1e-12)


def _ray_pitch(slope: Float[np.ndarray, "n 2"]) -> float:
    """Median distance from a ray to its nearest neighbour, as tangents."""
    # As complex numbers, rays sort by the first tangent, then by the second.
    ordered = np.sort(np.ascontiguousarray(slope).view(np.complex128).ravel())
    ordered = ordered[np.append(True, ordered[1:] != ordered[:-1])]
    rays = ordered.view(np.float64).reshape(-1, 2)
    asked = rays[:: max(1, len(rays) // NUM_RAYS_MEASURED)]
    # Few queries follow, so the tree is built for fast construction.
    distance, _ = KDTree(rays, leafsize=64, balanced_tree=False, compact_nodes=False).query(asked, k=2)
    return max(float(np.median(distance[:, 1])), 1e-5)
