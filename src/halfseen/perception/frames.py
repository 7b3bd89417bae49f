"""The frame of the points in a file with a viewpoint: the camera's own, or that of the viewpoint.

A viewpoint is the pose of the camera. By definition, points are in the frame in which that pose is given, but many
programs store points in the camera's frame with it. The pixel grid of an organised cloud resolves this: from the
camera's position, each point lies on the ray of its pixel. Points without a grid are in the frame in which a camera
could see all of them; if both frames qualify, in the one in which neighbouring rays are equally spaced. If the frame
remains ambiguous, the file is refused, unless a comment states the frame.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import rq
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation as Turn

from halfseen.arrays import Intrinsics, Points
from halfseen.errors import CloudError
from halfseen.perception.clouds import LARGEST_SKEW, Rotation, Vector, returned
from halfseen.shapes import Float, Int

# Largest distance between a point and its pixel's ray that still counts as a pinhole image [px].
LARGEST_REPROJECTION_PX = 2.0
# Fewest returns from which a camera can be estimated [points], and the number used if a sample is enough.
FEWEST_RETURNS, NUM_ASKED = 200, 4000

Pixels = Float[np.ndarray, "n 2"]


class Pinhole(NamedTuple):
    """A camera at the origin of the points."""

    intrinsics: Intrinsics
    """Pinhole matrix [px]."""
    axes: Float[np.ndarray, "3 3"]
    """Its right, down and forward axes as columns; mirrored if the points or the image columns are."""
    misfit_px: float
    """Median distance between a point and its pixel's ray [px]; infinite if this is not a camera."""

    @property
    def is_camera(self) -> bool:
        """Whether the points lie on the rays of their pixels."""
        return self.misfit_px <= LARGEST_REPROJECTION_PX


NO_CAMERA = Pinhole(np.eye(3), np.eye(3), np.inf)


