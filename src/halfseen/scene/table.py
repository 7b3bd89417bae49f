"""A table with cups at rest, its camera, and its ground truth: labels, mutual occlusion, positions.

Geometry only, without sensor noise. The camera's frame has x to the right, y down and z forward. The ray of a pixel
(column u, row v) is ((u − cx)/fx, (v − cy)/fy, 1), with pixel centres at integers.
"""

from dataclasses import dataclass

import numpy as np

from halfseen.arrays import Hides, Intrinsics, ObjectMask, PerObject, Points
from halfseen.errors import SceneError
from halfseen.scene.cups import Cup
from halfseen.scene.poses import Pose, from_matrix, rigid
from halfseen.shapes import Bool, Float, Int


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
                f"camera: {self.num_rows} rows by {self.num_columns} columns; an image needs at least 1 by 1"
            )
        if not min(self.focal_px) > 0:
            raise SceneError(f"camera: focal_px is {self.focal_px}; give a positive number")

    @property
    def intrinsics(self) -> Intrinsics:
        """Matrix K that maps points of the camera's frame to homogeneous pixels."""
        (fx, fy), (cx, cy) = self.focal_px, self.centre_px
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    def pixel_rays(self) -> Float[np.ndarray, "H W 3"]:
        """Direction of every pixel in the camera's frame, with z = 1."""
        (fx, fy), (cx, cy) = self.focal_px, self.centre_px
        x = np.broadcast_to((np.arange(self.num_columns) - cx) / fx, (self.num_rows, self.num_columns))
        y = np.broadcast_to(((np.arange(self.num_rows) - cy) / fy)[:, None], (self.num_rows, self.num_columns))
        return np.stack([x, y, np.ones_like(x)], axis=2)

    def project(self, points_m: Points) -> Float[np.ndarray, "n 2"]:
        """Project world points into the picture.

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
                f"camera: a point has depth {seen_m[:, 2].min():.3g} m, behind the lens; turn the camera towards it"
            )
        return seen_m[:, :2] / seen_m[:, 2:] * np.asarray(self.focal_px) + np.asarray(self.centre_px)


def look_at(position_m: Float[np.ndarray, " 3"], target_m: Float[np.ndarray, " 3"]) -> Pose:
    """Pose (``world_from_camera``) of a level camera at one world point that looks at another, z up [m]."""
    forward = (target_m - position_m) / np.linalg.norm(target_m - position_m)
    right = np.cross(forward, np.array([0.0, 0.0, 1.0]))
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
    return from_matrix(rigid(rotation, position_m)).rounded()


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
        The camera.
    name
        Origin of the table, for reports.

    Raises
    ------
    SceneError
        The numbers of cups and poses differ.
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
        """Whether each cup lies on its side: its axis is more than 60° off the vertical."""
        return np.array([pose.rotation[2, 2] < _FALLEN_COSINE for pose in self.world_from_cup], dtype=bool)

    @property
    def is_over_top(self) -> ObjectMask:
        """Whether the middle of each cup is above the table top, at most 0.5 m high."""
        half_m, away_m = 0.5 * np.array(TABLE_SIZE_M), self.centroid_m - (0.0, 0.0, TABLE_TOP_M)
        return (np.abs(away_m[:, :2]) <= half_m).all(axis=1) & (away_m[:, 2] > 0.0) & (away_m[:, 2] < _HIGHEST_M)

    @property
    def height_m(self) -> PerObject:
        """Height of each cup along its own axis, underside to rim, standing or lying [m]."""
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


Depths = Float[np.ndarray, "N H W"]


@dataclass(frozen=True, eq=False)
class Truth:
    """Ground truth of a table with N cups.

    Only cups hide cups: the table top, into which contact lets a cup sink by about 0.01 mm, hides nothing. Parts of a
    silhouette that only the sensor loses (shadow, grazing angles) are not hidden.

    Parameters
    ----------
    labels
        Cup shown by each pixel; −1 for none.
    occlusion
        Hidden share of each cup's silhouette with all cups present, in [0, 1].
    hides
        ``hides[i, j]`` is the share of cup i's silhouette (i alone) that j covers if only i and j are present.
    silhouette_px
        Size of each cup's silhouette alone [px].
    centroid_m
        Middle of each cup's axis in the camera's frame [m].
    is_fallen
        Whether each cup lies on its side.
    height_m
        Height of each cup along its own axis, underside to rim, standing or lying [m].
    """

    labels: Int[np.ndarray, "H W"]
    occlusion: PerObject
    hides: Hides
    silhouette_px: Int[np.ndarray, " N"]
    centroid_m: Points
    is_fallen: ObjectMask
    height_m: PerObject

    @property
    def num_cups(self) -> int:
        """Number of cups on the table."""
        return len(self.occlusion)


def truth_of(table: Table, lone_depths_m: Depths) -> Truth:
    """Compute the truth from the depth image of each cup alone [m]; infinite outside the cup.

    It is exact to the pixel: the nearest cup in a pixel hides the others.
    """
    silhouettes = np.isfinite(lone_depths_m)
    labels = np.where(silhouettes.any(axis=0), lone_depths_m.argmin(axis=0), -1)
    size_px = silhouettes.sum(axis=(1, 2))
    seen_px = np.array([np.sum(labels == index) for index in range(table.num_cups)])
    return Truth(
        labels=labels,
        occlusion=1.0 - seen_px / size_px,
        hides=_hides(lone_depths_m, silhouettes),
        silhouette_px=size_px,
        # Rounded to a nanometre: the last bits depend on the processor.
        centroid_m=np.round(table.camera.world_from_camera.apply_inverse(table.centroid_m), 9),
        is_fallen=table.is_fallen,
        height_m=table.height_m,
    )


def _hides(lone_depths_m: Depths, silhouettes: Bool[np.ndarray, "N H W"]) -> Hides:
    """Share of i's silhouette where j is nearer, for all pairs."""
    num_cups = len(lone_depths_m)
    hides = np.zeros((num_cups, num_cups))
    for i, silhouette in enumerate(silhouettes):
        depths_m = lone_depths_m[:, silhouette]
        # At equal depths labels show the earlier cup.
        is_nearer = depths_m < depths_m[i]
        is_nearer[:i] |= depths_m[:i] == depths_m[i]
        hides[i] = is_nearer.mean(axis=1)
    return hides
