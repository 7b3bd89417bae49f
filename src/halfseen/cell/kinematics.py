"""Where a robot's hand is, which angles bring it to a pose (damped least squares), and straight lines in time.

A step from angles q with error e (position [m], and rotation [rad] times a length) is

    Δq = Jᵀ (J Jᵀ + μ² I)⁻¹ e,

with J the geometric Jacobian and μ that falls as the error does, so that a place out of reach is approached and one in
reach is met [NakamuraHanafusa1986]_ [Sugihara2011]_.
"""

# MuJoCo's names come from compiled modules without stubs, which pyright cannot look into.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Iterable
from dataclasses import dataclass
from math import pi

import mujoco
import numpy as np

from halfseen.cell.model import Robot
from halfseen.errors import PlanError
from halfseen.scene.poses import Pose
from halfseen.shapes import Bool, Float

Angles = Float[np.ndarray, " J"]

NEAR_M, NEAR_RAD = 5e-4, 2e-3  # how near is there
_LEVER_M = 0.3  # what an error of rotation counts, beside one of position
_DAMPING = 0.03
_LARGEST_STEP_RAD = 0.4


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
    limits_rad
        Least and largest angle of each joint [rad]; infinite where it turns without end.
    search_rad
        Least and largest angle at which a search begins [rad].
    """

    def __init__(self, model: mujoco.MjModel, robot: Robot) -> None:
        self._model, self._data = model, mujoco.MjData(model)
        self._tcp = model.site(robot.of("gripper/tcp")).id
        joints = [model.joint(name) for name in robot.joint_names]
        self._places = np.array([joint.qposadr[0] for joint in joints])
        self._columns = np.array([joint.dofadr[0] for joint in joints])
        limits = [joint.range if model.jnt_limited[joint.id] else (-np.inf, np.inf) for joint in joints]
        self.limits_rad: Float[np.ndarray, "J 2"] = np.array(limits, dtype=np.float64)
        self.search_rad: Float[np.ndarray, "J 2"] = robot.arm.search_rad
        self._jacobian = np.zeros((2, 3, model.nv))
        self._bodies = [body for body in range(model.nbody) if model.body(body).name.startswith(robot.of(""))]

    @property
    def is_endless(self) -> np.ndarray:
        """Which joints turn without end; shape (J,)."""
        return np.isinf(self.limits_rad[:, 0])

    def hand(self, angles_rad: Angles) -> Pose:
        """Pose of the point between the pads, in the world."""
        self._place(angles_rad)
        site, quaternion = self._data.site(self._tcp), np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, site.xmat)
        x_m, y_m, z_m = map(float, site.xpos)
        w, x, y, z = map(float, quaternion)
        return Pose((x_m, y_m, z_m), (w, x, y, z))

    def solve(self, target: Pose, begin_rad: Angles, num_steps: int = 60) -> Angles | None:
        """Go from some angles towards a pose of the hand.

        Parameters
        ----------
        target
            The pose.
        begin_rad
            Where to begin.
        num_steps
            Steps at most.

        Returns
        -------
        Float[ndarray, "J"] or None
            Angles, at the turn nearest to `begin_rad`; None if the hand is not there after so many steps.
        """
        angles = np.clip(begin_rad, *self.limits_rad.T)
        for _ in range(num_steps):
            apart_m, apart_rad = self._error(target, angles)
            if np.linalg.norm(apart_m) < NEAR_M and np.linalg.norm(apart_rad) < NEAR_RAD:
                return self.nearest_turn(angles, begin_rad)
            angles = np.clip(angles + self._step(angles, apart_m, apart_rad), *self.limits_rad.T)
        return None

    def solve_from(self, target: Pose, begins_rad: Iterable[Angles], near_rad: Angles) -> Angles | None:
        """Of the solutions from several beginnings, the one that turns no joint far from `near_rad`; None if none."""
        found = [self.solve(target, begin) for begin in begins_rad]
        turned = [self.nearest_turn(angles, near_rad) for angles in found if angles is not None]
        return min(turned, key=lambda angles: float(np.abs(angles - near_rad).max()), default=None)

    def refuse_furniture(self, way: Iterable[Angles]) -> None:
        """Refuse a way on which the robot would touch furniture.

        Parameters
        ----------
        way
            Angles of the joints, place by place.

        Raises
        ------
        PlanError
            It would; the message says where its hand is then.
        """
        for angles in way:
            self._place(angles)
            mujoco.mj_collision(self._model, self._data)
            bodies = self._model.geom_bodyid[self._data.contact.geom]
            if np.any((bodies == 0).any(axis=1) & np.isin(bodies, self._bodies).any(axis=1)):
                x_m, y_m, z_m = self._data.site(self._tcp).xpos
                raise PlanError(
                    f"the arm would touch furniture with its hand at ({x_m:.3f}, {y_m:.3f}, {z_m:.3f}) m; "
                    "come from another side"
                )

    def nearest_turn(self, angles_rad: Angles, near_rad: Angles) -> Angles:
        """Turn endless joints by whole turns, to less than half a turn from others."""
        apart = (angles_rad - near_rad + pi) % (2 * pi) - pi
        return np.where(self.is_endless, near_rad + apart, angles_rad)

    def _place(self, angles_rad: Angles) -> None:
        self._data.qpos[self._places] = angles_rad
        mujoco.mj_kinematics(self._model, self._data)

    def _error(self, target: Pose, angles_rad: Angles) -> tuple[np.ndarray, np.ndarray]:
        """From the hand to the target: position [m], and rotation as a vector [rad]."""
        self._place(angles_rad)
        site = self._data.site(self._tcp)
        now, apart, turn = np.zeros(4), np.zeros(4), np.zeros(3)
        mujoco.mju_mat2Quat(now, site.xmat)
        mujoco.mju_negQuat(now, now)
        mujoco.mju_mulQuat(apart, np.asarray(target.quaternion, dtype=np.float64), now)
        mujoco.mju_quat2Vel(turn, apart, 1.0)
        return np.asarray(target.position_m) - site.xpos, turn

    def _step(self, angles_rad: Angles, apart_m: np.ndarray, apart_rad: np.ndarray) -> Angles:
        mujoco.mj_comPos(self._model, self._data)
        mujoco.mj_jacSite(self._model, self._data, *self._jacobian, self._tcp)
        moves, turns = self._jacobian[:, :, self._columns]
        jacobian, error = np.concatenate([moves, _LEVER_M * turns]), np.concatenate([apart_m, _LEVER_M * apart_rad])
        step = _damped(jacobian, error)
        # An arm with a joint to spare does without one that is at its limit.
        if len(step) > len(error) and (stuck := self._is_stuck(angles_rad, step)).any():
            step = _damped(np.where(stuck, 0.0, jacobian), error)
        return step * min(1.0, _LARGEST_STEP_RAD / max(float(np.abs(step).max()), 1e-12))

    def _is_stuck(self, angles_rad: Angles, step_rad: Angles) -> Bool[np.ndarray, " J"]:
        """Which joints are at a limit, and would go on."""
        least, largest = self.limits_rad.T
        return ((angles_rad <= least) & (step_rad < 0)) | ((angles_rad >= largest) & (step_rad > 0))


def _damped(jacobian: Float[np.ndarray, "6 J"], error: Float[np.ndarray, " 6"]) -> Angles:
    damping = _DAMPING**2 * min(1.0, float(np.linalg.norm(error)) / 0.05) + 1e-7
    return jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + damping * np.eye(6), error)


Way = Float[np.ndarray, "k J"]

STEP_M = 0.02  # between two places of a line at which angles are sought
_LARGEST_TURN_RAD = 0.6  # of a joint, between two such places: more is another way to hold the arm, not a line
RAMP_S = 0.25  # how long it takes to reach full speed, and to stop [s]


def line(kinematics: Kinematics, begin_rad: Angles, begin: Pose, end_m: Float[np.ndarray, " 3"]) -> Way:
    """Move the hand on a straight line, without turning it.

    Parameters
    ----------
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
    """Angles by time, from rest to rest along a way: when each place would be reached without ramps [s], from 0."""

    reached_s: Float[np.ndarray, " k"]
    way_rad: Way

    @property
    def duration_s(self) -> float:
        """How long it takes [s]."""
        return float(self.reached_s[-1]) + RAMP_S

    def at(self, times_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n J"]:
        """Angles at times from the beginning [s]: full speed between two ramps of constant acceleration."""
        full_s, ramp_s = float(self.reached_s[-1]), RAMP_S
        starting_s = 0.5 * times_s**2 / ramp_s
        stopping_s = full_s - 0.5 * np.maximum(0.0, full_s + ramp_s - times_s) ** 2 / ramp_s
        along_s = np.where(times_s < ramp_s, starting_s, np.where(times_s < full_s, times_s - 0.5 * ramp_s, stopping_s))
        along_s = np.clip(along_s, 0.0, full_s)
        return np.stack([np.interp(along_s, self.reached_s, joint) for joint in self.way_rad.T], axis=1)


def schedule(begin_rad: Angles, way: Way, speeds_rad_s: Angles) -> Schedule:
    """Go along a way as fast as its slowest joint allows.

    Parameters
    ----------
    speeds_rad_s
        Largest speed of each joint [rad/s].
    """
    places = np.concatenate([begin_rad[None], way])
    legs_s = (np.abs(np.diff(places, axis=0)) / speeds_rad_s).max(axis=1)
    # A ramp up and one down fit into what is at least as long as one of them.
    stretched = legs_s * max(1.0, RAMP_S / max(float(legs_s.sum()), 1e-9))
    return Schedule(np.concatenate([[0.0], np.cumsum(stretched)]), places)
