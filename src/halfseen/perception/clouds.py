"""Depth cameras with their noise, and the point clouds that they return."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol, TypeAlias, runtime_checkable

import numpy as np

from halfseen.arrays import Image, Intrinsics, Points, RowMask
from halfseen.errors import CloudError
from halfseen.shapes import Float, Shaped, UInt8

# Largest median distance and largest distance of points from the camera [m].
LARGEST_MEDIAN_DISTANCE_M, LARGEST_DISTANCE_M = 50.0, 1000.0
# Points that are close to one another from this distance on are in the coordinates of a map [m].
LEAST_OF_MAP_M = 10_000.0
# Depth of a pixel without return in millimetres of 16 bits, and the tolerance of a depth of single precision [m].
SATURATED_M, SAME_DEPTH_M = 65.535, 1e-5
# Red, green and blue of files, as most and as some programs call them.
COLOURS = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"))
# Largest skew of a pinhole camera, as a share of the focal length.
LARGEST_SKEW = 0.02
# Largest entry of a pinhole matrix; images are a few thousand pixels wide [px].
LARGEST_INTRINSIC_PX = 1e6

# Points closer to the eye than this are rays without return, in single precision [m]; also the tolerance of axes.
SAME_PLACE_M = SAME_AXES = 1e-6

# Largest number of points in a file; the largest depth cameras have 5 million pixels. Perceiving as many takes 1 GB.
MOST_POINTS = 6_000_000

Vector: TypeAlias = Float[np.ndarray, "3"]
Rotation: TypeAlias = Float[np.ndarray, "3 3"]
Colours: TypeAlias = UInt8[np.ndarray, "n 3"]
Picture: TypeAlias = UInt8[np.ndarray, "H W 3"]


@runtime_checkable
class DepthSensor(Protocol):
    """The properties of a depth camera that perception needs."""

    def noise_m(self, depth_m: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Return the standard deviation of a depth [m], positive.

        Parameters
        ----------
        depth_m
            Distance along the optical axis [m].
        """
        ...


