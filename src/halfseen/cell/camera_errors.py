"""The camera is not quite where the robot believes it."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from halfseen.scene.table import TABLE_TOP_M
from halfseen.shapes import Float


@dataclass(frozen=True)
class Errors:
    """How far the robot's idea of where its camera is may err.

    Parameters
    ----------
    position_m
        Standard deviation along each axis [m].
    angle_rad
        Standard deviation about each axis [rad].
    """

    position_m: float = 0.004
    angle_rad: float = float(np.deg2rad(0.5))

    def draw(self, rng: np.random.Generator) -> Float[np.ndarray, "4 4"]:
        """Draw an error: a small motion of the world about the middle of the table."""
        error, pivot_m = np.eye(4), np.array([0.0, 0.0, TABLE_TOP_M])
        error[:3, :3] = Rotation.from_rotvec(rng.normal(0.0, self.angle_rad, 3)).as_matrix()
        error[:3, 3] = pivot_m - error[:3, :3] @ pivot_m + rng.normal(0.0, self.position_m, 3)
        return error
