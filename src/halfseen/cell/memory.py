"""What a robot knows of the objects on its table, from look to look and attempt to attempt."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from halfseen.arrays import Hides
from halfseen.cell.grasps import Grasp
from halfseen.perception.clouds import Vector
from halfseen.perception.tracking import matched
from halfseen.perception.view import SeenObject, View


@dataclass(eq=False)
class Known:
    """An object that was seen at some time.

    Parameters
    ----------
    middle_m
        Where it was last seen, in the world [m].
    seen
        How it looks in the last view; None where that does not show it.
    is_gone
        Whether the robot put it into the rack.
    tried
        Of each attempt: the occlusion then, and whether it held.
    failed
        Grasps that did not hold, on the table.
    lifts
        Number of times it was lifted.
    """

    middle_m: Vector
    seen: SeenObject | None
    is_gone: bool = False
    tried: list[tuple[float, bool]] = field(default_factory=list)
    failed: list[Grasp] = field(default_factory=list)
    lifts: int = 0


class Memory:
    """The objects, in the order in which they came into view.

    Attributes
    ----------
    objects
        What is known of each.
    doubts
        What the last look left doubtful, a sentence each.
    """

    def __init__(self) -> None:
        self.objects: list[Known] = []
        self.doubts: tuple[str, ...] = ()
        self._hides: Hides = np.zeros((0, 0))

    def update(self, view: View, world_from_table: Float[np.ndarray, "4 4"]) -> None:
        """Take in a look: find again what was there, and add what came into view.

        Parameters
        ----------
        view
            What is seen.
        world_from_table
            Takes homogeneous points of the table into the world [m].
        """
        middles_m = [world_from_table @ [*seen.solid.middle_m, 1.0] for seen in view.objects]
        now_m = np.array(middles_m).reshape(-1, 4)[:, :3]
        here = [known for known in self.objects if not known.is_gone]
        found = matched(np.array([known.middle_m for known in here]).reshape(-1, 3), now_m)
        for known, now in zip(here, found.now.tolist(), strict=True):
            known.seen = None if now < 0 else view.objects[now]
            known.middle_m = known.middle_m if now < 0 else now_m[now]
        self.objects.extend(Known(now_m[k], view.objects[k]) for k in found.new(len(now_m)))
        self.doubts = tuple(
            f"which object is number {self.objects.index(known)} is doubtful: another is nearly as near"
            for known, is_doubtful in zip(here, found.is_doubtful.tolist(), strict=True)
            if is_doubtful
        )
        self._hides = self._hides_of(view)

    @property
    def hides(self) -> Hides:
        """Who hides whom in the last view; what it does not show hides nothing and is hidden by nothing."""
        return self._hides

    def _hides_of(self, view: View) -> Hides:
        number = [-1 if known.seen is None else known.seen.id for known in self.objects]
        is_seen = np.array([n >= 0 for n in number], dtype=bool)
        hides = np.zeros((len(number), len(number)))
        picked = [n for n in number if n >= 0]
        hides[np.ix_(is_seen, is_seen)] = view.hides[np.ix_(picked, picked)]
        return hides
