"""What cuts an attempt short, as in life: it takes too long, something presses too hard, or the camera is lost."""

# MuJoCo's names come from compiled modules without stubs, which pyright cannot look into.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import mujoco
import numpy as np

from halfseen.cell.live_cell import LiveCell

TIME_OUT, EMERGENCY_STOP, SENSOR_LOST = "time-out", "emergency-stop", "sensor-lost"


class StoppedError(Exception):
    """The cell was stopped; its argument is the cause."""


@dataclass(frozen=True)
class Stops:
    """When the cell stops.

    Parameters
    ----------
    limit_s
        Longest time of an attempt, until it is known whether it holds [s].
    force_n
        Largest force of a contact of the robot [N].
    camera_lost_per_s
        Rate at which the camera is lost [1/s].
    """

    limit_s: float = 9.5
    force_n: float = 100.0
    camera_lost_per_s: float = 1 / 400


class Guard:
    """Watches a running cell and stops it; a `halfseen.cell.live_cell.Watch`.

    Parameters
    ----------
    stops
        When.
    now_s
        The cell's clock [s].
    rng
        Draws when the camera is lost.
    """

    def __init__(self, stops: Stops, now_s: float, rng: np.random.Generator) -> None:
        self.stops = stops
        self._begun_s: list[float] = []
        self._lost_s = now_s + float(rng.exponential()) / stops.camera_lost_per_s if stops.camera_lost_per_s else np.inf

    @contextmanager
    def timing(self, begun_s: float) -> Iterator[None]:
        """Time an attempt that began at some time [s]; several robots may be at one each."""
        self._begun_s.append(begun_s)
        yield
        self._begun_s.remove(begun_s)

    def __call__(self, cell: LiveCell) -> None:
        """Look whether something stops it.

        Raises
        ------
        StoppedError
            With the cause.
        """
        if cell.time_s > self._lost_s:
            raise StoppedError(SENSOR_LOST)
        if any(cell.time_s - begun_s > self.stops.limit_s for begun_s in self._begun_s):
            raise StoppedError(TIME_OUT)
        if largest_force_n(cell) > self.stops.force_n:
            raise StoppedError(EMERGENCY_STOP)


def largest_force_n(cell: LiveCell) -> float:
    """Largest force of a contact of a robot with anything: a cup, furniture, or another robot [N].

    Parameters
    ----------
    cell
        The running cell.
    """
    model, data = cell.model, cell.data
    if not data.ncon:
        return 0.0
    is_robot = model.geom_bodyid[data.contact.geom] > cell.num_cups
    force, largest = np.zeros(6), 0.0
    for contact in np.flatnonzero(is_robot.any(axis=1)).tolist():
        mujoco.mj_contactForce(model, data, contact, force)
        largest = max(largest, float(np.linalg.norm(force[:3])))
    return largest
