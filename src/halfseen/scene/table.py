"""A table with cups at rest, and the camera that looks at it."""

from dataclasses import dataclass

import numpy as np

from halfseen.arrays import ObjectMask, PerObject, Points
from halfseen.errors import SceneError
from halfseen.scene.camera import Camera
from halfseen.scene.cups import Cup
from halfseen.scene.poses import Pose

TABLE_TOP_M = 0.72
TABLE_SIZE_M = (1.0, 0.7)
_HIGHEST_M = 0.5
_FALLEN_COSINE = 0.5  # an axis more than 60° off the vertical: neither standing nor leaning


@dataclass(frozen=True)
class Table:
    """Cups at rest on a table.

    The world's origin is on the floor under the table's middle, y points away from the camera, z up.

    Parameters
    ----------
    cups
        Dimensions of each cup.
    world_from_cup
        Pose of each cup, in the same order.
    camera
        The camera that looks at the table.
    name
        Where the table comes from, for reports.

    Raises
    ------
    SceneError
        There is not one pose for every cup.
    """

    cups: tuple[Cup, ...]
    world_from_cup: tuple[Pose, ...]
    camera: Camera
    name: str = "table"

    def __post_init__(self) -> None:
        if len(self.cups) != len(self.world_from_cup):
            raise SceneError(
                f"{self.name}: {len(self.cups)} cups and {len(self.world_from_cup)} poses; give one pose for every cup"
            )

    @property
    def num_cups(self) -> int:
        """Number of cups on the table."""
        return len(self.cups)

    @property
    def is_fallen(self) -> ObjectMask:
        """Which cups lie on their side: the axis is more than 60° off the vertical."""
        return np.array([pose.rotation[2, 2] < _FALLEN_COSINE for pose in self.world_from_cup], dtype=bool)

    @property
    def is_over_top(self) -> ObjectMask:
        """Which cups have their middle over the table's top, not higher than things on it may be."""
        half_m, away_m = 0.5 * np.array(TABLE_SIZE_M), self.centroid_m - (0.0, 0.0, TABLE_TOP_M)
        return (np.abs(away_m[:, :2]) <= half_m).all(axis=1) & (away_m[:, 2] > 0.0) & (away_m[:, 2] < _HIGHEST_M)

    @property
    def height_m(self) -> PerObject:
        """Height of each cup as it was made, underside to rim, whether it stands or lies [m]."""
        return np.array([cup.height_m for cup in self.cups])

    @property
    def centroid_m(self) -> Points:
        """Middle of each cup's axis in the world [m]."""
        return np.array(
            [
                pose.apply(np.array([[0.0, 0.0, cup.height_m / 2]]))[0]
                for cup, pose in zip(self.cups, self.world_from_cup, strict=True)
            ]
        ).reshape(-1, 3)
