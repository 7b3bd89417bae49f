"""Hidden ends of vessels: a cup whose mouth is behind another is as long as cups are, as far as the image allows."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial

import numpy as np

from halfseen.perception.objects import Labels
from halfseen.perception.plane import Plane
from halfseen.perception.range_image import Pixels, RangeImage
from halfseen.perception.silhouette import covered, middle_depth_m
from halfseen.perception.solids import Vessel

# Lengths of cups and cans from underside to rim [m], and the largest length in radii.
SHORTEST_M, LONGEST_M = 0.07, 0.15
LONGEST_IN_RADII = 3.6
# An end is prolonged in steps of this length [m] ...
STEP_M = 0.005
# ... until this share of what a step adds to the picture shows something behind it.
CONTRADICTION_SHARE = 0.4
# Shadow beside an end is no evidence of its own: this share of all that is added must lie behind a nearer object.
HIDDEN_SHARE = 0.3


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
    own = cache(partial(covered, vessel, plane, image))
    rooms = [
        0 if vessel.is_upright else _room(i, vessel, 0, num_steps, own, labels, plane, image),
        _room(i, vessel, 1, num_steps, own, labels, plane, image),
    ]
    # Both ends share what is missing; what one has no room for, the other takes.
    first = min(rooms[0], max(num_steps // 2, num_steps - rooms[1]))
    return _prolonged(_prolonged(vessel, 0, first), 1, min(rooms[1], num_steps - first))


def _prolonged(vessel: Vessel, end: int, num_steps: int) -> Vessel:
    low, high = vessel.ends_m
    more = num_steps * STEP_M
    return replace(vessel, ends_m=(low, high + more) if end else (low - more, high))


def _room(
    i: int,
    vessel: Vessel,
    end: int,
    num_steps: int,
    own: Callable[[], Pixels],
    labels: Labels,
    plane: Plane,
    image: RangeImage,
) -> int:
    """How many steps an end can go on; the foot of a standing vessel is on the table and never does."""
    longest = _prolonged(vessel, end, num_steps)
    asked = covered(longest, plane, image)
    label, depth_m = labels.ravel()[asked], image.depth_m.ravel()[asked]
    hiding = (label >= 0) & (label != i) & (depth_m < middle_depth_m(longest, plane, image, asked))
    if not hiding.any():
        return 0
    is_hiding, is_against, is_before, is_added = np.zeros((4, labels.size), dtype=bool)
    is_hiding[asked] = hiding
    is_against[asked] = np.isfinite(depth_m) & (label != i) & ~hiding
    is_before[own()] = True
    room = 0
    for step in range(1, num_steps + 1):
        after = covered(_prolonged(vessel, end, step), plane, image) if step < num_steps else asked
        added = after[~is_before[after]]
        if len(added) and is_against[added].mean() > CONTRADICTION_SHARE:
            break
        room = step
        is_before[:] = False
        is_before[after] = True
        is_added[added[labels.ravel()[added] != i]] = True
    return room if is_added.any() and is_hiding[is_added].mean() > HIDDEN_SHARE else 0
