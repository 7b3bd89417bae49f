"""The depth camera over the running cell: its cloud, without the robots, whose pose is known, and the objects they cut.

Static geometry is rendered once. Robots are added by the rays that may hit them or their shadow, cups facet by facet.
If an arm or its held object hides part of an object, shape completion would be wrong and a stain behind it would count
as searched for. Such an object is left out of the look, and the memory keeps its earlier state.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.ndimage import minimum_filter
from scipy.spatial.transform import Rotation

from halfseen.arrays import Image, Transform
from halfseen.cell.live_cell import LiveCell
from halfseen.perception.clouds import Cloud, Picture
from halfseen.perception.view import View, perceive
from halfseen.scene.cups import Surface
from halfseen.scene.moving import Facets, mesh_facets, with_facets, with_rays
from halfseen.scene.poses import rigid
from halfseen.scene.rays import CUP_GROUP, FURNITURE_GROUP, ROBOT_GROUP
from halfseen.scene.record import colours
from halfseen.scene.table import TABLE_TOP_M, Camera
from halfseen.scene.view import IdealView, Sight, ideal_view
from halfseen.scene.xtion import XTION, sense
from halfseen.shapes import Bool, Int


@dataclass(frozen=True)
class Look:
    """The camera's cloud and the ground truth behind it.

    `labels` holds the true cup of each pixel, or −1; it is for scoring only. `robots_m` is the depth of the robots
    along the optical axis, whose pose is known [m]; infinite where there is none.
    """

    cloud: Cloud
    labels: Int[np.ndarray, "H W"]
    robots_m: Image


class CellCamera:
    """A depth camera over a cell.

    Parameters
    ----------
    cell
        The running cell.
    camera
        Pose and intrinsics of the camera.
    surfaces
        Stains on the walls of each cup, for clouds with colour; None for clouds without.
    """

    def __init__(self, cell: LiveCell, camera: Camera, surfaces: Sequence[Surface] | None = None) -> None:
        self.cell, self.camera, self.surfaces = cell, camera, surfaces
        self._sight = Sight(cell.data, camera, XTION.baseline_m)

    def look(self, rng: np.random.Generator) -> Look:
        """Look at the current cell; `rng` draws the sensor's noise."""
        view = self.view()
        is_robot = view.body > self.cell.num_cups
        depth_m = sense(view, self.camera.focal_px[0], rng, XTION)
        picture = self._picture(view, rng)
        cloud = Cloud.from_depth(np.where(is_robot, np.nan, depth_m), self.camera.intrinsics, "look", picture)
        return Look(cloud, np.where(is_robot, -1, view.labels), np.where(is_robot, view.depth_m, np.inf))

    def _picture(self, view: IdealView, rng: np.random.Generator) -> Picture | None:
        if self.surfaces is None:
            return None
        poses = [self.cell.cup(index) for index in range(self.cell.num_cups)]
        return colours(view, self.camera, self.surfaces, poses, rng)

    def view(self) -> IdealView:
        """Render the current cell without noise."""
        no_cups = with_rays(self._empty, self._sight, (FURNITURE_GROUP,), (ROBOT_GROUP,))
        return with_facets(no_cups, self._sight, (FURNITURE_GROUP, ROBOT_GROUP), self._cups, CUP_GROUP)

    @cached_property
    def _empty(self) -> IdealView:
        """The view of the static geometry."""
        return ideal_view(self._sight, (FURNITURE_GROUP,))

    @cached_property
    def _cups(self) -> Facets:
        return mesh_facets(self.cell.model, (CUP_GROUP,))


_BESIDE_PX = 3
_BEHIND_M = 0.03  # an arm also cuts surfaces up to this far in front of it, such as those it touches [m]


def perceived_whole(cloud: Cloud, arms_m: Image, is_held: Bool[np.ndarray, " n"]) -> tuple[View, Cloud]:
    """Perceive the objects that no arm or held object partly hides.

    Parameters
    ----------
    arms_m
        Depth of the robots along the optical axis [m]; infinite where there is none.
    is_held
        Mask of the cloud points of held objects. They are not on the table, and they occlude like arms.

    Returns
    -------
    View
        The objects that are not cut.
    Cloud
        The cloud without cut or held objects.
    """
    held_m = np.where(is_held, cloud.points_m[:, 2], np.inf).reshape(arms_m.shape)
    cloud = without(cloud, is_held)
    view = perceive(cloud)
    hiding_m = np.minimum(arms_m, held_m)
    if not np.isfinite(hiding_m).any():
        return view, cloud
    nearest_m = minimum_filter(hiding_m, 2 * _BESIDE_PX + 1)
    is_beside = nearest_m < view.image.depth_m + _BEHIND_M
    cut = [seen.pixels for seen in view.objects if is_beside.ravel()[seen.pixels].any()]
    if not cut:
        return view, cloud
    is_cut: Bool[np.ndarray, " n"] = np.zeros(len(cloud.points_m), dtype=bool)
    is_cut[np.concatenate(cut)] = True
    left = without(cloud, is_cut)
    return perceive(left), left


def without(cloud: Cloud, is_out: Bool[np.ndarray, " n"]) -> Cloud:
    """Remove points from a cloud, as if nothing had returned there."""
    if not is_out.any():
        return cloud
    return replace(cloud, points_m=np.where(is_out[:, None], np.nan, cloud.points_m))


@dataclass(frozen=True)
class PoseErrors:
    """Errors of the camera pose that the robot assumes.

    Parameters
    ----------
    position_m
        Standard deviation along each axis [m].
    angle_rad
        Standard deviation about each axis [rad].
    """

    position_m: float = 0.004
    angle_rad: float = float(np.deg2rad(0.5))

    def draw(self, rng: np.random.Generator) -> Transform:
        """Draw a pose error: a small rigid motion of the world about the middle of the table."""
        pivot_m, turn = np.array([0.0, 0.0, TABLE_TOP_M]), Rotation.from_rotvec(rng.normal(0.0, self.angle_rad, 3))
        rotation = turn.as_matrix()
        return rigid(rotation, pivot_m - rotation @ pivot_m + rng.normal(0.0, self.position_m, 3))
