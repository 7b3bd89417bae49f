"""The space that arms occupy, as spheres; their reservations; and collisions that still happen."""

# MuJoCo's names come from compiled modules without stubs, which pyright cannot look into.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.spatial import KDTree

from halfseen.arrays import Points
from halfseen.cell.kinematics import Angles, Kinematics, Way
from halfseen.cell.live_cell import LiveCell
from halfseen.cell.model import MountedArm
from halfseen.shapes import Bool, Float

MARGIN_M = 0.04
"""Smallest distance between the spaces of two arms [m]; it covers the hand's motion between path points and the servos'
lag."""
_SPACING_M = 0.04
_TURN_RAD = 0.05  # largest turn of a joint between two path points at which the space is computed
_PART_M, _HELD_M = 0.045, 0.065  # radii of the spheres
_KINDS = mujoco.mjtGeom


@dataclass(frozen=True, eq=False)
class Space:
    """Spheres that cover an arm at each point of a path.

    `middles_m` are the centres of the spheres at each point [m]. Spheres of a held object (`is_held`) are larger.
    """

    places_rad: Way
    middles_m: Float[np.ndarray, "k spheres 3"]
    is_held: Bool[np.ndarray, " spheres"]

    def after(self, first: int) -> "Space":
        """The space from path point `first` on."""
        return Space(self.places_rad[first:], self.middles_m[first:], self.is_held)

    def joined(self, other: "Space") -> "Space":
        """Union with another space of the same arm with the same held object."""
        return Space(
            np.concatenate([self.places_rad, other.places_rad]),
            np.concatenate([self.middles_m, other.middles_m]),
            self.is_held,
        )

    def meets(self, other: "Space", margin_m: float = MARGIN_M) -> bool:
        """Whether the spaces of two arms are closer than a margin."""
        for mine, radius_m in self._parts():
            tree = KDTree(mine)
            for its, its_radius_m in other._parts():
                reach_m = radius_m + its_radius_m + margin_m
                apart_m, _ = tree.query(its, distance_upper_bound=reach_m)
                if np.isfinite(apart_m).any():
                    return True
        return False

    def _parts(self) -> list[tuple[Points, float]]:
        parts = [(self.middles_m[:, ~self.is_held], _PART_M), (self.middles_m[:, self.is_held], _HELD_M)]
        return [(middles_m.reshape(-1, 3), radius_m) for middles_m, radius_m in parts if middles_m.size]


class Outline:
    """Computes the space of one arm."""

    def __init__(self, model: mujoco.MjModel, robot: MountedArm) -> None:
        self._kinematics = Kinematics(model, robot)
        for name in robot.slide_names:
            self._kinematics.data.joint(name).qpos = 0.5 * robot.gripper.stroke_m
        geoms = np.flatnonzero(np.isin(model.geom_bodyid, robot.bodies(model))).tolist()
        parts = [_spheres_m(model, geom) for geom in geoms]
        self._geom = np.repeat(geoms, [len(part) for part in parts])
        self._local_m = np.concatenate(parts)

    def along(self, begin_rad: Angles, way: Way, below_m: float = 0.0) -> Space:
        """Compute the space of a path.

        Parameters
        ----------
        way
            Joint angles along the path [rad]; empty for the space of a still arm.
        below_m
            How far the held object reaches below the hand [m]; 0 for an empty hand.
        """
        places = _places(begin_rad, way)
        held_m = np.zeros((0, 3))
        if below_m > 0:
            depths_m = np.linspace(0.0, max(below_m - 0.5 * _HELD_M, 0.0), 1 + int(np.ceil(below_m / _SPACING_M)))
            held_m = np.stack([0.0 * depths_m, 0.0 * depths_m, -depths_m], axis=1)
        middles_m, data = np.empty((len(places), len(self._geom) + len(held_m), 3)), self._kinematics.data
        for row, angles in zip(middles_m, places, strict=True):
            self._kinematics.place(angles)
            turned = data.geom_xmat[self._geom].reshape(-1, 3, 3)
            row[: len(self._geom)] = np.einsum("nij,nj->ni", turned, self._local_m) + data.geom_xpos[self._geom]
            row[len(self._geom) :] = self._kinematics.tcp.xpos + held_m
        is_held = np.arange(middles_m.shape[1]) >= len(self._geom)
        return Space(places, middles_m, is_held)


def _places(begin_rad: Angles, way: Way) -> Float[np.ndarray, "places J"]:
    """Path points no farther apart than a small turn of a joint."""
    places, here = [begin_rad], begin_rad
    for there in way:
        num = max(1, int(np.ceil(float(np.abs(there - here).max()) / _TURN_RAD)))
        places += [here + (there - here) * step / num for step in range(1, num + 1)]
        here = there
    return np.array(places)


def _spheres_m(model: mujoco.MjModel, geom: int) -> Points:
    """Centres of the spheres that cover a part, in its own frame [m]."""
    kind, size, half_m = _KINDS(int(model.geom_type[geom])), model.geom_size[geom], model.geom_aabb[geom, 3:]
    if kind in (_KINDS.mjGEOM_CAPSULE, _KINDS.mjGEOM_CYLINDER):
        half_m = [0.0, 0.0, size[1]]
    elif kind == _KINDS.mjGEOM_SPHERE:
        half_m = [0.0, 0.0, 0.0]
    lines = [_line(float(half)) for half in half_m]
    return np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)


