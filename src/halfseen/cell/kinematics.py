"""Forward kinematics, inverse kinematics (damped least squares), and straight lines with time parametrisation.

A step from angles q with error e (position [m], and rotation [rad] times a length) is

    Δq = Jᵀ (J Jᵀ + μ² I)⁻¹ e,

with the geometric Jacobian J and a damping μ that decreases with the error, so that the search approaches a pose out of
reach and converges to one within reach [NakamuraHanafusa1986]_ [Sugihara2011]_.
"""

# MuJoCo's names come from compiled modules without stubs, which pyright cannot look into.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Iterable
from dataclasses import dataclass
from math import pi

import mujoco
import numpy as np

from halfseen.cell.model import MountedArm
from halfseen.errors import PlanError
from halfseen.scene.poses import Pose, pose_of
from halfseen.shapes import Bool, Float

Angles = Float[np.ndarray, " J"]

NEAR_M, NEAR_RAD = 5e-4, 2e-3  # tolerance of a pose
_LEVER_M = 0.3  # weight of a rotation error relative to a position error
_DAMPING = 0.03
_LARGEST_STEP_RAD = 0.4


def in_metres(point_m: Iterable[float]) -> str:
    """Write a point to the millimetre [m]."""
    return f"({', '.join(f'{value:.3f}' for value in point_m)}) m"


class Kinematics:
    """Forward and inverse kinematics of one robot of a cell.

    Parameters
    ----------
    model
        The cell.
    robot
        The robot.

    Attributes
    ----------
    data, tcp
        State of the cell in which the robot was last placed, and the point between its pads there.
    limits_rad
        Lower and upper limit of each joint [rad]; infinite for an endless joint.
    search_rad
        Lower and upper bound of each joint's start angles [rad].
    """

    def __init__(self, model: mujoco.MjModel, robot: MountedArm) -> None:
        self._model, self.data = model, mujoco.MjData(model)
        self.tcp = self.data.site(robot.of("gripper/tcp"))
        joints = [model.joint(name) for name in robot.joint_names]
        self._places = np.array([joint.qposadr[0] for joint in joints])
        self._columns = np.array([joint.dofadr[0] for joint in joints])
        limits = [joint.range if model.jnt_limited[joint.id] else (-np.inf, np.inf) for joint in joints]
        self.limits_rad: Float[np.ndarray, "J 2"] = np.array(limits, dtype=np.float64)
        self.search_rad: Float[np.ndarray, "J 2"] = robot.arm.search_rad
        self._jacobian = np.zeros((2, 3, model.nv))
        self._bodies = robot.bodies(model)

    @property
    def is_endless(self) -> np.ndarray:
        """Mask of the endless joints; shape (J,)."""
        return np.isinf(self.limits_rad[:, 0])

    def hand(self, angles_rad: Angles) -> Pose:
        """Pose of the point between the pads in the world."""
        self.place(angles_rad)
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, self.tcp.xmat)
        return pose_of(self.tcp.xpos, quaternion)

    def solve(self, target: Pose, begin_rad: Angles, num_steps: int = 60) -> Angles | None:
        """Solve for joint angles that bring the hand to a pose.

        Parameters
        ----------
        target
            Target pose of the hand.
        begin_rad
            Start angles [rad].
        num_steps
            Largest number of steps.

        Returns
        -------
        Float[ndarray, "J"] or None
            Angles [rad], at the turn nearest to `begin_rad`; None if the search does not converge in `num_steps`.
        """
        angles = np.clip(begin_rad, *self.limits_rad.T)
        for _ in range(num_steps):
            apart_m, apart_rad = self._error(target, angles)
            if np.linalg.norm(apart_m) < NEAR_M and np.linalg.norm(apart_rad) < NEAR_RAD:
                return self.nearest_turn(angles, begin_rad)
            angles = np.clip(angles + self._step(angles, apart_m, apart_rad), *self.limits_rad.T)
        return None

    def solve_from(self, target: Pose, begins_rad: Iterable[Angles], near_rad: Angles) -> Angles | None:
        """Solve from several start angles; of the solutions, return the closest to `near_rad`, or None if none."""
        found = [self.solve(target, begin) for begin in begins_rad]
        turned = [self.nearest_turn(angles, near_rad) for angles in found if angles is not None]
        return min(turned, key=lambda angles: float(np.abs(angles - near_rad).max()), default=None)

    def refuse_furniture(self, way: Iterable[Angles]) -> None:
        """Refuse a path on which the robot would touch furniture.

        Parameters
        ----------
        way
            Joint angles at each point of the path [rad].

        Raises
        ------
        PlanError
            The robot would touch furniture; the message states the position of its hand.
        """
        for angles in way:
            self.place(angles)
            mujoco.mj_collision(self._model, self.data)
            bodies = self._model.geom_bodyid[self.data.contact.geom]
            if np.any((bodies == 0).any(axis=1) & np.isin(bodies, self._bodies).any(axis=1)):
                place = in_metres(self.tcp.xpos)
                raise PlanError(f"the arm would touch furniture with its hand at {place}; approach from another side")

    def nearest_turn(self, angles_rad: Angles, near_rad: Angles) -> Angles:
        """Shift endless joints by whole turns to within half a turn of `near_rad`."""
        apart = (angles_rad - near_rad + pi) % (2 * pi) - pi
        return np.where(self.is_endless, near_rad + apart, angles_rad)

    def place(self, angles_rad: Angles) -> None:
        """Put the robot's joints at angles [rad]."""
        self.data.qpos[self._places] = angles_rad
        mujoco.mj_kinematics(self._model, self.data)

    def _error(self, target: Pose, angles_rad: Angles) -> tuple[np.ndarray, np.ndarray]:
        """Error from the hand to the target: position [m] and rotation vector [rad]."""
        self.place(angles_rad)
        now, apart, turn = np.zeros(4), np.zeros(4), np.zeros(3)
        mujoco.mju_mat2Quat(now, self.tcp.xmat)
        mujoco.mju_negQuat(now, now)
        mujoco.mju_mulQuat(apart, np.asarray(target.quaternion, dtype=np.float64), now)
        mujoco.mju_quat2Vel(turn, apart, 1.0)
        return np.asarray(target.position_m) - self.tcp.xpos, turn

    def _step(self, angles_rad: Angles, apart_m: np.ndarray, apart_rad: np.ndarray) -> Angles:
        mujoco.mj_comPos(self._model, self.data)
        mujoco.mj_jacSite(self._model, self.data, *self._jacobian, self.tcp.id)
        moves, turns = self._jacobian[:, :, self._columns]
        jacobian, error = np.concatenate([moves, _LEVER_M * turns]), np.concatenate([apart_m, _LEVER_M * apart_rad])
        step = _damped(jacobian, error)
        # A redundant arm does without joints that are stuck at a limit.
        if len(step) > len(error) and (stuck := self._is_stuck(angles_rad, step)).any():
            step = _damped(np.where(stuck, 0.0, jacobian), error)
        return step * min(1.0, _LARGEST_STEP_RAD / max(float(np.abs(step).max()), 1e-12))

    def _is_stuck(self, angles_rad: Angles, step_rad: Angles) -> Bool[np.ndarray, " J"]:
        """Mask of the joints that are at a limit and would move beyond it."""
        least, largest = self.limits_rad.T
        return ((angles_rad <= least) & (step_rad < 0)) | ((angles_rad >= largest) & (step_rad > 0))


