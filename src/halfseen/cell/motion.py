"""Ways of a hand: straight lines as angles of the joints, and when to be where at the speeds that the joints allow."""

from dataclasses import dataclass

import numpy as np

from halfseen.cell.kinematics import Angles, Kinematics
from halfseen.errors import PlanError
from halfseen.scene.poses import Pose
from halfseen.shapes import Float

Way = Float[np.ndarray, "k J"]

STEP_M = 0.02
"""Between two places of a line at which angles are sought."""
_LARGEST_TURN_RAD = 0.6  # of a joint, between two such places: more is another way to hold the arm, not a line
_RAMP_S = 0.25


def line(kinematics: Kinematics, begin_rad: Angles, begin: Pose, end_m: Float[np.ndarray, " 3"]) -> Way:
    """Move the hand on a straight line, without turning it.

    Parameters
    ----------
    kinematics
        Of the robot.
    begin_rad
        Angles at the beginning.
    begin
        Pose of the hand there.
    end_m
        Where the hand is to go [m].

    Returns
    -------
    Float[ndarray, "k J"]
        Angles on the way, the last at its end; those of the beginning are left out.

    Raises
    ------
    PlanError
        The line leaves the reach, or the arm would have to fold over; the message says where.
    """
    here_m = np.asarray(begin.position_m)
    num_steps = max(1, int(np.ceil(np.linalg.norm(end_m - here_m) / STEP_M)))
    way, angles = [], begin_rad
    for step in range(1, num_steps + 1):
        x_m, y_m, z_m = (float(value) for value in here_m + (end_m - here_m) * step / num_steps)
        found = kinematics.solve(Pose((x_m, y_m, z_m), begin.quaternion), angles, num_steps=40)
        if found is None or np.abs(found - angles).max() > _LARGEST_TURN_RAD:
            trouble = "is out of reach" if found is None else "would need the arm folded over"
            raise PlanError(
                f"the line to ({end_m[0]:.3f}, {end_m[1]:.3f}, {end_m[2]:.3f}) m breaks off at ({x_m:.3f}, {y_m:.3f}, "
                f"{z_m:.3f}) m, which {trouble}; come from another side"
            )
        way.append(found)
        angles = found
    return np.array(way)


@dataclass(frozen=True)
class Schedule:
    """Angles by time: from rest to rest along a way.

    Parameters
    ----------
    reached_s
        When each place of the way would be reached without ramps [s], from 0.
    way_rad
        The places, the first among them.
    ramp_s
        How long it takes to reach full speed, and to stop [s].
    """

    reached_s: Float[np.ndarray, " k"]
    way_rad: Way
    ramp_s: float = _RAMP_S

    @property
    def duration_s(self) -> float:
        """How long it takes [s]."""
        return float(self.reached_s[-1]) + self.ramp_s

    def at(self, times_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n J"]:
        """Angles at times from the beginning [s]: full speed between two ramps of constant acceleration."""
        full_s, ramp_s = float(self.reached_s[-1]), self.ramp_s
        starting_s = 0.5 * times_s**2 / ramp_s
        stopping_s = full_s - 0.5 * np.maximum(0.0, full_s + ramp_s - times_s) ** 2 / ramp_s
        along_s = np.where(times_s < ramp_s, starting_s, np.where(times_s < full_s, times_s - 0.5 * ramp_s, stopping_s))
        along_s = np.clip(along_s, 0.0, full_s)
        return np.stack([np.interp(along_s, self.reached_s, joint) for joint in self.way_rad.T], axis=1)


def schedule(begin_rad: Angles, way: Way, speeds_rad_s: Angles) -> Schedule:
    """Go along a way as fast as its slowest joint allows.

    Parameters
    ----------
    begin_rad
        Where the joints are.
    way
        Where they are to go.
    speeds_rad_s
        Largest speed of each joint [rad/s].
    """
    places = np.concatenate([begin_rad[None], way])
    legs_s = (np.abs(np.diff(places, axis=0)) / speeds_rad_s).max(axis=1)
    # A ramp up and one down fit into what is at least as long as one of them.
    stretched = legs_s * max(1.0, _RAMP_S / max(float(legs_s.sum()), 1e-9))
    return Schedule(np.concatenate([[0.0], np.cumsum(stretched)]), places)
