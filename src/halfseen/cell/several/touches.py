"""What must not happen: arms, or what they hold, that touch."""

# MuJoCo's names come from compiled modules without stubs, which pyright cannot look into.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Sequence

import numpy as np

from halfseen.cell.live_cell import LiveCell
from halfseen.cell.model import Robot

_FREE = -1


class Touches:
    """Counts collisions of arms in a running cell; a `halfseen.cell.live_cell.Watch`.

    A collision is a contact of two arms, of an arm with what another holds, or of what two of them hold, and lasts for
    as long as they go on touching. What an arm holds is what both its fingers touch.

    Parameters
    ----------
    cell
        The running cell.
    robots
        The arms in it.

    Attributes
    ----------
    num_collisions
        So far.
    begun_s
        When each began, on the cell's clock [s].
    """

    def __init__(self, cell: LiveCell, robots: Sequence[Robot]) -> None:
        model = cell.model
        self._arm_of_body = np.full(model.nbody, _FREE)
        self._fingers: list[tuple[int, int]] = []
        for number, robot in enumerate(robots):
            for body in range(model.nbody):
                if model.body(body).name.startswith(robot.of("")):
                    self._arm_of_body[body] = number
            left, right = (model.body(robot.of(f"gripper/finger_{side}")).id for side in ("left", "right"))
            self._fingers.append((left, right))
        self._touching: frozenset[tuple[int, int]] = frozenset()
        self.begun_s: list[float] = []

    @property
    def num_collisions(self) -> int:
        """How many there were."""
        return len(self.begun_s)

    def __call__(self, cell: LiveCell) -> None:
        """Look whether arms touch."""
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
