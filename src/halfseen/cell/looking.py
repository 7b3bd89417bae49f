"""Looks into the running cell: what the depth camera returns, less the robots, whose place is known.

What never moves is seen once. Robots are then added by the rays that may meet them or their shadow, cups facet by
facet.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from halfseen.arrays import Image
from halfseen.cell.live_cell import LiveCell
from halfseen.perception.clouds import Cloud, Picture
from halfseen.scene.camera import Camera
from halfseen.scene.colours import colours
from halfseen.scene.facets import Facets, mesh_facets
from halfseen.scene.moving import Sight, with_facets, with_rays
from halfseen.scene.rays import CUP_GROUP, FURNITURE_GROUP, ROBOT_GROUP
from halfseen.scene.stains import Surface
from halfseen.scene.view import IdealView, ideal_view
from halfseen.scene.xtion import XTION, StructuredLight, sense
from halfseen.shapes import Int


@dataclass(frozen=True)
class Look:
    """What was seen, and apart from it what was there.

    Parameters
    ----------
    cloud
        What the camera returns.
    labels
        The truth, for scoring alone: cup of each pixel; −1 where there is none.
    robots_m
        Distance of robots along the optical axis, whose place is known [m]; infinite where there is none.
    """

    cloud: Cloud
    labels: Int[np.ndarray, "H W"]
    robots_m: Image


class Eye:
    """A depth camera over a cell.

    Parameters
    ----------
    cell
        The running cell.
    camera
        Where it is seen from.
    sensor
        What senses.
    surfaces
        What is on the walls of each cup, for clouds with colour; None for clouds without.
    """

    def __init__(
        self,
        cell: LiveCell,
        camera: Camera,
        sensor: StructuredLight = XTION,
        surfaces: Sequence[Surface] | None = None,
    ) -> None:
        self.cell, self.camera, self.sensor, self.surfaces = cell, camera, sensor, surfaces

    def look(self, rng: np.random.Generator) -> Look:
        """Look at the cell as it is now; `rng` makes the sensor's noise."""
        view = self.view()
        is_robot = view.body > self.cell.num_cups
        depth_m = sense(view, self.camera.focal_px[0], rng, self.sensor)
        picture = self._picture(view, rng)
        cloud = Cloud.from_depth(np.where(is_robot, np.nan, depth_m), self.camera.intrinsics, "look", picture)
        return Look(cloud, np.where(is_robot, -1, view.labels), np.where(is_robot, view.depth_m, np.inf))

    def _picture(self, view: IdealView, rng: np.random.Generator) -> Picture | None:
        if self.surfaces is None:
            return None
        poses = [self.cell.cup(index) for index in range(self.cell.num_cups)]
        return colours(view, self.camera, self.surfaces, poses, rng)

    def view(self) -> IdealView:
        """See the cell as it is now, without noise."""
        sight = Sight(self.cell.model, self.cell.data, self.camera, self.sensor.baseline_m)
        no_cups = with_rays(self._empty, sight, (FURNITURE_GROUP,), (ROBOT_GROUP,))
        return with_facets(no_cups, sight, (FURNITURE_GROUP, ROBOT_GROUP), self._cups, CUP_GROUP)

    @cached_property
    def _empty(self) -> IdealView:
        """The view of what never moves."""
        cell = self.cell
        return ideal_view(cell.model, self.camera, self.sensor.baseline_m, cell.data, (FURNITURE_GROUP,))

    @cached_property
    def _cups(self) -> Facets:
        return mesh_facets(self.cell.model, (CUP_GROUP,))
