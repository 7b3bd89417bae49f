"""First hits of rays from one point: by MuJoCo, or on facets for rays in the rows of a picture.

Rays from one point hit a facet where its projection covers the picture. A row crosses the projection in one span, in
which every ray hits the facet, at a depth whose inverse is linear in row and column. So the cost of a facet is
proportional to the number of rows that it covers.
"""

# MuJoCo's names come from compiled modules without stubs, which pyright cannot look into.
# pyright: reportAttributeAccessIssue=false

from dataclasses import dataclass

import mujoco
import numpy as np

from halfseen.arrays import Intrinsics
from halfseen.shapes import Float, Int

Directions = Float[np.ndarray, "rays 3"]

CUP_GROUP, ROBOT_GROUP, FURNITURE_GROUP, UNSEEN_GROUP = 0, 2, 3, 4
"""Groups of geoms: cups, which are meshes; robots and static geoms, where a model separates them; and geoms that rays
pass through."""
SEEN_GROUPS = tuple(group for group in range(mujoco.mjNGROUP) if group != UNSEEN_GROUP)


@dataclass(frozen=True)
class Hits:
    """First hit of each ray.

    Parameters
    ----------
    distance_m
        Distance along the ray [m]; NaN without a hit.
    body
        Body that was hit; −1 without a hit.
    normal
        Unit normal of the surface; NaN without a hit.
    """

    distance_m: Float[np.ndarray, " rays"]
    body: Int[np.ndarray, " rays"]
    normal: Float[np.ndarray, "rays 3"]


def at_rest(model: mujoco.MjModel) -> mujoco.MjData:
    """Bodies of a model in their initial poses."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return data


def cast(
    data: mujoco.MjData,
    origin_m: Float[np.ndarray, " 3"],
    unit_directions: Directions,
    reach_m: float,
    groups: tuple[int, ...] = SEEN_GROUPS,
) -> Hits:
    """Cast rays from one point among bodies, which do not change.

    Bodies beyond `reach_m` are ignored [m]; `groups` are the geoms that rays can hit.
    """
    model = data.model
    num_rays = len(unit_directions)
    geom = np.full(num_rays, -1, dtype=np.int32)
    distance_m = np.full(num_rays, -1.0)
    normal = np.zeros(3 * num_rays)
    directions = np.ascontiguousarray(unit_directions, dtype=np.float64).ravel()
    met = np.isin(np.arange(mujoco.mjNGROUP), groups).astype(np.uint8)
    mujoco.mj_multiRay(model, data, origin_m, directions, met, True, -1, geom, distance_m, normal, num_rays, reach_m)
    is_hit = geom >= 0
    body = np.where(is_hit, model.geom_bodyid[np.maximum(geom, 0)], -1).astype(np.int64)
    normal = normal.reshape(-1, 3)
    return Hits(np.where(is_hit, distance_m, np.nan), body, np.where(is_hit[:, None], normal, np.nan))


Corners = Float[np.ndarray, "facets 3 3"]


@dataclass(frozen=True)
class RowRays:
    """Rays from the origin of a camera's frame, in any order.

    Parameters
    ----------
    row
        Integer row [px].
    column
        Any column, also outside the picture [px].
    """

    row: Int[np.ndarray, " rays"]
    column: Float[np.ndarray, " rays"]


@dataclass(frozen=True)
class Met:
    """First facet hit by each ray.

    Parameters
    ----------
    depth_m
        Depth along the camera's z axis [m]; infinite without a hit.
    facet
        Facet that was hit; −1 without a hit.
    """

    depth_m: Float[np.ndarray, " rays"]
    facet: Int[np.ndarray, " rays"]


@dataclass(frozen=True)
class _Facing:
    """Facets that face the camera, in homogeneous pixels (column, row, 1).

    `edges` are the lines through their sides, not negative inside; `inverse_depth` is 1/z [1/m]; a facet covers
    `num_rows` rows from `top` on.
    """

    facet: Int[np.ndarray, " facing"]
    edges: Float[np.ndarray, "facing 3 3"]
    inverse_depth: Float[np.ndarray, "facing 3"]
    top: Int[np.ndarray, " facing"]
    num_rows: Int[np.ndarray, " facing"]


def first_met(corners_m: Corners, intrinsics: Intrinsics, rays: RowRays) -> Met:
    """Find the first facet that each ray hits.

    Corners are in the camera's frame, counterclockwise as seen from outside [m]. They may lie behind the camera. The
    facets bound solids, none of which contains the camera: inner sides are not hit. The intrinsics are those of the
    picture in which the rays' rows and columns are given [px].
    """
    num_rays = len(rays.row)
    inverse_depth, facet = np.zeros(num_rays), np.full(num_rays, -1)
    if num_rays:
        facing = _facing(corners_m, intrinsics, rays)
        which, ray = _meetings(facing, rays)
        a, b, c = facing.inverse_depth[which].T
        each = a * rays.column[ray] + b * rays.row[ray] + c
        np.maximum.at(inverse_depth, ray, each)
        is_first = each == inverse_depth[ray]
        facet[ray[is_first]] = facing.facet[which[is_first]]
    with np.errstate(divide="ignore"):
        return Met(1.0 / inverse_depth, facet)


def _facing(corners_m: Corners, intrinsics: Intrinsics, rays: RowRays) -> _Facing:
    """Facets that face the camera within the rays' rows and columns."""
    corners = corners_m @ intrinsics.T
    top, bottom, is_beside = _extent(corners, rays)
    edges = -np.cross(np.roll(corners, -1, axis=1), np.roll(corners, 1, axis=1))
    volume = np.einsum("fi,fi->f", edges[:, 0], corners[:, 0])
    facet = np.flatnonzero((volume > 0) & (bottom >= top) & ~is_beside)
    inverse_depth = edges[facet].sum(axis=1) / volume[facet, None]
    return _Facing(facet, edges[facet], inverse_depth, top[facet], (bottom - top)[facet] + 1)