def _damped(jacobian: Float[np.ndarray, "6 J"], error: Float[np.ndarray, " 6"]) -> Angles:
    damping = _DAMPING**2 * min(1.0, float(np.linalg.norm(error)) / 0.05) + 1e-7
    return jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + damping * np.eye(6), error)


Way = Float[np.ndarray, "k J"]

STEP_M = 0.02  # distance between the points of a line at which angles are solved
_LARGEST_TURN_RAD = 0.6  # largest turn of a joint between two points; more is a jump to another arm configuration
RAMP_S = 0.25  # time to reach full speed, and to stop [s]


def line(kinematics: Kinematics, begin_rad: Angles, begin: Pose, end_m: Float[np.ndarray, " 3"]) -> Way:
    """Compute joint angles that move the hand on a straight line without turning it.

    Parameters
    ----------
    end_m
        Target of the hand [m].

    Returns
    -------
    Float[ndarray, "k J"]
        Angles along the line, without those at its start [rad].

    Raises
    ------
    PlanError
        The line leaves the reach, or the arm would have to fold over; the message states where.
    """
    here_m = np.asarray(begin.position_m)
    num_steps = max(1, int(np.ceil(np.linalg.norm(end_m - here_m) / STEP_M)))
    way, angles = [], begin_rad
    for step in range(1, num_steps + 1):
        next_m = here_m + (end_m - here_m) * step / num_steps
        found = kinematics.solve(pose_of(next_m, begin.quaternion), angles, num_steps=40)
        if found is None or np.abs(found - angles).max() > _LARGEST_TURN_RAD:
            trouble = "is out of reach" if found is None else "would need the arm to flip over"
            raise PlanError(
                f"the line to {in_metres(end_m)} breaks off at {in_metres(next_m)}, which {trouble}; approach from "
                "another side"
            )
        way.append(found)
        angles = found
    return np.array(way)


@dataclass(frozen=True)
class Schedule:
    """A timed path from rest to rest: `reached_s` is when each point would be reached without ramps [s], from 0."""

    reached_s: Float[np.ndarray, " k"]
    way_rad: Way

    @property
    def duration_s(self) -> float:
        """Duration of the path [s]."""
        return float(self.reached_s[-1]) + RAMP_S

    def at(self, times_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n J"]:
        """Angles at times from the start [s]: full speed between two ramps of constant acceleration."""
        full_s, ramp_s = float(self.reached_s[-1]), RAMP_S
        starting_s = 0.5 * times_s**2 / ramp_s
        stopping_s = full_s - 0.5 * np.maximum(0.0, full_s + ramp_s - times_s) ** 2 / ramp_s
        along_s = np.where(times_s < ramp_s, starting_s, np.where(times_s < full_s, times_s - 0.5 * ramp_s, stopping_s))
        along_s = np.clip(along_s, 0.0, full_s)
        return np.stack([np.interp(along_s, self.reached_s, joint) for joint in self.way_rad.T], axis=1)


def schedule(begin_rad: Angles, way: Way, speeds_rad_s: Angles) -> Schedule:
    """Schedule a path as fast as its slowest joint allows.

    Parameters
    ----------
    speeds_rad_s
        Largest speed of each joint [rad/s].
    """
    places = np.concatenate([begin_rad[None], way])
    legs_s = (np.abs(np.diff(places, axis=0)) / speeds_rad_s).max(axis=1)
    # The path takes at least one ramp's time, so that acceleration and deceleration fit.
    stretched = legs_s * max(1.0, RAMP_S / max(float(legs_s.sum()), 1e-9))
    return Schedule(np.concatenate([[0.0], np.cumsum(stretched)]), places)