def pixels_of_returns(
    points_m: Points, shape: tuple[int, int], most: int | None = None
) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k 2"]]:
    """Points that returned, and the column and row of each pixel.

    Parameters
    ----------
    points_m
        Points, row by row; NaN where nothing returned [m].
    shape
        Rows and columns of the image [px].
    most
        Approximate largest number, spread over the image; None for all.
    """
    pixels: Int[np.ndarray, " k"] = np.flatnonzero(np.isfinite(points_m[:, 2]))
    pixels = pixels[:: 1 if most is None else max(1, len(pixels) // most)]
    return points_m[pixels], np.stack([pixels % shape[1], pixels // shape[1]], axis=1).astype(np.float64)


def misfit_px(points_m: Points, at_px: Pixels, K: Intrinsics) -> float:
    """Median distance between a point and its pixel's ray [px].

    Parameters
    ----------
    points_m, at_px, K
        Points in the camera's frame [m], their pixels, and the pinhole matrix [px].
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        seen = points_m @ K.T
        apart = np.linalg.norm(seen[:, :2] / seen[:, 2:] - at_px, axis=1)
    return float(np.median(np.where(seen[:, 2] > 0, apart, np.inf))) if len(points_m) else np.inf


def aligned_pinhole(points_m: Points, at_px: Pixels) -> Pinhole:
    """Estimate a camera whose axes are those of the points, up to their signs.

    Parameters
    ----------
    points_m, at_px
        Points relative to the camera's position [m], and their pixels.
    """
    forward = -1.0 if np.count_nonzero(points_m[:, 2] < 0) > 0.5 * len(points_m) else 1.0
    is_before = forward * points_m[:, 2] > 0
    if np.count_nonzero(is_before) < FEWEST_RETURNS:
        return NO_CAMERA
    points_m, at_px, K, signs, misfits = points_m[is_before], at_px[is_before], np.eye(3), [1.0, 1.0, forward], []
    for axis in (0, 1):
        slope = points_m[:, axis] / (forward * points_m[:, 2])
        design = np.stack([slope, np.ones(len(slope))], axis=1)
        (focal, centre), *_ = np.linalg.lstsq(design, at_px[:, axis], rcond=None)
        misfits.append(float(np.median(np.abs(design @ [focal, centre] - at_px[:, axis]))))
        signs[axis] = 1.0 if focal > 0 else -1.0
        K[axis, axis], K[axis, 2] = abs(focal), centre
    return Pinhole(K, np.diag(signs), max(misfits)) if K[[0, 1], [0, 1]].min() >= 1.0 else NO_CAMERA


def turned_pinhole(points_m: Points, at_px: Pixels) -> Pinhole:
    """Estimate a camera with arbitrary axes by the direct linear transformation [HartleyZisserman2004]_, section 4.1.

    Parameters
    ----------
    points_m, at_px
        Points relative to the camera's position [m], and their pixels.
    """
    if len(points_m) < FEWEST_RETURNS:
        return NO_CAMERA
    ray = points_m / np.linalg.norm(points_m, axis=1, keepdims=True)
    middle_px, scale_px = at_px.mean(axis=0), max(float(np.ptp(at_px)), 1.0)
    column, row = ((at_px - middle_px) / scale_px).T[..., None]
    none = np.zeros_like(ray)
    design = np.concatenate([np.hstack([ray, none, -column * ray]), np.hstack([none, ray, -row * ray])])
    image_from_ray = np.linalg.svd(design, full_matrices=False)[2][-1].reshape(3, 3)
    image_from_ray = np.array([[scale_px, 0, middle_px[0]], [0, scale_px, middle_px[1]], [0, 0, 1]]) @ image_from_ray
    image_from_ray *= 1.0 if np.median(ray @ image_from_ray[2]) > 0 else -1.0
    misfit = misfit_px(points_m, at_px, image_from_ray)
    K, axes = rq(image_from_ray)
    signs = np.where(np.diag(K) < 0, -1.0, 1.0)
    K, axes = K * signs, (axes * signs[:, None]).T
    K = K / max(K[2, 2], 1e-12)
    is_none = K[0, 0] < 1.0 or K[1, 1] < 1.0 or abs(K[0, 1]) > LARGEST_SKEW * K[0, 0]
    K[0, 1] = 0.0
    return NO_CAMERA if is_none else Pinhole(K, axes, misfit)


# A viewpoint that moves no point by more than this is the camera frame [m].
LEAST_MOVE_M = 1e-3
# A frame is chosen if the misfit of points to their pixels' rays is less than this share of that in the other frame.
CLEAR_SHARE = 0.5
# Nearly all points of a camera are within this angle of its optical axis.
WIDEST_COSINE, NEARLY_ALL = float(np.cos(np.deg2rad(60.0))), 0.99
# Rays form a pixel grid if at least this share has a nearest neighbour at the median distance, to this tolerance.
GRID_SHARE, GRID_TOLERANCE = 0.5, 0.02
SMALLEST_QUATERNION = 1e-6

CAMERA, VIEWPOINT = "camera", "viewpoint"
FRAME_COMMENT = "points_frame"
"""Header comment for the frame of the points, followed by ``camera`` or ``viewpoint``."""


class Viewpoint(NamedTuple):
    """Pose of a camera in the frame of its points."""

    eye_m: Vector
    """Position of the camera [m]."""
    axes: Rotation
    """Its right, down and forward axes as columns."""

    def seen(self, points_m: Points) -> Points:
        """Transform points into the frame of the camera [m]."""
        return (points_m - self.eye_m) @ self.axes


OWN = Viewpoint(np.zeros(3), np.eye(3))
"""Viewpoint of points in the frame of the camera."""


def viewpoint_of(numbers: list[float], name: str) -> Viewpoint:
    """Pose of a camera from a position and a quaternion.

    Parameters
    ----------
    numbers
        x, y and z [m] and, if the orientation is known, w, x, y and z of a quaternion of any length but 0.
    name
        Where they come from.

    Raises
    ------
    CloudError
        The count of numbers is wrong, one is not finite, or the quaternion is zero.
    """
    place, quaternion = np.array(numbers[:3]), np.array(numbers[3:] or [1.0, 0.0, 0.0, 0.0])
    length = float(np.linalg.norm(quaternion)) if len(numbers) in (3, 7) and np.isfinite(numbers).all() else 0.0
    if length < SMALLEST_QUATERNION:
        raise CloudError(
            f"{name}: VIEWPOINT is {' '.join(f'{number:g}' for number in numbers)!r}; give x, y and z [m] and a "
            "quaternion w, x, y and z that is not all zeros, or leave it out"
        )
    return Viewpoint(place, Turn.from_quat(quaternion, scalar_first=True).as_matrix())


def quaternion_of(axes: Rotation) -> list[float]:
    """Quaternion (w, x, y, z) of a rotation.

    Parameters
    ----------
    axes
        The rotation.
    """
    return Turn.from_matrix(axes).as_quat(canonical=True, scalar_first=True).tolist()


def camera_of(
    points_m: Points, shape: tuple[int, int] | None, viewpoint: Viewpoint, name: str, frame: str | None = None
) -> Viewpoint:
    """Find the pose of the camera in the frame of the points.

    Parameters
    ----------
    points_m, shape
        Points of a file [m], and rows and columns of their grid [px]; None without a grid.
    viewpoint
        Pose of the camera from the file.
    name
        Where they come from.
    frame
        ``camera`` or ``viewpoint`` if the file states the frame of the points; None otherwise.

    Returns
    -------
    Viewpoint
        `OWN` or `viewpoint`.

    Raises
    ------
    CloudError
        The points may be in either frame, cannot be in either, or the comment states an unknown frame.
    """
    if frame is not None:
        if frame not in (CAMERA, VIEWPOINT):
            raise CloudError(f"{name}: the comment {FRAME_COMMENT} says {frame[:40]!r}; give {CAMERA} or {VIEWPOINT}")
        return OWN if frame == CAMERA else viewpoint
    is_return = returned(points_m, viewpoint.eye_m)
    seen = points_m[is_return]
    if not len(seen) or np.abs(viewpoint.seen(seen) - seen).max() < LEAST_MOVE_M:
        return OWN
    found = None if shape is None else _by_grid(np.where(is_return[:, None], points_m, np.nan), shape, viewpoint)
    found = _by_sight(seen, viewpoint) if found is None else found
    if len(found) != 1:
        raise CloudError(
            f"{name}: its points may be in {'either' if found else 'neither'} frame, the camera's own or that of its "
            f"viewpoint; name it in a comment of the header: {FRAME_COMMENT} {CAMERA}, or {FRAME_COMMENT} {VIEWPOINT}"
        )
    return found[0]


def _by_grid(points_m: Points, shape: tuple[int, int], viewpoint: Viewpoint) -> list[Viewpoint] | None:
    """Poses from which points lie on the rays of their pixels; None if from neither."""
    poses, (asked, at_px) = [OWN, viewpoint], pixels_of_returns(points_m, shape, NUM_ASKED)
    for pinhole in (aligned_pinhole, turned_pinhole):
        seen = [pinhole(pose.seen(asked), at_px) for pose in poses]
        better = int(np.argmin([each.misfit_px for each in seen]))
        if seen[better].is_camera:
            is_clear = seen[better].misfit_px < CLEAR_SHARE * seen[1 - better].misfit_px
            return [poses[better]] if is_clear or not viewpoint.eye_m.any() else poses
    return None


def _by_sight(points_m: Points, viewpoint: Viewpoint) -> list[Viewpoint]:
    """Poses from which a camera could see all points; if there are two, the one with a grid of rays."""
    poses = [pose for pose in (OWN, viewpoint) if _is_in_sight(points_m, pose)]
    on_grid = [pose for pose in poses if len(poses) > 1 and _is_grid(pose.seen(points_m))]
    return on_grid if len(on_grid) == 1 else poses


def _is_in_sight(points_m: Points, pose: Viewpoint) -> bool:
    seen = pose.seen(points_m)
    ray = seen / np.linalg.norm(seen, axis=1, keepdims=True)
    cosines = [ray[:, 2]]
    if pose is not OWN and np.array_equal(pose.axes, np.eye(3)):  # The camera's orientation may be unknown.
        middle = ray.mean(axis=0)
        cosines.append(ray @ middle / max(float(np.linalg.norm(middle)), 1e-9))
    return any(np.mean(cosine > WIDEST_COSINE) > NEARLY_ALL for cosine in cosines)


def _is_grid(seen_m: Points) -> bool:
    before = seen_m[seen_m[:, 2] > 0]
    slope = before[:, :2] / before[:, 2:]
    if len(slope) < 2:
        return False
    apart, _ = KDTree(slope, balanced_tree=False).query(slope[:: max(1, len(slope) // NUM_ASKED)], k=2)
    nearest = apart[:, 1]
    median = float(np.median(nearest))
    return bool(np.mean(np.abs(nearest - median) < GRID_TOLERANCE * median) > GRID_SHARE)