def _extent(
    corners: Corners, rays: RowRays
) -> tuple[Int[np.ndarray, " facets"], Int[np.ndarray, " facets"], np.ndarray]:
    """First and last row of each facet among those of the rays, and whether it lies outside all their columns."""
    is_before = corners[..., 2] > 0
    # A facet that reaches behind the camera may cover any row; the spans decide.
    is_whole = is_before.all(axis=1)
    column, row = np.moveaxis(corners[..., :2] / np.where(is_before, corners[..., 2], 1.0)[..., None], -1, 0)
    first, last = int(rays.row.min()), int(rays.row.max())
    top = np.clip(np.where(is_whole, np.ceil(row.min(axis=1)), first), first, last + 1).astype(int)
    bottom = np.clip(np.where(is_whole, np.floor(row.max(axis=1)), last), first - 1, last).astype(int)
    is_beside = (column.max(axis=1) < rays.column.min()) | (column.min(axis=1) > rays.column.max())
    return top, bottom, (is_whole & is_beside) | ~is_before.any(axis=1)


def _meetings(facing: _Facing, rays: RowRays) -> tuple[Int[np.ndarray, " met"], Int[np.ndarray, " met"]]:
    """Facet, as an index into `_Facing`, and ray of every hit: the rays of a row within the facet's span there."""
    which, within = _counted(facing.num_rows)
    row = facing.top[which] + within
    left = np.full(len(which), float(rays.column.min()))
    right = np.full(len(which), float(rays.column.max()))
    for edge in np.moveaxis(facing.edges, 1, 0):
        # A horizontal side bounds no column: if it is crossed at all, its bound lies beyond all columns.
        slope = np.where(edge[:, 0] == 0, np.finfo(float).tiny, edge[:, 0])[which]
        with np.errstate(over="ignore"):
            bound = -(edge[which, 1] * row + edge[which, 2]) / slope
        np.maximum(left, bound, out=left, where=slope > 0)
        np.minimum(right, bound, out=right, where=slope < 0)
    is_open = left <= right
    which, row, left, right = (each[is_open] for each in (which, row, left, right))
    low = rays.column.min()
    # One number orders rays by row, then column.
    width = rays.column.max() - low + 1.0
    place = rays.row * width + (rays.column - low)
    order = np.argsort(place, kind="stable")
    place = place[order]
    begin = np.searchsorted(place, row * width + (left - low))
    end = np.searchsorted(place, row * width + (right - low), side="right")
    span, within = _counted(end - begin)
    return which[span], order[begin[span] + within]


def _counted(numbers: Int[np.ndarray, " n"]) -> tuple[Int[np.ndarray, " total"], Int[np.ndarray, " total"]]:
    """Enumerate the range of each number: index of the number, and position from 0."""
    which = np.repeat(np.arange(len(numbers)), numbers)
    return which, np.arange(len(which)) - (np.cumsum(numbers) - numbers)[which]
