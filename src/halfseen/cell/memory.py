"""A robot's memory of the objects on its table across looks and attempts.

The memory assumes no model of seeing. It keeps labels as looks gave them; a belief turns them into probabilities.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from halfseen.arrays import Hides, Points, Transform
from halfseen.cell.facts import Facts, facts_of
from halfseen.cell.grasps import Grasp
from halfseen.perception.clouds import Vector
from halfseen.perception.occlusion import NEAREST_M, projected
from halfseen.perception.tracking import matched
from halfseen.perception.view import SeenObject, View

SAME_DEPTH_M = 0.015
"""Depths that differ by less count as equal [m]: depths have errors, and cups stand within millimetres."""
MOSTLY = 0.5
"""An object has vanished if this share of its former surface pixels return, and this share of those are evidence."""


def has_vanished(surface_m: Points, view: View) -> bool:
    """Whether a view sees past an object's former place, or sees another object there.

    Pixels occluded by something in front, and pixels without return, are no evidence.

    Parameters
    ----------
    surface_m
        Visible surface points of the object, in the frame of the image's camera [m].
    """
    before, (num_rows, num_columns) = surface_m[surface_m[:, 2] > NEAREST_M], view.image.depth_m.shape
    columns, rows = np.rint(projected(before, view.image)).astype(np.int64).T
    is_inside = (columns >= 0) & (columns < num_columns) & (rows >= 0) & (rows < num_rows)
    at = rows[is_inside], columns[is_inside]
    farther_m = view.image.depth_m[at] - before[is_inside, 2]
    is_past, is_taken = farther_m > SAME_DEPTH_M, (np.abs(farther_m) <= SAME_DEPTH_M) & (view.labels[at] >= 0)
    num_returns = np.count_nonzero(np.isfinite(farther_m))
    is_enough = num_returns > MOSTLY * len(surface_m)
    return bool(is_enough and np.count_nonzero(is_past | is_taken) > MOSTLY * num_returns)


MORE_IN_VIEW = 0.02
"""A look shows more of an object if its hidden share is smaller by this than in every earlier look."""
SAME_PLACE_M = 0.03
"""A new object closer than this to the place of a lost one is taken for the lost one [m]."""


class Glance(NamedTuple):
    """One label of an object, from a look that showed more of it than any before.

    `occlusion` is its hidden share in that look; 0 if it was held and turned in front of the camera (`is_held`).
    """

    occlusion: float
    is_held: bool
    says_dirty: bool


class Trial(NamedTuple):
    """One attempt on an object: its occlusion, whether the grasp held, the time until then [s], and the arm."""

    occlusion: float
    is_held: bool
    duration_s: float
    arm: int = 0


class Sighting(NamedTuple):
    """An object as a look showed it, the view from that look, and the transform of its table to the world."""

    seen: SeenObject
    view: View
    world_from_table: Transform


@dataclass(eq=False)
class KnownObject:
    """A known object.

    `middle_m` [m], `facts` and `surface_m`, points in the world [m], are from its last `sighting`. `seen` is its
    appearance in the last view, None if that does not show it. `is_lost` is set if a look found it vanished: it fell,
    or was never a separate object; it can reappear only at the same place. `glances` are labels from looks that showed
    more than any before, and `trials` are attempts, oldest first. `failed` are failed grasps, in table coordinates.
    """

    middle_m: Vector
    seen: SeenObject | None
    facts: Facts
    surface_m: Points = field(default_factory=lambda: np.zeros((0, 3)))
    sighting: Sighting | None = None
    is_racked: bool = False
    is_lost: bool = False
    glances: list[Glance] = field(default_factory=list)
    trials: list[Trial] = field(default_factory=list)
    failed: list[Grasp] = field(default_factory=list)
    lifts: int = 0

    @property
    def is_gone(self) -> bool:
        """Whether it is no longer on the table, as far as the robot knows."""
        return self.is_racked or self.is_lost

    def see(self, now: "KnownObject | None") -> None:
        """Update from its appearance in the last view; None if that does not show it."""
        self.seen = None if now is None else now.seen
        if now is not None:
            self.middle_m, self.facts, self.surface_m = now.middle_m, now.facts, now.surface_m
            self.sighting = now.sighting

    def label(self, occlusion: float, says_dirty: bool, *, is_held: bool) -> None:
        """Keep the label of a look if it showed more than any before; otherwise the label would repeat evidence.

        `occlusion` is the hidden share of the object. If `is_held`, the object was turned in front of the camera and
        seen from all sides.
        """
        was_held = any(glance.is_held for glance in self.glances)
        least = min((glance.occlusion for glance in self.glances), default=2.0)
        if not was_held and (is_held or occlusion < least - MORE_IN_VIEW):
            self.glances.append(Glance(occlusion, is_held, says_dirty))


class Memory:
    """The known objects, in the order in which they came into view.

    Attributes
    ----------
    objects
        The known objects.
    hides
        ``hides[i, j]`` is the share of object i that object j alone hid in the last view that showed both; 0 before.
    doubts
        Ambiguities of the last view, one sentence each.
    world_from_table
        Transform of homogeneous points from the last view's table to the world [m].
    """

    def __init__(self) -> None:
        self.objects: list[KnownObject] = []
        self.world_from_table: Transform = np.eye(4)
        self.hides: Hides = np.zeros((0, 0))
        self.doubts: tuple[str, ...] = ()

    def update(self, view: View, world_from_table: Transform, in_hand: Sequence[KnownObject] = ()) -> None:
        """Update from a view: match known objects, mark vanished ones as lost, and add new ones.

        Parameters
        ----------
        view
            The new view.
        world_from_table
            Transform of homogeneous points from the table to the world [m].
        in_hand
            Objects that are in a hand, so not on the table.
        """
        self.world_from_table = world_from_table
        camera = world_from_table @ np.linalg.inv(view.camera_from_table)
        now = _objects_of(view, world_from_table, camera)
        now_m = _middles_m(now)
        here = [known for known in self.objects if not known.is_gone and known not in in_hand]
        found = matched(_middles_m(here), now_m)
        self.doubts = tuple(
            f"the match of object {self.objects.index(known)} is ambiguous: another object is nearly as near"
            for known, is_doubtful in zip(here, found.is_doubtful.tolist(), strict=True)
            if is_doubtful
        )
        lost, new = [known for known in self.objects if known.is_lost], found.new(len(now))
        back = matched(_middles_m(lost), now_m[new], SAME_PLACE_M)
        for known, k in zip(here, found.now.tolist(), strict=True):
            known.see(now[k] if k >= 0 else None)
            known.is_lost = k < 0 and has_vanished((known.surface_m - camera[:3, 3]) @ camera[:3, :3], view)
        for known, k in zip(lost, back.now.tolist(), strict=True):
            known.see(now[new[k]] if k >= 0 else None)
            known.is_lost = k < 0
        for known in in_hand:
            known.see(None)
        self.objects.extend(now[new[k]] for k in back.new(len(new)))
        self.hides = self._hides_in(view)

    def _hides_in(self, view: View) -> Hides:
        number = [-1 if known.seen is None else known.seen.id for known in self.objects]
        is_seen = np.array([n >= 0 for n in number], dtype=bool)
        hides = np.zeros((len(number), len(number)))
        hides[: len(self.hides), : len(self.hides)] = self.hides
        is_gone = np.array([known.is_gone for known in self.objects], dtype=bool)
        hides[is_gone], hides[:, is_gone] = 0.0, 0.0
        picked = [n for n in number if n >= 0]
        hides[np.ix_(is_seen, is_seen)] = view.hides[np.ix_(picked, picked)]
        return hides

    def occlusion(self, number: int, in_hand: Sequence[KnownObject] = ()) -> float:
        """Hidden share of an object, as in states: 1 − Π_j (1 − hides[i, j]); objects in a hand hide nothing."""
        is_hiding = np.array([known not in in_hand for known in self.objects], dtype=bool)
        return float(1.0 - np.prod(1.0 - self.hides[number], where=is_hiding))

    def places_m(self) -> Points:
        """Last known position of each object on the table: right, away from the camera, and up [m]."""
        middles_m = np.array([known.middle_m for known in self.objects]).reshape(-1, 3)
        turned, moved_m = self.world_from_table[:3, :3], self.world_from_table[:3, 3]
        return (middles_m - moved_m) @ turned

    def number_of(self, seen_id: int) -> int | None:
        """Number of the object with this id in the last view; None if there is none."""
        numbers = [k for k, known in enumerate(self.objects) if known.seen is not None and known.seen.id == seen_id]
        return numbers[0] if numbers else None


def _objects_of(view: View, world_from_table: Transform, world_from_camera: Transform) -> list[KnownObject]:
    """The objects of a view as new known objects."""
    points_m, turned, moved_m = view.image.points_m.reshape(-1, 3), world_from_camera[:3, :3], world_from_camera[:3, 3]
    middles_m = [(world_from_table @ [*seen.solid.middle_m, 1.0])[:3] for seen in view.objects]
    surfaces_m = [points_m[seen.pixels] @ turned.T + moved_m for seen in view.objects]
    sightings = [Sighting(seen, view, world_from_table) for seen in view.objects]
    known = zip(middles_m, view.objects, facts_of(view), surfaces_m, sightings, strict=True)
    return [KnownObject(*each) for each in known]


def _middles_m(objects: list[KnownObject]) -> Points:
    return np.array([known.middle_m for known in objects]).reshape(-1, 3)
