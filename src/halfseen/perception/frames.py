"""Which frame the points of a file are in, where it says a viewpoint: the camera's own, or that of the viewpoint.

A viewpoint is the pose of the camera. By its definition the points are in the frame in which that pose is given; but
many programs store the points of the camera's frame beside it. The pixel grid of an organised cloud tells which: seen
from where the camera stood, each point lies on the ray of its pixel. Points without a grid are in the frame from which
alone a camera could see them all; where it could from both, in that in which neighbouring rays are equally far apart.
Where that leaves a doubt, the file is refused, unless it has a comment that says which.
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation as Turn

from halfseen.arrays import Points
from halfseen.errors import CloudError
from halfseen.perception.clouds import Rotation, Vector, returned
from halfseen.perception.sensor import NUM_ASKED, aligned_pinhole, pixels_of_returns, turned_pinhole

# What moves no point by more is none [m].
LEAST_MOVE_M = 1e-3
# One frame is right if points miss the rays of their pixels there by less than this share of what they do in the other.
CLEAR_SHARE = 0.5
# Nearly all that a camera sees is within this angle of where it looks.
WIDEST_COSINE, NEARLY_ALL = float(np.cos(np.deg2rad(60.0))), 0.99
# Rays of a pixel grid: of so large a share the nearest neighbour is as far as the median, to this share of it.
GRID_SHARE, GRID_TOLERANCE = 0.5, 0.02
SMALLEST_QUATERNION = 1e-6

CAMERA, VIEWPOINT = "camera", "viewpoint"
FRAME_COMMENT = "points_frame"
"""Comment of a header, before ``camera`` or ``viewpoint``: in which frame the points are."""


class Viewpoint(NamedTuple):
    """Pose of a camera in the frame of its points."""

    eye_m: Vector
    """Where it stands [m]."""
    axes: Rotation
    """Its right, down and forward axes as columns."""

    def seen(self, points_m: Points) -> Points:
        """Points in the frame of the camera [m]."""
        return (points_m - self.eye_m) @ self.axes


OWN = Viewpoint(np.zeros(3), np.eye(3))
"""Of points in the frame of the camera."""


def viewpoint_of(numbers: list[float], name: str) -> Viewpoint:
    """Pose of a camera, as a place and a quaternion.

    Parameters
    ----------
    numbers
        x, y and z [m], and, if it is known how the camera is turned, w, x, y and z of a quaternion of any length but 0.
    name
        Where they come from.

    Raises
    ------
    CloudError
        There are others, one is not finite, or the quaternion is of zeros.
    """
    place, quaternion = np.array(numbers[:3]), np.array(numbers[3:] or [1.0, 0.0, 0.0, 0.0])
    length = float(np.linalg.norm(quaternion)) if len(numbers) in (3, 7) and np.isfinite(numbers).all() else 0.0
    if length < SMALLEST_QUATERNION:
        raise CloudError(
            f"{name}: VIEWPOINT is {' '.join(f'{number:g}' for number in numbers)!r}; give x, y and z [m] and a "
            "quaternion w, x, y and z that is not of zeros, or leave it out"
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
        Points of a file [m], and rows and columns of their grid [px]; None without one.
    viewpoint
        Pose of the camera that the file says.
    name
        Where they come from.
    frame
        ``camera`` or ``viewpoint`` where the file says in which frame the points are.

    Returns
    -------
    Viewpoint
        `OWN` or the one that is given.

    Raises
    ------
    CloudError
        They may be in either frame, or can be in neither, or the comment says another.
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
            f"viewpoint; say which by a comment in its header: {FRAME_COMMENT} {CAMERA}, or {FRAME_COMMENT} {VIEWPOINT}"
        )
    return found[0]


def _by_grid(points_m: Points, shape: tuple[int, int], viewpoint: Viewpoint) -> list[Viewpoint] | None:
    """Poses from which points lie on the rays of their pixels; None if they do from neither."""
    poses, (asked, at_px) = [OWN, viewpoint], pixels_of_returns(points_m, shape, NUM_ASKED)
    for pinhole in (aligned_pinhole, turned_pinhole):
        seen = [pinhole(pose.seen(asked), at_px) for pose in poses]
        better = int(np.argmin([each.misfit_px for each in seen]))
        if seen[better].is_camera:
            is_clear = seen[better].misfit_px < CLEAR_SHARE * seen[1 - better].misfit_px
            return [poses[better]] if is_clear or not viewpoint.eye_m.any() else poses
    return None


def _by_sight(points_m: Points, viewpoint: Viewpoint) -> list[Viewpoint]:
    """Poses from which a camera could see all points; of two, that which sees them on a grid of rays."""
    poses = [pose for pose in (OWN, viewpoint) if _is_in_sight(points_m, pose)]
    on_grid = [pose for pose in poses if len(poses) > 1 and _is_grid(pose.seen(points_m))]
    return on_grid if len(on_grid) == 1 else poses


def _is_in_sight(points_m: Points, pose: Viewpoint) -> bool:
    seen = pose.seen(points_m)
    ray = seen / np.linalg.norm(seen, axis=1, keepdims=True)
    cosines = [ray[:, 2]]
    if pose is not OWN and np.array_equal(pose.axes, np.eye(3)):  # It may not be known how the camera is turned.
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
