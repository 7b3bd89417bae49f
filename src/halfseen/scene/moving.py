"""Views of what moves, laid over a view of what does not: by rays within windows, or facet by facet."""

# MuJoCo's names come from compiled modules without stubs, which pyright cannot look into.
# pyright: reportAttributeAccessIssue=false

from dataclasses import dataclass

import mujoco
import numpy as np

from halfseen.arrays import Image
from halfseen.scene.camera import Camera
from halfseen.scene.facets import Facets, normals
from halfseen.scene.scanlines import RowRays, first_met
from halfseen.scene.view import LIT_TOLERANCE_M, IdealView, is_reached, pixel_hits
from halfseen.scene.windows import Boxes, Mask, boxes_m, projector_columns_px, shaded_within, shown_within
from halfseen.shapes import Bool, Float


@dataclass(frozen=True)
class Sight:
    """Who looks at what.

    Parameters
    ----------
    model, data
        The world, and where the bodies are.
    camera
        The camera.
    baseline_m
        The projector stands this far to its right [m].
    """

    model: mujoco.MjModel
    data: mujoco.MjData
    camera: Camera
    baseline_m: float

    def boxes_m(self, groups: tuple[int, ...]) -> Boxes:
        """Corners of boxes around what is in some groups of geoms, in the camera's frame [m]."""
        return boxes_m(self.model, self.data, self.camera, groups)


def with_rays(view: IdealView, sight: Sight, standing: tuple[int, ...], moving: tuple[int, ...]) -> IdealView:
    """Lay over a view what moves in it, by rays.

    Parameters
    ----------
    view
        Of what stands.
    sight
        Who looks at what.
    standing, moving
        Groups of the geoms that are in the view, and of those to add.
    """
    boxes, groups = sight.boxes_m(moving), standing + moving
    is_new = shown_within(boxes, sight.camera)
    depth_m, hits, directions = pixel_hits(sight.model, sight.camera, is_new, sight.data, groups)
    seen = _copied(view)
    seen.depth_m[is_new], seen.body[is_new] = depth_m, hits.body
    seen.incidence_cosine[is_new] = np.abs(np.sum(hits.normal * directions, axis=1))
    is_asked = is_new | shaded_within(boxes, sight.camera, sight.baseline_m, seen.depth_m)
    seen.is_lit[is_asked] = _is_reached(sight, seen.depth_m, is_asked, groups)
    return seen


def with_facets(view: IdealView, sight: Sight, others: tuple[int, ...], facets: Facets, group: int) -> IdealView:
    """Lay over a view the meshes of a group, facet by facet.

    The same as by rays, for a small part of the time: rays look for the facet that they meet, facets know their pixels.

    Parameters
    ----------
    view
        Of everything else.
    sight
        Who looks at what.
    others
        Groups of the geoms that are in the view.
    facets, group
        Of the meshes.
    """
    camera, seen, boxes = sight.camera, _copied(view), sight.boxes_m((group,))
    corners_m = facets.seen_from(sight.data, camera.world_from_camera)
    is_new = np.zeros(view.is_lit.shape, dtype=bool)
    row, column = np.nonzero(shown_within(boxes, camera))
    met = first_met(corners_m, camera.intrinsics, RowRays(row, column.astype(np.float64)))
    is_first = (met.facet >= 0) & ~(met.depth_m >= view.depth_m[row, column])
    here, facet = (row[is_first], column[is_first]), met.facet[is_first]
    is_new[here] = True
    seen.depth_m[here], seen.body[here] = met.depth_m[is_first], facets.body[facet]
    seen.incidence_cosine[here] = _cosines(normals(corners_m)[facet], camera.pixel_rays()[here])
    seen.is_lit[is_new] = _is_reached(sight, seen.depth_m, is_new, others)
    seen.is_lit[_is_shaded(corners_m, boxes, sight, seen.depth_m)] = False
    return seen


def _copied(view: IdealView) -> IdealView:
    return IdealView(view.depth_m.copy(), view.body.copy(), view.incidence_cosine.copy(), view.is_lit.copy())


def _cosines(normals: Float[np.ndarray, "px 3"], rays: Float[np.ndarray, "px 3"]) -> Float[np.ndarray, " px"]:
    return np.abs(np.sum(normals * rays, axis=1)) / np.linalg.norm(rays, axis=1)


def _is_reached(sight: Sight, depth_m: Image, is_asked: Mask, groups: tuple[int, ...]) -> Bool[np.ndarray, " asked"]:
    """Which of the pixels asked the projector reaches past some groups of geoms."""
    pose = sight.camera.world_from_camera
    points_m = pose.apply(sight.camera.pixel_rays()[is_asked] * depth_m[is_asked][:, None])
    projector_m = np.asarray(pose.position_m) + sight.baseline_m * pose.rotation[:, 0]
    return is_reached(sight.model, projector_m, points_m, sight.data, groups)


def _is_shaded(corners_m: Float[np.ndarray, "facets 3 3"], boxes: Boxes, sight: Sight, depth_m: Image) -> Mask:
    """Pixels that facets keep the projector from."""
    camera, shift_m = sight.camera, np.array([sight.baseline_m, 0.0, 0.0])
    is_shaded = shaded_within(boxes, camera, sight.baseline_m, depth_m)
    row, _ = here = np.nonzero(is_shaded)
    column = projector_columns_px(camera, sight.baseline_m, depth_m)[here]
    met = first_met(corners_m - shift_m, camera.intrinsics, RowRays(row, column))
    # Distances from the projector are its depths times the length of a ray.
    (fx, fy), (cx, cy) = camera.focal_px, camera.centre_px
    length = np.sqrt(((column - cx) / fx) ** 2 + ((row - cy) / fy) ** 2 + 1.0)
    is_shaded[here] = met.depth_m * length < depth_m[here] * length - LIT_TOLERANCE_M
    return is_shaded
