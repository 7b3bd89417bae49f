"""Convex solids as meshes: their shadows as seen from the camera, and the occlusion between them.

A camera sees the points that a lamp in its place would light. The points that a convex solid K hides from an eye e are
{e + t (k − e) : k ∈ K, t > 1}, which is convex, too.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from halfseen.arrays import Points
from halfseen.perception.clouds import Vector
from halfseen.shapes import Bool, Float, Int

LONGEST_SHADOW_M = 0.6
"""Shadows are cut at this distance behind solids that reach the height of the eye [m]."""
_NUM_SAMPLES = 600


@dataclass(frozen=True, eq=False)
class Mesh:
    """A convex solid: corners [m], and three corner indices per triangle, counter-clockwise as seen from outside."""

    vertices_m: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "triangles 3"]

    def moved(self, to_from_here: Float[np.ndarray, "4 4"]) -> "Mesh":
        """Transform the solid into another frame."""
        return Mesh(moved(self.vertices_m, to_from_here), self.faces)


def moved(points_m: Points, to_from_here: Float[np.ndarray, "4 4"]) -> Points:
    """Transform points into another frame, by a transform of homogeneous points [m]."""
    return points_m @ to_from_here[:3, :3].T + to_from_here[:3, 3]


def convex_mesh(points_m: Points) -> Mesh:
    """Return the convex hull of points as a mesh.

    Parameters
    ----------
    points_m
        At least four points [m]; of coplanar points, the hull is as thin as rounding makes it.
    """
    try:
        hull = ConvexHull(points_m)
    except QhullError:
        hull = ConvexHull(points_m, qhull_options="QJ")
    is_inward = np.einsum("fd,fd->f", _normals(points_m[hull.simplices]), hull.equations[:, :3]) < 0
    faces = np.where(is_inward[:, None], hull.simplices[:, ::-1], hull.simplices)
    used, faces = np.unique(faces, return_inverse=True)
    return Mesh(points_m[used], faces.reshape(-1, 3).astype(np.int64))


def _normals(corners: Float[np.ndarray, "f 3 3"]) -> Float[np.ndarray, "f 3"]:
    """Normals of triangles, from their corners; each is twice as long as the triangle's area."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def shadow(solid: Mesh, eye_m: Vector) -> Mesh:
    """Return a solid together with its shadow, down to the table.

    Parameters
    ----------
    solid
        The solid, in coordinates of the table, whose plane is at height 0.
    eye_m
        Position of the camera, above the table [m].
    """
    ray_m = solid.vertices_m - eye_m
    with np.errstate(divide="ignore"):
        to_table = np.where(ray_m[:, 2] < 0, -eye_m[2] / ray_m[:, 2], np.inf)
    stretch = np.clip(to_table, 1.0, 1.0 + LONGEST_SHADOW_M / np.linalg.norm(ray_m, axis=1))
    return convex_mesh(np.concatenate([solid.vertices_m, eye_m + stretch[:, None] * ray_m]))


def is_behind(points_m: Points, solid: Mesh, eye_m: Vector) -> Bool[np.ndarray, " n"]:
    """Whether a solid hides points from an eye.

    Parameters
    ----------
    points_m
        The points [m].
    eye_m
        Position of the camera [m].
    """
    corners = solid.vertices_m[solid.faces]
    outward = _normals(corners)
    outside = points_m @ outward.T - np.einsum("fd,fd->f", outward, corners[:, 0])
    along = (eye_m - points_m) @ outward.T
    # The line of sight, from 0 at the point to 1 at the eye, is within a face's half-space where outside + s along ≤ 0.
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = -outside / along
    enters = np.where(along < 0, crossing, np.where((along == 0) & (outside > 0), np.inf, -np.inf)).max(axis=1)
    leaves = np.where(along > 0, crossing, np.inf).min(axis=1)
    return (np.maximum(enters, 0.0) < np.minimum(leaves, 1.0)) & (leaves > 0)


def revealed_by(index: int, solids: Sequence[Mesh], eye_m: Vector) -> Points:
    """Points of other solids that lifting this one would reveal to the camera [m].

    Parameters
    ----------
    eye_m
        Position of the camera [m].
    """
    found = [np.zeros((0, 3))]
    for other, solid in enumerate(solids):
        if other == index:
            continue
        points_m = _facing(solid, eye_m)
        is_shown = is_behind(points_m, solids[index], eye_m)
        for third, each in enumerate(solids):
            if third not in (index, other) and is_shown.any():
                is_shown &= ~is_behind(points_m, each, eye_m)
        found.append(points_m[is_shown])
    return np.concatenate(found)


def _facing(solid: Mesh, eye_m: Vector) -> Points:
    """Points spread over the faces of a solid that face the camera."""
    corners = solid.vertices_m[solid.faces]
    normals = _normals(corners)
    is_facing = np.einsum("fd,fd->f", normals, eye_m - corners[:, 0]) > 0
    area = np.linalg.norm(normals, axis=1)
    rng = np.random.default_rng(0)
    face = rng.choice(len(area), _NUM_SAMPLES, p=area / area.sum())
    first, second = np.sort(rng.random((2, _NUM_SAMPLES)), axis=0)
    weights = np.stack([first, second - first, 1.0 - second], axis=1)
    return np.einsum("sc,scd->sd", weights, corners[face])[is_facing[face]]
