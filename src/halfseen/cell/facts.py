"""What is seen of an object that may make it hard to grip: whether it lies, how wide it is, how much room is around."""

from dataclasses import dataclass

import numpy as np

from halfseen.perception.solids import Hull, Vessel
from halfseen.perception.view import SeenObject, View
from halfseen.shapes import Float

MOST_ROOM_M = 0.10
"""Room beyond this makes no difference [m]."""


@dataclass(frozen=True)
class Facts:
    """Of an object in one view.

    Parameters
    ----------
    is_lying
        Whether it lies on its side.
    width_m
        What a hand that closes around or across it must open [m].
    room_m
        From its side to what stands next to it, at most `MOST_ROOM_M` [m].
    """

    is_lying: bool
    width_m: float
    room_m: float


def facts_of(view: View) -> list[Facts]:
    """Gather what a view tells of each of its objects.

    Parameters
    ----------
    view
        What is seen.
    """
    rotation, shift_m = view.camera_from_table[:3, :3], view.camera_from_table[:3, 3]
    is_object = view.labels >= 0
    across_m = ((view.image.points_m[is_object] - shift_m) @ rotation)[:, :2]
    labels = view.labels[is_object]
    return [_facts(seen, across_m[labels == seen.id], across_m[labels != seen.id]) for seen in view.objects]


def _facts(seen: SeenObject, own_m: Float[np.ndarray, "own 2"], others_m: Float[np.ndarray, "others 2"]) -> Facts:
    width_m = _width_m(seen.solid, own_m)
    away_m = np.linalg.norm(others_m - seen.solid.middle_m[:2], axis=1).min(initial=np.inf)
    return Facts(not seen.is_upright, width_m, float(np.clip(away_m - 0.5 * width_m, 0.0, MOST_ROOM_M)))


def _width_m(solid: Vessel | Hull, own_m: Float[np.ndarray, "own 2"]) -> float:
    if isinstance(solid, Vessel):
        return 2 * max(solid.radius_m + solid.slope * end for end in solid.ends_m)
    narrowest = np.linalg.eigh(np.cov(own_m.T))[1][:, 0]
    low_m, high_m = np.percentile(own_m @ narrowest, [2, 98])
    return float(high_m - low_m)