def _line(half_m: float) -> Float[np.ndarray, " n"]:
    """Sphere centres along one side; a side thinner than a sphere takes one."""
    if half_m < 0.5 * _PART_M:
        return np.zeros(1)
    return np.linspace(-half_m, half_m, 1 + int(np.ceil(2 * half_m / _SPACING_M)))


class Reservations:
    """The spaces that arms have reserved in a cell."""

    def __init__(self, cell: LiveCell, robots: Sequence[MountedArm]) -> None:
        self._cell, self._robots = cell, robots
        self._outlines = [Outline(cell.model, robot) for robot in robots]
        self._reserved: list[Space | None] = [None for _ in robots]
        self._passed = [0 for _ in robots]
        self._below_m = [0.0 for _ in robots]

    def space(self, arm: int, way: Way, below_m: float) -> Space:
        """Space of a path from an arm's current angles; `way` and `below_m` as for `Outline.along`."""
        return self._outlines[arm].along(self._cell.angles_rad(self._robots[arm]), way, below_m)

    def taken(self, arm: int) -> Space:
        """Space held by an arm: its current position and the rest of its path."""
        here_rad = self._cell.angles_rad(self._robots[arm])
        here = self._outlines[arm].along(here_rad, np.zeros((0, len(here_rad))), self._below_m[arm])
        reserved = self._reserved[arm]
        # The arm may lag one path point behind its servo commands.
        return here if reserved is None else here.joined(reserved.after(max(self._passed[arm] - 1, 0)))

    def in_the_way(self, arm: int, space: Space) -> tuple[int, ...]:
        """Other arms whose space meets the space that an arm requests."""
        others = (other for other in range(len(self._robots)) if other != arm)
        return tuple(other for other in others if self.taken(other).meets(space))

    def reserve(self, arm: int, space: Space, below_m: float) -> None:
        """Reserve the space of a path for an arm, in place of its earlier reservation."""
        self._reserved[arm], self._passed[arm], self._below_m[arm] = space, 0, below_m

    def let_go(self, arm: int) -> None:
        """Release all of an arm's space except its current position."""
        self._reserved[arm], self._below_m[arm] = None, 0.0

    def stand(self, arm: int) -> None:
        """Release an arm's path, but not the space of its held object."""
        self._reserved[arm] = None

    def advance(self, arm: int, angles_rad: Angles) -> None:
        """Release the path behind an arm, up to the angles commanded to its servos."""
        reserved = self._reserved[arm]
        if reserved is None:
            return
        places, at = reserved.places_rad, self._passed[arm]
        while at + 1 < len(places) and _apart(places[at + 1], angles_rad) <= _apart(places[at], angles_rad):
            at += 1
        self._passed[arm] = at


def _apart(place: Angles, angles_rad: Angles) -> float:
    return float(np.abs(place - angles_rad).max())


_FREE = -1


class Touches:
    """Counts collisions of arms in a running cell; a `halfseen.cell.live_cell.Watch`.

    A collision is a contact between two arms, between an arm and another's held object, or between two held objects. It
    lasts as long as the contact; `begun_s` are the start times [s]. An arm holds a cup if both its fingers touch it.
    """

    def __init__(self, cell: LiveCell, robots: Sequence[MountedArm]) -> None:
        model = cell.model
        self._arm_of_body = np.full(model.nbody, _FREE)
        self._fingers: list[tuple[int, int]] = []
        for number, robot in enumerate(robots):
            self._arm_of_body[robot.bodies(model)] = number
            left, right = (model.body(robot.of(f"gripper/finger_{side}")).id for side in ("left", "right"))
            self._fingers.append((left, right))
        self._touching: frozenset[tuple[int, int]] = frozenset()
        self.begun_s: list[float] = []

    @property
    def num_collisions(self) -> int:
        """Number of collisions so far."""
        return len(self.begun_s)

    def __call__(self, cell: LiveCell) -> None:
        """Check for new collisions."""
        now = self._pairs(cell)
        self.begun_s += [cell.time_s] * len(now - self._touching)
        self._touching = now

    def _pairs(self, cell: LiveCell) -> frozenset[tuple[int, int]]:
        if not cell.data.ncon:
            return frozenset()
        bodies = cell.model.geom_bodyid[cell.data.contact.geom]
        owner = self._arm_of_body.copy()
        for number, fingers in enumerate(self._fingers):
            by_finger = [set(bodies[(bodies == finger).any(axis=1)].ravel().tolist()) for finger in fingers]
            for body in by_finger[0] & by_finger[1]:
                if 0 < body <= cell.num_cups:
                    owner[body] = number
        first, second = owner[bodies].T
        is_met = (first != second) & (first != _FREE) & (second != _FREE)
        pairs = np.sort(np.stack([first[is_met], second[is_met]], axis=1), axis=1)
        return frozenset((int(one), int(other)) for one, other in pairs)
