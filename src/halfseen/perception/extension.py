"""Hidden ends of vessels: a cup whose mouth is behind another is as long as cups are, as far as the image allows."""

from dataclasses import replace

from halfseen.perception.objects import Labels
from halfseen.perception.plane import Plane
from halfseen.perception.range_image import PixelMask, RangeImage
from halfseen.perception.silhouette import covered, middle_depth_m
from halfseen.perception.solids import Vessel

# Lengths of cups and cans from underside to rim [m], and the largest length in radii.
SHORTEST_M, LONGEST_M = 0.07, 0.15
LONGEST_IN_RADII = 3.6
# An end is prolonged in steps of this length [m] ...
STEP_M = 0.005
# ... while at least this share of what a step adds to the picture lies behind a nearer object.
HIDDEN_SHARE = 0.6


def extended(i: int, vessel: Vessel, labels: Labels, plane: Plane, image: RangeImage) -> Vessel:
    """Prolong the ends of a vessel that nearer objects hide.

    The length that a vessel probably has, when all that is known is that it is no shorter than what is seen, is half
    way between what is seen and the longest usual. An end goes on up to there, and stops where something behind it
    shows.

    Parameters
    ----------
    i
        Its label.
    vessel
        Its walls, as far as they are seen.
    labels
        Object of each pixel; −1 where there is none.
    plane, image
        The table and what the camera sees.
    """
    seen = vessel.ends_m[1] - vessel.ends_m[0]
    longest = min(LONGEST_M, LONGEST_IN_RADII * vessel.radius_m)
    probable = (max(seen, SHORTEST_M) + longest) / 2
    num_steps = int((probable - seen) / STEP_M)
    if num_steps < 1:
        return vessel
    is_other = (labels >= 0) & (labels != i)
    # The foot of a standing vessel is on the table and is never prolonged.
    is_open = [not vessel.is_upright, True]
    is_known = labels == i
    for step in range(num_steps):
        ends = [end for end in (0, 1) if is_open[end]]
        for end in sorted(ends, key=lambda end: end != step % 2):
            longer = _prolonged(vessel, end)
            is_open[end] = _is_behind(longer, vessel, is_other, is_known, plane, image)
            if is_open[end]:
                vessel = longer
                break
    return vessel


def _prolonged(vessel: Vessel, end: int) -> Vessel:
    low, high = vessel.ends_m
    return replace(vessel, ends_m=(low, high + STEP_M) if end else (low - STEP_M, high))


def _is_behind(
    longer: Vessel, vessel: Vessel, is_other: PixelMask, is_known: PixelMask, plane: Plane, image: RangeImage
) -> bool:
    """Whether what a step adds to the picture is behind something nearer."""
    added = covered(longer, plane, image) & ~covered(vessel, plane, image) & ~is_known
    if not added.any():
        return False
    is_hiding = added & is_other & (image.depth_m < middle_depth_m(longer, plane, image, added))
    return bool(is_hiding[added].mean() >= HIDDEN_SHARE)
