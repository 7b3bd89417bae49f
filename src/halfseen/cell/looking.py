"""Looks into the running cell: what the depth camera returns, less the robots, whose place is known.

What never moves is seen once. Then only those rays are cast that may meet something that moves, the camera's and the
projector's: those within the boxes around its parts.
"""

# MuJoCo's names come from compiled modules without stubs, which pyright cannot look into.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from jaxtyping import Bool, Float, Int

from halfseen.arrays import Image
from halfseen.cell.live_cell import LiveCell
from halfseen.perception.clouds import Cloud, Picture
from halfseen.scene.camera import Camera
from halfseen.scene.colours import colours
from halfseen.scene.rays import FURNITURE_GROUP, UNSEEN_GROUP
from halfseen.scene.stains import Surface
from halfseen.scene.view import IdealView, ideal_view, refreshed
from halfseen.scene.xtion import XTION, StructuredLight, sense

_CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))
_ROUNDING_PX = 2


@dataclass(frozen=True)
class Look:
    """What was seen, and apart from it what was there.

    Parameters
    ----------
    cloud
        What the camera returns.
    labels
        The truth, for scoring alone: cup of each pixel; −1 where there is none.
    """

    cloud: Cloud
    labels: Int[np.ndarray, "H W"]


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
        return Look(cloud, np.where(is_robot, -1, view.labels))

    def _picture(self, view: IdealView, rng: np.random.Generator) -> Picture | None:
        if self.surfaces is None:
            return None
        poses = [self.cell.cup(index) for index in range(self.cell.num_cups)]
        return colours(view, self.camera, self.surfaces, poses, rng)

    def view(self) -> IdealView:
        """See the cell as it is now, without noise."""
        cell, parts_m = self.cell, self._boxes_m()
        beside_m = np.array([self.sensor.baseline_m, 0.0, 0.0])

        def may_be_dark(depth_m: Image) -> Bool[np.ndarray, "H W"]:
            return self._as_the_projector_sees(self._within(parts_m - beside_m), depth_m)

        is_near = self._within(parts_m)
        return refreshed(self._empty, cell.model, self.camera, self.sensor.baseline_m, cell.data, is_near, may_be_dark)

    @cached_property
    def _empty(self) -> IdealView:
        """The view of what never moves."""
        cell = self.cell
        return ideal_view(cell.model, self.camera, self.sensor.baseline_m, cell.data, (FURNITURE_GROUP,))

    def _boxes_m(self) -> Float[np.ndarray, "parts 8 3"]:
        """Corners of a box around each part that moves and is seen, in the camera's frame [m]."""
        model, data = self.cell.model, self.cell.data
        moves = ~np.isin(model.geom_group, (FURNITURE_GROUP, UNSEEN_GROUP))
        middle_m, half_m = np.split(model.geom_aabb[moves], 2, axis=1)
        corners_m = middle_m[:, None] + half_m[:, None] * _CORNERS
        turned_m = np.einsum("pij,pcj->pci", data.geom_xmat[moves].reshape(-1, 3, 3), corners_m)
        world_m = data.geom_xpos[moves][:, None] + turned_m
        return self.camera.world_from_camera.apply_inverse(world_m.reshape(-1, 3)).reshape(world_m.shape)

    def _within(self, boxes_m: Float[np.ndarray, "parts 8 3"]) -> Bool[np.ndarray, "H W"]:
        """Pixels of a camera at the origin within the outline of some box; all, if one is not in front of it."""
        shape = (self.camera.num_rows, self.camera.num_columns)
        if (boxes_m[..., 2] <= 0).any():
            return np.ones(shape, dtype=bool)
        mask, intrinsics = np.zeros(shape, dtype=bool), self.camera.intrinsics
        pixels = (boxes_m @ intrinsics.T)[..., :2] / boxes_m[..., 2:]
        low = np.maximum(np.floor(pixels.min(axis=1)).astype(int) - _ROUNDING_PX, 0)
        high = np.maximum(np.ceil(pixels.max(axis=1)).astype(int) + _ROUNDING_PX + 1, 0)
        for (left, top), (right, bottom) in zip(low, high, strict=True):
            mask[top:bottom, left:right] = True
        return mask

    def _as_the_projector_sees(self, mask: Bool[np.ndarray, "H W"], depth_m: Image) -> Bool[np.ndarray, "H W"]:
        """Pixels whose points lie, from the projector, within a mask; those beyond its picture count as within."""
        shift_px = self.camera.focal_px[0] * self.sensor.baseline_m / depth_m
        column = np.arange(mask.shape[1]) - np.where(np.isfinite(shift_px), shift_px, 0.0)
        column = np.rint(column).astype(int)
        inside = mask[np.arange(mask.shape[0])[:, None], np.clip(column, 0, mask.shape[1] - 1)]
        return np.isfinite(depth_m) & (inside | (column < 0))
