"""Who has which space: where each arm is, and its way still to come."""

from collections.abc import Sequence

import numpy as np

from halfseen.cell.kinematics import Angles
from halfseen.cell.live_cell import LiveCell
from halfseen.cell.model import Robot
from halfseen.cell.motion import Way
from halfseen.cell.several.volumes import Outline, Space


class Reservations:
    """The spaces that arms have reserved in a cell.

    Parameters
    ----------
    cell
        The running cell.
    robots
        The arms in it.
    """

    def __init__(self, cell: LiveCell, robots: Sequence[Robot]) -> None:
        self._cell, self._robots = cell, robots
        self._outlines = [Outline(cell.model, robot) for robot in robots]
        self._reserved: list[Space | None] = [None for _ in robots]
        self._passed = [0 for _ in robots]
        self._below_m = [0.0 for _ in robots]

    def space(self, arm: int, way: Way, below_m: float) -> Space:
        """Space of a way from where an arm is; `way` and `below_m` are those of `Outline.along`."""
        return self._outlines[arm].along(self._cell.angles_rad(self._robots[arm]), way, below_m)

    def taken(self, arm: int) -> Space:
        """What an arm has: where it is, and what is left of its way."""
        here_rad = self._cell.angles_rad(self._robots[arm])
        here = self._outlines[arm].along(here_rad, np.zeros((0, len(here_rad))), self._below_m[arm])
        reserved = self._reserved[arm]
        # It may be a place behind where its servos are told to be.
        return here if reserved is None else here.joined(reserved.after(max(self._passed[arm] - 1, 0)))

    def in_the_way(self, arm: int, space: Space) -> tuple[int, ...]:
        """Which other arms have space that one would need."""
        others = (other for other in range(len(self._robots)) if other != arm)
        return tuple(other for other in others if self.taken(other).meets(space))

    def reserve(self, arm: int, space: Space, below_m: float) -> None:
        """Give an arm the space of a way, instead of what it had."""
        self._reserved[arm], self._passed[arm], self._below_m[arm] = space, 0, below_m

    def let_go(self, arm: int) -> None:
        """Take from an arm all but where it is."""
        self._reserved[arm], self._below_m[arm] = None, 0.0

    def stand(self, arm: int) -> None:
        """Take from an arm its way; what it holds stays."""
        self._reserved[arm] = None

    def advance(self, arm: int, angles_rad: Angles) -> None:
        """Free what lies behind an arm, once its servos are told to be somewhere on its way."""
        reserved = self._reserved[arm]
        if reserved is None:
            return
        places, at = reserved.places_rad, self._passed[arm]
        while at + 1 < len(places) and _apart(places[at + 1], angles_rad) <= _apart(places[at], angles_rad):
            at += 1
        self._passed[arm] = at


def _apart(place: Angles, angles_rad: Angles) -> float:
    return float(np.abs(place - angles_rad).max())
