"""Occlusion: silhouettes, extension of hidden vessel ends to the length of cups, and who hides whom.

A silhouette is the part of the image that a solid would cover if it stood there alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from halfseen.arrays import Hides, PerObject, Points
from halfseen.perception.objects import NO_OBJECT, Labels
from halfseen.perception.plane import Plane
from halfseen.perception.range_image import Pixels, RangeImage
from halfseen.perception.solids import Hull, Vessel
from halfseen.shapes import Bool, Float, Int

ON_EDGE_PX = 1e-10
"""Pixels this close to the edge of a polygon are within."""


def convex_pixels(hull: ConvexHull, shape: tuple[int, int]) -> Int[np.ndarray, " px"]:
    """Flat indices of the pixels within a convex polygon, in increasing order.

    Parameters
    ----------
    hull
        Of points as (column, row); they may lie outside the image [px].
    shape
        Rows and columns of the image [px].
    """
    ends_px = np.floor(hull.min_bound), np.ceil(hull.max_bound) + 1
    (left, top), (right, bottom) = (np.clip(end, 0, shape[::-1]).astype(int) for end in ends_px)
    column, row = np.arange(left, right), np.arange(top, bottom)[:, None]
    # Each edge bounds each row on one side; a level one, divided by +0, bounds all of it or nothing.
    across, down, offset_px = hull.equations.T + 0.0
    with np.errstate(divide="ignore"):
        bound = (ON_EDGE_PX - offset_px - down * row) / across
    first = bound.max(axis=1, where=across < 0, initial=-np.inf, keepdims=True)
    last = bound.min(axis=1, where=across >= 0, initial=np.inf, keepdims=True)
    return (row * shape[1] + column)[(first <= column) & (column <= last)]


# Points with a smaller depth are not projected [m].
NEAREST_M = 0.05


def covered(solid: Vessel | Hull, plane: Plane, image: RangeImage) -> Pixels:
    """Pixels that a solid would cover if it stood there alone, in increasing order.

    Parameters
    ----------
    solid, plane, image
        The solid, the table that it stands on, and the image for the projection.
    """
    outline_px = projected(plane.camera_points(solid.outline_m()), image)
    if len(outline_px) < 3:
        return np.empty(0, dtype=np.int64)
    try:
        hull = ConvexHull(outline_px)
    except QhullError:
        return np.empty(0, dtype=np.int64)
    return convex_pixels(hull, image.depth_m.shape)


def projected(points_m: Points, image: RangeImage) -> Float[np.ndarray, "m 2"]:
    """Pixels (column, row) of the points in front of the camera [px].

    Parameters
    ----------
    points_m
        Points in the camera frame [m].
    image
        Image of the camera.
    """
    seen = points_m[points_m[:, 2] > NEAREST_M]
    K = image.intrinsics
    return seen[:, :2] / seen[:, 2:] * [K[0, 0], K[1, 1]] + K[:2, 2]


def middle_depth_m(
    solid: Vessel | Hull, plane: Plane, image: RangeImage, asked: Int[np.ndarray, " px"]
) -> Float[np.ndarray, " px"]:
    """Depth at which each pixel's ray passes closest to the axis of a solid [m].

    Surfaces at a smaller depth hide the solid; farther ones do not.

    Parameters
    ----------
    solid, plane, image
        The solid, the table that it stands on, and the image.
    asked
        Pixels to compute.
    """
    K, (rows, columns) = image.intrinsics, np.divmod(asked, image.depth_m.shape[1])
    right, down = (columns - K[0, 2]) / K[0, 0], (rows - K[1, 2]) / K[1, 1]
    ahead = 1.0 / np.sqrt(right * right + down * down + 1.0)
    start, end = plane.camera_points(solid.axis_ends_m())
    length = max(float(np.linalg.norm(end - start)), 1e-9)
    axis = (end - start) / length
    # The point of the axis closest to a ray through the origin, clipped to the ends.
    cosine, towards = ((right * way[0] + down * way[1] + way[2]) * ahead for way in (axis, start))
    apart = np.maximum(1.0 - cosine * cosine, 1e-6)
    along = np.clip((cosine * towards - start @ axis) / apart, 0.0, length)
    return (towards + along * cosine) * ahead


# Lengths of cups and cans from base to rim [m], and the largest length in radii.
SHORTEST_M, LONGEST_M = 0.07, 0.15
LONGEST_IN_RADII = 3.6
# An end is extended in steps of this length [m] ...
STEP_M = 0.005
# ... until this share of the pixels added by a step shows something behind it.
CONTRADICTION_SHARE = 0.4
# A shadow next to an end is not evidence: this share of all added pixels must lie behind a nearer object.
HIDDEN_SHARE = 0.3


def extended(i: int, vessel: Vessel, labels: Labels, plane: Plane, image: RangeImage) -> Vessel:
    """Extend the ends of a vessel that nearer objects hide.

    A vessel is at least as long as its visible part. Its estimated length is halfway between the visible length and the
    longest typical length. An end extends up to that length, and stops where a surface behind it is visible.

    Parameters
    ----------
    i
        Label of the vessel.
    vessel
        The visible part of the vessel.
    labels
        Object of each pixel, `NO_OBJECT` or `LEFT_OUT`.
    plane, image
        The table and the range image.
    """
    seen = vessel.ends_m[1] - vessel.ends_m[0]
    longest = min(LONGEST_M, LONGEST_IN_RADII * vessel.radius_m)
    probable = (max(seen, SHORTEST_M) + longest) / 2
    num_steps = int((probable - seen) / STEP_M)
    if num_steps < 1:
        return vessel
    own = cache(partial(covered, vessel, plane, image))

    def room(end: int) -> int:
        """Number of steps by which an end can be extended; the foot of a standing vessel is never extended."""
        longest = _prolonged(vessel, end, num_steps)
        asked = covered(longest, plane, image)
        label, depth_m = labels.ravel()[asked], image.depth_m.ravel()[asked]
        hiding = (label != NO_OBJECT) & (label != i) & (depth_m < middle_depth_m(longest, plane, image, asked))
        if not hiding.any():
            return 0
        is_hiding, is_against, is_before, is_added = np.zeros((4, labels.size), dtype=bool)
        is_hiding[asked] = hiding
        is_against[asked] = np.isfinite(depth_m) & (label != i) & ~hiding
        is_before[own()] = True
        found = 0
        for step in range(1, num_steps + 1):
            after = covered(_prolonged(vessel, end, step), plane, image) if step < num_steps else asked
            added = after[~is_before[after]]
            if len(added) and is_against[added].mean() > CONTRADICTION_SHARE:
                break
            found = step
            is_before[:] = False
            is_before[after] = True
            is_added[added[labels.ravel()[added] != i]] = True
        return found if is_added.any() and is_hiding[is_added].mean() > HIDDEN_SHARE else 0

    rooms = [0 if vessel.is_upright else room(0), room(1)]
    # Both ends share the missing length; an end takes what the other has no room for.
    first = min(rooms[0], max(num_steps // 2, num_steps - rooms[1]))
    return _prolonged(_prolonged(vessel, 0, first), 1, min(rooms[1], num_steps - first))


def _prolonged(vessel: Vessel, end: int, num_steps: int) -> Vessel:
    low, high = vessel.ends_m
    more = num_steps * STEP_M
    return replace(vessel, ends_m=(low, high + more) if end else (low - more, high))


# Returns this close to a solid's wall belong to it, even if they are too low to be separated from the table [m].
OWN_M = 0.006

Masks = Bool[np.ndarray, "N H W"]
SeenMask = Bool[np.ndarray, " px"]


@dataclass(frozen=True, eq=False)
class Occlusion:
    """Mutual occlusion of objects.

    Parameters
    ----------
    silhouettes
        Pixels that each object would cover if it stood there alone.
    occlusion
        Share of each silhouette that is hidden behind nearer objects.
    hides
        ``hides[i, j]`` is the share of silhouette i that j alone would hide.
    """

    silhouettes: Masks
    occlusion: PerObject
    hides: Hides


def occlusions(labels: Labels, solids: Sequence[Vessel | Hull], plane: Plane, image: RangeImage) -> Occlusion:
    """Compute silhouettes and mutual occlusion.

    A silhouette consists of the object's visible pixels and of those pixels of its solid that show a nearer object or
    have no return. Pixels of the solid that show a farther surface or the table are evidence against the solid and do
    not count.

    Parameters
    ----------
    labels
        Object of each pixel, `NO_OBJECT` or `LEFT_OUT`.
    solids
        Completed shape of each object.
    plane, image
        The table and the range image.
    """
    covers = [covered(solid, plane, image) for solid in solids]
    seen = _Seen.of(covers, labels, image)
    shape = (len(solids), len(seen.pixels))
    is_covered, middles = np.zeros(shape, dtype=bool), np.full(shape, np.inf)
    for i, solid in enumerate(solids):
        within = np.searchsorted(seen.pixels, covers[i])
        is_covered[i, within] = True
        middles[i, within] = middle_depth_m(solid, plane, image, covers[i])
    silhouettes, is_behind = np.zeros(shape, dtype=bool), np.zeros(shape, dtype=bool)
    for i, solid in enumerate(solids):
        is_behind[i] = _hidden(i, is_covered[i], middles, seen)
        silhouettes[i] = is_behind[i] | _own(i, solid, is_covered[i], seen, plane)
    size = np.array([max(np.count_nonzero(silhouette), 1) for silhouette in silhouettes])
    num_behind = np.array([np.count_nonzero(mask) for mask in is_behind], dtype=int)
    masks = np.zeros((len(solids), labels.size), dtype=bool)
    masks[:, seen.pixels] = silhouettes
    masks = masks.reshape(len(solids), *labels.shape)
    return Occlusion(masks, num_behind / size, _hides(silhouettes, is_behind, middles, seen.labels))


@dataclass(frozen=True, eq=False)
class _Seen:
    """The pixels at which an object is visible or a solid would be."""

    pixels: Pixels
    labels: Int[np.ndarray, " px"]
    points_m: Points
    is_return: Bool[np.ndarray, " px"]

    @classmethod
    def of(cls, covers: Sequence[Pixels], labels: Labels, image: RangeImage) -> "_Seen":
        """Select these pixels."""
        is_any = labels.ravel() >= 0
        for cover in covers:
            is_any[cover] = True
        pixels = np.flatnonzero(is_any)
        points_m = image.points_m.reshape(-1, 3)[pixels]
        return cls(pixels, labels.ravel()[pixels], points_m, np.isfinite(points_m[:, 2]))


def _hidden(i: int, is_covered: SeenMask, middles: Float[np.ndarray, "N px"], seen: _Seen) -> SeenMask:
    """Pixels of a solid that show a nearer object, or that have no return and lie behind a nearer solid."""
    pixels = np.flatnonzero(is_covered)
    label, depth, middle = seen.labels[pixels], seen.points_m[pixels, 2], middles[i, pixels]
    is_before = (label != NO_OBJECT) & (label != i) & (depth < middle)
    is_missed = ~seen.is_return[pixels]
    # The depth of other solids is infinite at pixels that they do not cover.
    is_before[is_missed] |= (middles[:, pixels[is_missed]] < middle[is_missed]).any(axis=0)
    hidden = np.zeros_like(is_covered)
    hidden[pixels] = is_before
    return hidden


def _own(i: int, solid: Vessel | Hull, is_covered: SeenMask, seen: _Seen, plane: Plane) -> SeenMask:
    """Pixels of an object that are visible or have no return."""
    own = (seen.labels == i) | (is_covered & ~seen.is_return)
    if isinstance(solid, Vessel):
        low = is_covered & (seen.labels == NO_OBJECT) & seen.is_return
        own[low] = np.abs(solid.outside_m(plane.table_points(seen.points_m[low]))) < OWN_M
    return own


def _hides(
    silhouettes: Bool[np.ndarray, "N px"],
    is_behind: Bool[np.ndarray, "N px"],
    middles: Float[np.ndarray, "N px"],
    labels: Int[np.ndarray, " px"],
) -> Hides:
    """Share of each silhouette that each other object hides, whether that object is visible there or hidden itself."""
    objects = np.arange(len(silhouettes))[:, None]
    hides = np.zeros((len(silhouettes), len(silhouettes)))
    is_shared = silhouettes.sum(axis=0, dtype=np.uint16) > 1
    for i, silhouette in enumerate(silhouettes):
        within = np.flatnonzero(silhouette & is_shared)
        label, middle = labels[within], middles[i, within]
        is_other = (label == objects) & is_behind[i, within]
        is_inferred = (label != i) & (label != objects) & silhouettes[:, within] & (middles[:, within] < middle)
        hides[i] = np.count_nonzero(is_other | is_inferred, axis=1) / max(np.count_nonzero(silhouette), 1)
    np.fill_diagonal(hides, 0.0)
    return hides
