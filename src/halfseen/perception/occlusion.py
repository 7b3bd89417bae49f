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
    num_objects, shape = len(solids), labels.shape
    silhouettes = np.zeros((num_objects, *shape), dtype=bool)
    is_behind = np.zeros((num_objects, *shape), dtype=bool)
    middles = np.empty((num_objects, *shape))
    for i, solid in enumerate(solids):
        # NaN depths, where nothing returned, are not nearer.
        is_covered = covered(solid, plane, image)
        middles[i] = middle_depth_m(solid, plane, image, is_covered)
        own, hidden = _parts(i, solid, is_covered & (image.depth_m < middles[i]), is_covered, labels, plane, image)
        silhouettes[i] = own | hidden
        is_behind[i] = hidden
    size = np.maximum(silhouettes.sum(axis=(1, 2)), 1)
    hides = _hides(silhouettes, is_behind, middles, labels)
    return Occlusion(silhouettes, is_behind.sum(axis=(1, 2)) / size, hides)


def _parts(
    i: int,
    solid: Vessel | Hull,
    is_nearer: PixelMask,
    is_covered: PixelMask,
    labels: Labels,
    plane: Plane,
    image: RangeImage,
) -> tuple[PixelMask, PixelMask]:
    """Pixels of an object's silhouette that nothing hides, and those that a nearer object hides."""
    hidden = is_nearer & (labels >= 0) & (labels != i)
    own = labels == i
    own |= is_covered & ~image.is_return
    if isinstance(solid, Vessel):
        low = is_covered & (labels < 0) & image.is_return
        points = plane.table_points(image.points_m[low])
        own[low] = np.abs(solid.outside_m(points)) < OWN_M
    return own, hidden


def _hides(silhouettes: Masks, is_behind: Masks, middles: Float[np.ndarray, "N H W"], labels: Labels) -> Hides:
    """Share of each silhouette before which each other object lies, seen there or hidden itself."""
    num_objects = len(silhouettes)
    hides = np.zeros((num_objects, num_objects))
    for i in range(num_objects):
        within = silhouettes[i]
        for j in range(num_objects):
            if i == j or not within.any():
                continue
            seen = is_behind[i][within] & (labels[within] == j)
            neither = (labels[within] != i) & (labels[within] != j)
            inferred = neither & silhouettes[j][within] & (middles[j][within] < middles[i][within])
            hides[i, j] = (seen | inferred).mean()
    return hides