@dataclass(frozen=True)
class DisparitySensor:
    """A depth camera whose error grows with the square of the distance, as in structured light and stereo.

    Such cameras measure disparity; a constant disparity error causes a depth error proportional to depth².

    Parameters
    ----------
    noise_at_one_metre_m
        Standard deviation of a depth of 1 m [m].
    smallest_noise_m
        Smallest standard deviation of any depth [m].
    """

    noise_at_one_metre_m: float
    smallest_noise_m: float

    def noise_m(self, depth_m: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Return the standard deviation of a depth [m]."""
        return np.maximum(self.smallest_noise_m, self.noise_at_one_metre_m * np.square(depth_m))


@dataclass(frozen=True)
class NoisierSensor:
    """A depth camera that errs more than it is said to, by the same factor at any depth.

    Parameters
    ----------
    sensor, factor
        The camera as it is said to be, and the factor of its noise.
    """

    sensor: DepthSensor
    factor: float

    def noise_m(self, depth_m: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Return the standard deviation of a depth [m]."""
        return self.factor * self.sensor.noise_m(depth_m)


XTION = DisparitySensor(noise_at_one_metre_m=0.003, smallest_noise_m=0.001)
"""The Asus Xtion and similar cameras such as the first Kinect, with coefficients measured by
[KhoshelhamOudeElberink2012]_, rounded up for edges and dark surfaces."""


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points that one depth camera returned.

    Parameters
    ----------
    points_m
        Points in the camera frame (x right, y down, z forward) or in another one [m]. A ray without return is a row of
        NaN: unknown, not empty. Rows that are not finite, or exactly at the origin or the eye, count as no return.
    shape
        Rows and columns of the image [px] when the points are organised row by row, else None.
    intrinsics
        Pinhole matrix [px], or None if not known.
    name
        Where the cloud comes from, for reports.
    eye_m
        Position of the camera in the frame of the points [m]; the origin in a camera frame.
    colours
        Red, green and blue of each point, returned or not; None if the camera sees no colour.
    camera_axes
        Columns are the camera's right, down and forward axes in the frame of the points; the identity by default.

    Raises
    ------
    CloudError
        The axes are not a rotation; shape, colours and number of points disagree; distances cannot be in metres; or the
        pinhole matrix is not finite or has no positive focal lengths.
    """

    points_m: Points
    shape: tuple[int, int] | None = None
    intrinsics: Intrinsics | None = None
    name: str = "cloud"
    eye_m: Vector = field(default_factory=lambda: np.zeros(3))
    colours: Colours | None = None
    camera_axes: Rotation = field(default_factory=lambda: np.eye(3))

    def __post_init__(self) -> None:
        points, eye = (np.array(each, dtype=np.float64) for each in (self.points_m, self.eye_m))
        if self.shape is not None and self.shape[0] * self.shape[1] != len(points):
            raise CloudError(
                f"{self.name}: {len(points)} points do not fill {self.shape[0]} rows of {self.shape[1]}; "
                "fix WIDTH and HEIGHT, or give shape=None"
            )
        if not np.isfinite(eye).all():
            raise CloudError(f"{self.name}: the viewpoint is {eye.tolist()}; it must be finite, in metres")
        points[~returned(points, eye)] = np.nan
        _check_metres(points - eye, self.name)
        axes = np.array(self.camera_axes, dtype=np.float64)
        if not is_rotation(axes, SAME_AXES):
            raise CloudError(
                f"{self.name}: the camera's axes are {axes.tolist()}; they must be the columns of a rotation"
            )
        K = self.intrinsics
        if K is not None:
            check_intrinsics(K, self.name)
            K = np.array(K, dtype=np.float64)
        colours = None if self.colours is None else _checked_colours(self.colours, len(points), self.name)
        own = {"points_m": points, "eye_m": eye, "intrinsics": K, "colours": colours, "camera_axes": axes}
        for name, value in own.items():
            if value is not None:
                value.setflags(write=False)
            object.__setattr__(self, name, value)

    @classmethod
    def from_depth(
        cls, depth_m: Image, K: Intrinsics, name: str = "depth image", picture: Picture | None = None
    ) -> "Cloud":
        """Back-project a depth image through a pinhole camera.

        Parameters
        ----------
        depth_m
            Depth of each pixel along the optical axis [m]; 0, negative, not finite or `SATURATED_M` where nothing
            returned.
        K
            Pinhole matrix [px].
        name
            Where the image comes from.
        picture
            Red, green and blue of each pixel, or None.

        Raises
        ------
        CloudError
            The matrix is not finite or has no positive focal lengths.
        """
        check_intrinsics(K, name)
        num_rows, num_columns = depth_m.shape
        is_return = np.isfinite(depth_m) & (depth_m > 0) & (np.abs(depth_m - SATURATED_M) > SAME_DEPTH_M)
        depth = np.where(is_return, depth_m, np.nan).astype(np.float64)
        row, column = np.mgrid[:num_rows, :num_columns].astype(np.float64)
        x = (column - K[0, 2]) / K[0, 0] * depth
        y = (row - K[1, 2]) / K[1, 1] * depth
        points = np.stack([x, y, depth], axis=-1).reshape(-1, 3)
        colours = None if picture is None else picture.reshape(-1, 3)
        return cls(points, (num_rows, num_columns), np.asarray(K, dtype=np.float64), name, colours=colours)

    @cached_property
    def is_return(self) -> RowMask:
        """Mask of the rays that returned a point."""
        return np.isfinite(self.points_m[:, 2])

    @property
    def num_returns(self) -> int:
        """Number of rays that returned a point."""
        return int(np.count_nonzero(self.is_return))


def is_rotation(axes: Shaped[np.ndarray, "..."], tolerance: float) -> bool:
    """Whether a matrix is that of a rotation."""
    is_square = axes.shape == (3, 3)
    return bool(is_square and np.allclose(axes.T @ axes, np.eye(3), atol=tolerance) and np.linalg.det(axes) > 0)


def returned(points_m: Points, eye_m: Vector) -> RowMask:
    """Mask of the points that returned: those that are finite, and neither at the origin nor at the eye.

    Parameters
    ----------
    points_m, eye_m
        Points, and the position of the camera in their frame [m].
    """
    apart_m = SAME_PLACE_M * max(1.0, float(np.abs(eye_m).max())) if eye_m.any() else 0.0
    with np.errstate(invalid="ignore"):  # signalling NaN
        is_apart = (np.abs(points_m - eye_m) > apart_m).any(axis=1)
    return np.asarray(is_apart & np.isfinite(points_m).all(axis=1) & points_m.any(axis=1))


def _check_metres(from_eye: Points, name: str) -> None:
    """Refuse distances beyond the range of a depth camera [m]."""
    is_return = np.isfinite(from_eye[:, 0])
    if not is_return.any() or np.nanmax(np.abs(from_eye)) <= LARGEST_MEDIAN_DISTANCE_M:
        return
    distance = np.abs(from_eye[is_return]).max(axis=1)
    median, farthest = float(np.median(distance)), float(distance.max())
    if median > LARGEST_MEDIAN_DISTANCE_M:
        is_on_map = median > LEAST_OF_MAP_M and np.ptp(from_eye[is_return], axis=0).max() < median / 10.0
        remedy = (
            "subtract the origin of its map" if is_on_map else "distances are in metres: divide millimetres by 1000"
        )
        raise CloudError(
            f"{name}: half of the points are {median:.4g} m or more from the camera, but a table is within "
            f"{LARGEST_MEDIAN_DISTANCE_M:g} m; {remedy}"
        )
    if farthest > LARGEST_DISTANCE_M:
        raise CloudError(
            f"{name}: a point is {farthest:.4g} m from the camera, but depth cameras see at most "
            f"{LARGEST_DISTANCE_M:g} m; mark missing returns by 0 or NaN"
        )


def check_num_points(num_points: int, name: str) -> None:
    """Refuse more points than a depth camera returns, before memory is allocated for them.

    Parameters
    ----------
    num_points
        Number of points that a file declares or contains.
    name
        Where they come from.

    Raises
    ------
    CloudError
        There are too many.
    """
    if num_points > MOST_POINTS:
        raise CloudError(
            f"{name}: it has {num_points:,} points, but depth cameras return at most {MOST_POINTS:,} at once; thin "
            "it, or cut out the table"
        )


def check_intrinsics(K: Shaped[np.ndarray, "..."], name: str) -> None:
    """Refuse a matrix that is not a pinhole matrix.

    Parameters
    ----------
    K
        Candidate pinhole matrix [px].
    name
        Where it comes from.

    Raises
    ------
    CloudError
        The matrix is not that of a pinhole: 3 by 3 and finite, with positive focal lengths and without skew.
    """
    if K.shape != (3, 3) or K.dtype.kind not in "fiu" or not np.isfinite(K).all():
        raise CloudError(f"{name}: the pinhole matrix K is {K.tolist()}; it must be 3 by 3 and finite, in pixels")
    if K[0, 0] <= 0 or K[1, 1] <= 0:
        raise CloudError(f"{name}: K has focal lengths {K[0, 0]} and {K[1, 1]} px; they must be positive")
    K = K.astype(np.float64)
    beside = np.abs(K[[0, 1, 2, 2, 2], [1, 0, 0, 1, 2]] - [0.0, 0.0, 0.0, 0.0, 1.0])
    if (beside > LARGEST_SKEW * np.array([K[0, 0], 1.0, 1.0, 1.0, 1.0])).any():
        raise CloudError(
            f"{name}: K is {K.tolist()}; its rows must be fx 0 cx, 0 fy cy and 0 0 1: transpose it if columns are, and "
            "rectify an image whose pixels are skewed"
        )
    focal, centre = K[[0, 1], [0, 1]], np.abs(K[[0, 1], [2, 2]])
    if focal.min() < 1.0 or max(focal.max(), centre.max()) > LARGEST_INTRINSIC_PX:
        raise CloudError(
            f"{name}: K has focal lengths {focal.tolist()} and a centre {K[[0, 1], [2, 2]].tolist()}; they are pixels, "
            f"from 1 to {LARGEST_INTRINSIC_PX:g} for a focal length: give the matrix of the camera"
        )


def _checked_colours(colours: Shaped[np.ndarray, "..."], num_points: int, name: str) -> Colours:
    if colours.shape != (num_points, 3) or colours.dtype != np.uint8:
        raise CloudError(
            f"{name}: colours are {colours.dtype} of shape {colours.shape}, beside {num_points} points; give red, "
            "green and blue of each point as uint8, or colours=None"
        )
    return colours.copy()


def colours_of(columns: Sequence[Shaped[np.ndarray, " n"]], name: str) -> Colours:
    """Colours of three columns, red, green and blue, of a file `name`; refuse other than bytes (`CloudError`)."""
    if any(column.dtype != np.uint8 for column in columns):
        raise CloudError(
            f"{name}: red, green and blue are {', '.join(str(column.dtype) for column in columns)}; a colour needs "
            "three uchar from 0 to 255: export it so, or leave it out"
        )
    return np.stack(columns, axis=1)
