"""What is seen of an object that may make it hard to grip: whether it lies, how wide it is, how much room is around."""

from dataclasses import dataclass

import numpy as np

from halfseen.cell.clearance import Surroundings
from halfseen.perception.solids import Vessel
from halfseen.perception.view import SeenObject

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


def facts_of(seen: SeenObject, around: Surroundings) -> Facts:
    """Gather what a view tells of an object.

    Parameters
    ----------
    seen
        The object.
    around
        What the view shows of it and around it.
    """
    width_m = _width_m(seen, around)
    away_m = np.linalg.norm(around.other_m[:, :2] - seen.solid.middle_m[:2], axis=1)
    room_m = float(away_m.min(initial=np.inf)) - 0.5 * width_m
    return Facts(not seen.is_upright, width_m, float(np.clip(room_m, 0.0, MOST_ROOM_M)))


def _width_m(seen: SeenObject, around: Surroundings) -> float:
    if isinstance(seen.solid, Vessel):
        return 2 * max(seen.solid.radius_m + seen.solid.slope * end for end in seen.solid.ends_m)
    spread = np.cov(around.own_m[:, :2].T)
    across_m = around.own_m[:, :2] @ np.linalg.eigh(spread)[1][:, 0]
    low_m, high_m = np.percentile(across_m, [2, 98])
    return float(high_m - low_m)
