"""Overlay of moving geoms on a view of static ones: by rays within windows, or facet by facet."""

# MuJoCo's names come from compiled modules without stubs, which pyright cannot look into.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import mujoco
import numpy as np

from halfseen.arrays import Image
from halfseen.scene.poses import Pose
from halfseen.scene.rays import RowRays, first_met
from halfseen.scene.table import Camera
from halfseen.scene.view import LIT_TOLERANCE_M, IdealView, Sight, is_reached, mesh_of, pixel_hits
from halfseen.shapes import Bool, Float, Int


@dataclass(frozen=True)
class Facets:
    """Facets of meshes, each in the frame of its geom.

    Parameters
    ----------
    corners_m
        Counterclockwise as seen from outside [m].
    geom, body
        Geom and body of each facet.
    """

    corners_m: Float[np.ndarray, "facets 3 3"]
    geom: Int[np.ndarray, " facets"]
    body: Int[np.ndarray, " facets"]

    def seen_from(self, data: mujoco.MjData, world_from_camera: Pose) -> Float[np.ndarray, "facets 3 3"]:
        """Corners at the current poses of the bodies, in a camera's frame [m]."""
        turns = data.geom_xmat.reshape(-1, 3, 3)[self.geom]
        world_m = np.einsum("fij,fcj->fci", turns, self.corners_m) + data.geom_xpos[self.geom, None]
        return world_from_camera.apply_inverse(world_m.reshape(-1, 3)).reshape(world_m.shape)


def mesh_facets(model: mujoco.MjModel, groups: Sequence[int]) -> Facets:
    """List the facets of all mesh geoms of some groups; other geoms are skipped."""
    geoms = np.flatnonzero((model.geom_type == mujoco.mjtGeom.mjGEOM_MESH) & np.isin(model.geom_group, groups))
    corners_m = [_corners_m(model, int(model.geom_dataid[geom])) for geom in geoms]
    geom = np.repeat(geoms, [len(each) for each in corners_m])
    return Facets(np.concatenate([np.zeros((0, 3, 3)), *corners_m]), geom, model.geom_bodyid[geom].astype(np.int64))


def _corners_m(model: mujoco.MjModel, mesh: int) -> Float[np.ndarray, "facets 3 3"]:
    vertices, faces = mesh_of(model, mesh)
    return vertices[faces].astype(np.float64)


def normals(corners_m: Float[np.ndarray, "facets 3 3"]) -> Float[np.ndarray, "facets 3"]:
    """Outward unit normals of facets; corners are counterclockwise as seen from outside [m]."""
    first, second, third = np.moveaxis(corners_m, 1, 0)
    across = np.cross(second - first, third - first)
    return across / np.linalg.norm(across, axis=1, keepdims=True)


Boxes = Float[np.ndarray, "parts 8 3"]
Mask = Bool[np.ndarray, "H W"]

_CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))
_ROUNDING_PX = 2


def shown_within(boxes_m: Boxes, camera: Camera) -> Mask:
    """Pixels that may show the content of a box; all pixels, if a box is not entirely in front of the camera.

    Boxes are in the camera's frame [m].
    """
    shape = (camera.num_rows, camera.num_columns)
    if (boxes_m[..., 2] <= 0).any():
        return np.ones(shape, dtype=bool)
    mask = np.zeros(shape, dtype=bool)
    pixels = (boxes_m @ camera.intrinsics.T)[..., :2] / boxes_m[..., 2:]
    low = np.maximum(np.floor(pixels.min(axis=1)).astype(int) - _ROUNDING_PX, 0)
    high = np.maximum(np.ceil(pixels.max(axis=1)).astype(int) + _ROUNDING_PX + 1, 0)
    for (left, top), (right, bottom) in zip(low, high, strict=True):
        mask[top:bottom, left:right] = True
    return mask


def shaded_within(boxes_m: Boxes, camera: Camera, baseline_m: float, depth_m: Image) -> Mask:
    """Pixels that the content of a box may shade from the projector.

    Boxes are in the camera's frame; the projector is `baseline_m` to the camera's right [m].
    """
    mask = shown_within(boxes_m - [baseline_m, 0.0, 0.0], camera)
    column = projector_columns_px(camera, baseline_m, depth_m)
    is_point = np.isfinite(depth_m)
    column = np.rint(np.where(is_point, column, 0.0)).astype(int)
    inside = mask[np.arange(camera.num_rows)[:, None], np.clip(column, 0, camera.num_columns - 1)]
    # Points outside the projector's picture count as possibly shaded.
    return is_point & (inside | (column < 0))


def projector_columns_px(camera: Camera, baseline_m: float, depth_m: Image) -> Image:
    """Column of each pixel's point in a projector with the camera's intrinsics; the row is the pixel's own [px].

    The projector is `baseline_m` to the camera's right [m].
    """
    return np.arange(camera.num_columns) - camera.focal_px[0] * baseline_m / depth_m


