"""The camera: where it stands and how its pixels look into the world.

Its frame has x to the right, y down and z forward; a pixel (column u, row v) looks along ((u − cx)/fx, (v − cy)/fy, 1),
with pixel centres at whole numbers.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from halfseen.arrays import Intrinsics, Points
from halfseen.errors import SceneError
from halfseen.scene.poses import Pose
from halfseen.shapes import Float


@dataclass(frozen=True)
class Camera:
    """A pinhole camera without distortion.

    Parameters
    ----------
    world_from_camera
        Pose of the camera in the world [m].
    focal_px
        Focal lengths (fx, fy) [px].
    centre_px
        Principal point (cx, cy): column and row [px].
    num_rows, num_columns
        Size of the image [px].

    Raises
    ------
    SceneError
        The image is empty or a focal length is not positive.
    """

    world_from_camera: Pose
    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    num_rows: int
    num_columns: int

    def __post_init__(self) -> None:
        if self.num_rows < 1 or self.num_columns < 1:
            raise SceneError(
                f"camera: {self.num_rows} rows by {self.num_columns} columns; an image has at least 1 by 1"
            )
        if not min(self.focal_px) > 0:
            raise SceneError(f"camera: focal_px is {self.focal_px}; focal lengths are positive")

    @property
    def intrinsics(self) -> Intrinsics:
        """Matrix K that takes a point of the camera's frame to homogeneous pixels."""
        (fx, fy), (cx, cy) = self.focal_px, self.centre_px
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    def pixel_rays(self) -> Float[np.ndarray, "H W 3"]:
        """Direction of every pixel in the camera's frame, with z = 1."""
        (fx, fy), (cx, cy) = self.focal_px, self.centre_px
        x = np.broadcast_to((np.arange(self.num_columns) - cx) / fx, (self.num_rows, self.num_columns))
        y = np.broadcast_to(((np.arange(self.num_rows) - cy) / fy)[:, None], (self.num_rows, self.num_columns))
        return np.stack([x, y, np.ones_like(x)], axis=2)

    def project(self, points_m: Points) -> Float[np.ndarray, "n 2"]:
        """Find where world points appear in the picture.

        Parameters
        ----------
        points_m
            Points in the world [m].

        Returns
        -------
        numpy.ndarray
            Column and row of each point [px]; they may lie outside the picture.

        Raises
        ------
        SceneError
            A point lies behind the camera.
        """
        seen_m = self.world_from_camera.apply_inverse(points_m)
        if np.any(seen_m[:, 2] <= 0):
            raise SceneError(
                f"camera: a point has depth {seen_m[:, 2].min():.3g} m, behind the lens; turn the camera to it"
            )
        return seen_m[:, :2] / seen_m[:, 2:] * np.asarray(self.focal_px) + np.asarray(self.centre_px)


def look_at(position_m: Float[np.ndarray, " 3"], target_m: Float[np.ndarray, " 3"]) -> Pose:
    """Pose of a level camera at one point that looks at another.

    Parameters
    ----------
    position_m, target_m
        Points of the world, z up [m].

    Returns
    -------
    Pose
        ``world_from_camera``.
    """
    forward = (target_m - position_m) / np.linalg.norm(target_m - position_m)
    right = np.cross(forward, np.array([0.0, 0.0, 1.0]))
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
    w, x, y, z = Rotation.from_matrix(rotation).as_quat(canonical=True, scalar_first=True).tolist()
    x_m, y_m, z_m = (float(value) for value in position_m)
    return Pose((x_m, y_m, z_m), (w, x, y, z)).rounded()
