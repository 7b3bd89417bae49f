"""Rigid poses: position and orientation."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from scipy.spatial.transform import Rotation

from halfseen.arrays import Points, Transform
from halfseen.errors import SceneError
from halfseen.shapes import Float

Quaternion: TypeAlias = tuple[float, float, float, float]
"""Scalar first (w, x, y, z)."""


@dataclass(frozen=True)
class Pose:
    """A rigid transform ``to_from_frame``: `position_m` is the frame's origin, `quaternion` turns the frame's axes.

    Parameters
    ----------
    position_m
        Origin of the frame [m].
    quaternion
        Unit quaternion, scalar first (w, x, y, z).

    Raises
    ------
    SceneError
        A number is not finite, or the quaternion does not have length 1.
    """

    position_m: tuple[float, float, float]
    quaternion: Quaternion = (1.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        numbers = (*self.position_m, *self.quaternion)
        if not np.all(np.isfinite(numbers)):
            raise SceneError(f"pose: {numbers} holds a number that is not finite; a pose has seven finite numbers")
        length = float(np.linalg.norm(self.quaternion))
        if abs(length - 1.0) > 1e-4:
            raise SceneError(
                f"pose: the quaternion {self.quaternion} has length {length:.6g}, not 1; divide it by its length"
            )

    @property
    def rotation(self) -> Float[np.ndarray, "3 3"]:
        """Rotation matrix; its columns are the frame's axes."""
        w, x, y, z = np.asarray(self.quaternion) / np.linalg.norm(self.quaternion)
        return np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )

    @property
    def matrix(self) -> Transform:
        """Matrix of the transform for homogeneous points."""
        return rigid(self.rotation, self.position_m)

    def apply(self, points_m: Points) -> Points:
        """Transform points out of the frame: rotate, then shift [m]."""
        return points_m @ self.rotation.T + np.asarray(self.position_m)

    def apply_inverse(self, points_m: Points) -> Points:
        """Transform points into the frame: shift back, then rotate back [m]."""
        return (points_m - np.asarray(self.position_m)) @ self.rotation

    def rounded(self) -> "Pose":
        """Round the position to a micrometre and the quaternion to 1e-7, so that a file stores the pose exactly."""
        return pose_of((round(float(x), 6) for x in self.position_m), (round(float(x), 7) for x in self.quaternion))


def pose_of(position_m: Iterable[float], quaternion: Iterable[float]) -> Pose:
    """Make a pose of any three numbers [m] and any four (w, x, y, z), such as rows of arrays."""
    x_m, y_m, z_m = map(float, position_m)
    w, x, y, z = map(float, quaternion)
    return Pose((x_m, y_m, z_m), (w, x, y, z))


def rigid(rotation: Float[np.ndarray, "3 3"], position_m: Sequence[float] | Float[np.ndarray, " 3"]) -> Transform:
    """Make the matrix of a rigid transform of homogeneous points: rotate, then shift [m]."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, position_m
    return matrix


def from_matrix(matrix: Transform) -> Pose:
    """Make the pose of a rigid transform of homogeneous points [m]."""
    return pose_of(matrix[:3, 3], Rotation.from_matrix(matrix[:3, :3]).as_quat(canonical=True, scalar_first=True))


def about_axis(axis: tuple[float, float, float], angle_rad: float) -> Quaternion:
    """Make the quaternion (w, x, y, z) of a right-handed rotation by an angle about a unit axis [rad]."""
    half_sine = float(np.sin(angle_rad / 2))
    return (float(np.cos(angle_rad / 2)), axis[0] * half_sine, axis[1] * half_sine, axis[2] * half_sine)


def compose(first: Quaternion, then: Quaternion) -> Quaternion:
    """Make the quaternion (w, x, y, z) of two successive rotations, both about axes of the outer frame."""
    w1, x1, y1, z1 = then
    w2, x2, y2, z2 = first
    return (
        w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
        w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
        w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2,
        w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2,
    )
