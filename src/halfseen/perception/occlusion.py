"""Who hides whom: completed silhouettes, and what lies before them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from halfseen.arrays import Hides, PerObject
from halfseen.perception.objects import Labels
from halfseen.perception.plane import Plane
from halfseen.perception.range_image import PixelMask, RangeImage
from halfseen.perception.silhouette import covered, middle_depth_m
from halfseen.perception.solids import Hull, Vessel

# Returns this near to a solid are its own, though too low over the table to be told from it [m].
OWN_M = 0.006

Masks = Bool[np.ndarray, "N H W"]


@dataclass(frozen=True, eq=False)
class Occlusion:
    """Who hides whom.

    Parameters
    ----------
    silhouettes
        What each object would fill of the image if it stood there alone.
    occlusion
        Share of each silhouette that is hidden behind nearer objects.
    hides
        ``hides[i, j]`` is the share of silhouette i that j alone would hide.
    """

    silhouettes: Masks
    occlusion: PerObject
    hides: Hides


def occlusions(labels: Labels, solids: Sequence[Vessel | Hull], plane: Plane, image: RangeImage) -> Occlusion:
    """Measure who hides whom.

    A silhouette is what is seen of the object, and those pixels of its solid at which either a nearer object is seen,
    or nothing returned. Pixels of the solid at which something farther is seen, or the table, are evidence against
    the solid and do not count.

    Parameters
    ----------
    labels
        Object of each pixel; −1 where there is none.
    solids
        Completed shape of each object.
    plane, image
        The table and what the camera sees.
    """
    shape = (len(solids), *labels.shape)
    covers, middles = np.zeros(shape, dtype=bool), np.empty(shape)
    for i, solid in enumerate(solids):
        covers[i] = covered(solid, plane, image)
        middles[i] = middle_depth_m(solid, plane, image, covers[i])
    silhouettes, is_behind = np.zeros(shape, dtype=bool), np.zeros(shape, dtype=bool)
    for i, solid in enumerate(solids):
        is_behind[i] = _hidden(i, covers[i], middles, labels, image)
        silhouettes[i] = is_behind[i] | _own(i, solid, covers[i], labels, plane, image)
    size = np.array([max(np.count_nonzero(silhouette), 1) for silhouette in silhouettes])
    num_behind = np.array([np.count_nonzero(mask) for mask in is_behind], dtype=int)
    return Occlusion(silhouettes, num_behind / size, _hides(silhouettes, is_behind, middles, labels))


def _hidden(
    i: int, is_covered: PixelMask, middles: Float[np.ndarray, "N H W"], labels: Labels, image: RangeImage
) -> PixelMask:
    """Pixels of a solid at which a nearer object is seen, or would be had anything returned."""
    pixels = np.flatnonzero(is_covered)
    flat = middles.reshape(len(middles), labels.size)
    label, depth, middle = labels.ravel()[pixels], image.depth_m.ravel()[pixels], flat[i, pixels]
    is_before = (label >= 0) & (label != i) & (depth < middle)
    is_missed = ~image.is_return.ravel()[pixels]
    # Where another solid is not, its middle is infinitely far.
    is_before[is_missed] |= (flat[:, pixels[is_missed]] < middle[is_missed]).any(axis=0)
    hidden = np.zeros_like(is_covered)
    hidden.ravel()[pixels] = is_before
    return hidden


def _own(
    i: int, solid: Vessel | Hull, is_covered: PixelMask, labels: Labels, plane: Plane, image: RangeImage
) -> PixelMask:
    """Pixels of an object that are seen, or that nothing returned from."""
    own = (labels == i) | (is_covered & ~image.is_return)
    if isinstance(solid, Vessel):
        low = is_covered & (labels < 0) & image.is_return
        points = plane.table_points(image.points_m[low])
        own[low] = np.abs(solid.outside_m(points)) < OWN_M
    return own


def _hides(silhouettes: Masks, is_behind: Masks, middles: Float[np.ndarray, "N H W"], labels: Labels) -> Hides:
    """Share of each silhouette before which each other object lies, seen there or hidden itself."""
    num_objects = len(silhouettes)
    hides = np.zeros((num_objects, num_objects))
    shown, flat = (each.reshape(num_objects, labels.size) for each in (silhouettes, middles))
    for i in range(num_objects):
        within = np.flatnonzero(silhouettes[i])
        label, is_hidden, middle = labels.ravel()[within], is_behind[i].ravel()[within], flat[i, within]
        for j in range(num_objects):
            if i == j or not len(within):
                continue
            is_other = label == j
            is_inferred = (label != i) & ~is_other & shown[j, within] & (flat[j, within] < middle)
            hides[i, j] = ((is_hidden & is_other) | is_inferred).mean()
    return hides