def boxes_of(sight: Sight, groups: tuple[int, ...]) -> Boxes:
    """Corners of a box around each geom of some groups, in the camera's frame [m]."""
    model, data = sight.data.model, sight.data
    is_asked = np.isin(model.geom_group, groups)
    middle_m, half_m = np.split(model.geom_aabb[is_asked], 2, axis=1)
    corners_m = middle_m[:, None] + half_m[:, None] * _CORNERS
    turned_m = np.einsum("pij,pcj->pci", data.geom_xmat[is_asked].reshape(-1, 3, 3), corners_m)
    world_m = data.geom_xpos[is_asked][:, None] + turned_m
    return sight.camera.world_from_camera.apply_inverse(world_m.reshape(-1, 3)).reshape(world_m.shape)


def with_rays(view: IdealView, sight: Sight, standing: tuple[int, ...], moving: tuple[int, ...]) -> IdealView:
    """Overlay moving geoms on a view, by rays.

    `standing` are the groups of geoms in the view, `moving` the groups to add.
    """
    boxes, groups = boxes_of(sight, moving), standing + moving
    is_new = shown_within(boxes, sight.camera)
    depth_m, hits, directions = pixel_hits(sight.data, sight.camera, is_new, groups)
    seen = _copied(view)
    seen.depth_m[is_new], seen.body[is_new] = depth_m, hits.body
    seen.incidence_cosine[is_new] = np.abs(np.sum(hits.normal * directions, axis=1))
    is_asked = is_new | shaded_within(boxes, sight.camera, sight.baseline_m, seen.depth_m)
    seen.is_lit[is_asked] = _is_reached(sight, seen.depth_m, is_asked, groups)
    return seen


def with_facets(view: IdealView, sight: Sight, others: tuple[int, ...], facets: Facets, group: int) -> IdealView:
    """Overlay the meshes of a group on a view, facet by facet.

    The result is that of `with_rays`, in a fraction of the time: a ray must search for its facet, a facet covers known
    pixels. `others` are the groups of geoms in the view.
    """
    camera, seen, boxes = sight.camera, _copied(view), boxes_of(sight, (group,))
    corners_m = facets.seen_from(sight.data, camera.world_from_camera)
    is_new = np.zeros(view.is_lit.shape, dtype=bool)
    row, column = np.nonzero(shown_within(boxes, camera))
    met = first_met(corners_m, camera.intrinsics, RowRays(row, column.astype(np.float64)))
    is_first = (met.facet >= 0) & ~(met.depth_m >= view.depth_m[row, column])
    here, facet = (row[is_first], column[is_first]), met.facet[is_first]
    is_new[here] = True
    seen.depth_m[here], seen.body[here] = met.depth_m[is_first], facets.body[facet]
    rays = camera.pixel_rays()[here]
    cosine = np.abs(np.sum(normals(corners_m)[facet] * rays, axis=1)) / np.linalg.norm(rays, axis=1)
    seen.incidence_cosine[here] = cosine
    seen.is_lit[is_new] = _is_reached(sight, seen.depth_m, is_new, others)
    seen.is_lit[_is_shaded(corners_m, boxes, sight, seen.depth_m)] = False
    return seen


def _copied(view: IdealView) -> IdealView:
    return IdealView(view.depth_m.copy(), view.body.copy(), view.incidence_cosine.copy(), view.is_lit.copy())


def _is_reached(sight: Sight, depth_m: Image, is_asked: Mask, groups: tuple[int, ...]) -> Bool[np.ndarray, " asked"]:
    """Whether the projector reaches each of the pixels asked, past some groups of geoms."""
    points_m = sight.camera.world_from_camera.apply(sight.camera.pixel_rays()[is_asked] * depth_m[is_asked][:, None])
    return is_reached(sight, points_m, groups)


def _is_shaded(corners_m: Float[np.ndarray, "facets 3 3"], boxes: Boxes, sight: Sight, depth_m: Image) -> Mask:
    """Pixels that facets shade from the projector."""
    camera, shift_m = sight.camera, np.array([sight.baseline_m, 0.0, 0.0])
    is_shaded = shaded_within(boxes, camera, sight.baseline_m, depth_m)
    row, _ = here = np.nonzero(is_shaded)
    column = projector_columns_px(camera, sight.baseline_m, depth_m)[here]
    met = first_met(corners_m - shift_m, camera.intrinsics, RowRays(row, column))
    # Distance from the projector is depth times the length of the ray with z = 1.
    (fx, fy), (cx, cy) = camera.focal_px, camera.centre_px
    length = np.sqrt(((column - cx) / fx) ** 2 + ((row - cy) / fy) ** 2 + 1.0)
    is_shaded[here] = met.depth_m * length < depth_m[here] * length - LIT_TOLERANCE_M
    return is_shaded
