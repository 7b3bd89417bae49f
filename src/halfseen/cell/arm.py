"""A serial arm from its Denavit–Hartenberg table [DenavitHartenberg1955]_, as capsules.

Joint i rotates about the z axis of frame i − 1. Frame i is offset by d_i along that axis and by a_i along the new x
axis, about which it is rotated by α_i. The frame after the last joint is the *flange*; its z points out of the arm.
"""

# MuJoCo's names come from compiled modules without stubs, which pyright cannot look into.
# pyright: reportAttributeAccessIssue=false

from dataclasses import dataclass
from math import cos, pi, radians, sin
from typing import Any, Protocol, runtime_checkable

import mujoco
import numpy as np

from halfseen.cell.gripper import ROBOT, add_servo, require_finite, require_positive
from halfseen.errors import SceneError
from halfseen.scene.poses import Pose, compose
from halfseen.shapes import Float

LEAST_JOINTS = 5  # with fewer, an arm cannot orient its hand


@runtime_checkable
class SerialArm(Protocol):
    """An arm that a `MountedArm` can have."""

    @property
    def name(self) -> str:
        """Name of the arm."""
        ...

    @property
    def num_joints(self) -> int:
        """Number of joints."""
        ...

    @property
    def speeds_rad_s(self) -> Float[np.ndarray, " J"]:
        """Largest speed of each joint [rad/s]."""
        ...

    @property
    def search_rad(self) -> Float[np.ndarray, "J 2"]:
        """Lower and upper bound of each joint's start angles in inverse kinematics [rad]."""
        ...

    def spec(self) -> mujoco.MjSpec:
        """Build the arm alone.

        Joints and their position servos are both named ``joint_1``, ``joint_2``, …, from the base on. The z axis of the
        site ``flange`` points out of the arm. Geoms carry the contact bits of `halfseen.cell.gripper.ROBOT`.
        """
        ...


_GREY = (0.25, 0.25, 0.28, 1.0)


@dataclass(frozen=True)
class Motor:
    """The drive of a joint.

    Parameters
    ----------
    speed_rad_s
        Largest speed [rad/s].
    stiffness_nm
        Stiffness of the position servo [N·m/rad].
    armature_kgm2
        Rotor inertia, reflected through the gear [kg·m²].

    Raises
    ------
    SceneError
        A value is not positive.
    """

    speed_rad_s: float
    stiffness_nm: float
    armature_kgm2: float

    def __post_init__(self) -> None:
        require_positive("motor", self, ("speed_rad_s", "stiffness_nm", "armature_kgm2"))


@dataclass(frozen=True)
class Joint:
    """A row of the Denavit–Hartenberg table, and the link that the joint moves.

    Parameters
    ----------
    d_m, a_m, alpha_rad
        Transform from frame i − 1 to frame i [m, m, rad].
    zero_rad
        Table angle at the joint's zero position [rad].
    motor
        Drive of the joint.
    mass_kg, radius_m
        Mass and radius of the link [kg, m].
    begin_m
        Start of the link along the joint's axis, from frame i − 1 [m].
    limits_rad
        Lower and upper joint limit [rad]; None for an endless joint.
    is_reversed
        Whether the joint's positive direction is opposite to the table's.

    Raises
    ------
    SceneError
        The link's mass or radius is not positive, a length or an angle is not finite, or the limits are reversed.
    """

    d_m: float
    a_m: float
    alpha_rad: float
    zero_rad: float
    motor: Motor
    mass_kg: float
    radius_m: float
    begin_m: float = 0.0
    limits_rad: tuple[float, float] | None = None
    is_reversed: bool = False

    def __post_init__(self) -> None:
        require_positive("joint", self, ("mass_kg", "radius_m"))
        require_finite("joint", self, ("d_m", "a_m", "alpha_rad", "zero_rad", "begin_m"))
        if self.limits_rad is not None and not self.limits_rad[0] < self.limits_rad[1]:
            raise SceneError(f"joint: limits_rad is {self.limits_rad}; give the smaller angle first")


@dataclass(frozen=True)
class Arm:
    """A serial arm.

    Parameters
    ----------
    name
        Name of the arm.
    joints
        Joints, from the base on.
    flange_m
        End of the last link along the last axis, from frame n − 1, where a tool is mounted [m].
    base_mass_kg, base_radius_m
        Mass and radius of the base [kg, m].
    begins_rad
        Lower and upper bound of each joint's start angles in inverse kinematics [rad]; None for its full range.

    Raises
    ------
    SceneError
        The arm has too few joints to orient its hand, the base's mass or radius is not positive, or the number of
        ranges in `begins_rad` differs from the number of joints.
    """

    name: str
    joints: tuple[Joint, ...]
    flange_m: float
    base_mass_kg: float
    base_radius_m: float
    begins_rad: tuple[tuple[float, float], ...] | None = None

    def __post_init__(self) -> None:
        if self.num_joints < LEAST_JOINTS:
            raise SceneError(
                f"arm {self.name!r} has {self.num_joints} joints; it needs at least {LEAST_JOINTS} to point its hand"
            )
        require_positive(f"arm {self.name!r}", self, ("base_mass_kg", "base_radius_m"))
        require_finite(f"arm {self.name!r}", self, ("flange_m",))
        if self.begins_rad is not None and len(self.begins_rad) != self.num_joints:
            raise SceneError(
                f"arm {self.name!r} has {self.num_joints} joints and begins_rad has {len(self.begins_rad)} "
                "ranges; give one for every joint, or None"
            )

    @property
    def num_joints(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @property
    def speeds_rad_s(self) -> Float[np.ndarray, " J"]:
        """Largest speed of each joint [rad/s]."""
        return np.array([joint.motor.speed_rad_s for joint in self.joints])

    @property
    def search_rad(self) -> Float[np.ndarray, "J 2"]:
        """Lower and upper bound of each joint's start angles in inverse kinematics [rad]."""
        return np.array(self.begins_rad or [joint.limits_rad or (-pi, pi) for joint in self.joints])

    def spec(self) -> mujoco.MjSpec:
        """Build the arm alone: bodies ``link_i``, ``joint_i`` with a position servo each, and a site ``flange``."""
        spec = mujoco.MjSpec()
        spec.compiler.degree = False
        body, radius_m = spec.worldbody.add_body(name="base"), self.base_radius_m
        _add_capsule(body, (0, 0, radius_m), (0, 0, 0.55 * self.joints[0].d_m), radius_m, self.base_mass_kg)
        frames = [Pose((0.0, 0.0, 0.0)), *map(_next_frame, self.joints)]
        ends_m = [_end_m(frame, after.begin_m) for frame, after in zip(frames[1:], self.joints[1:], strict=False)]
        for index, (joint, end_m) in enumerate(zip(self.joints, [*ends_m, (0, 0, self.flange_m)], strict=True)):
            half_rad = 0.5 * joint.zero_rad
            turn = compose((cos(half_rad), 0.0, 0.0, sin(half_rad)), frames[index].quaternion)
            body = body.add_body(name=f"link_{index + 1}", pos=list(frames[index].position_m), quat=list(turn))
            body.gravcomp = 1.0
            self._add_joint(spec, body, index)
            _add_capsule(body, (0, 0, joint.begin_m), end_m, joint.radius_m, joint.mass_kg)
        body.add_site(name="flange", pos=[0, 0, self.flange_m], quat=list(frames[-1].quaternion))
        return spec

    def _add_joint(self, spec: mujoco.MjSpec, body: mujoco.MjsBody, index: int) -> None:
        joint, name = self.joints[index], f"joint_{index + 1}"
        hinge = body.add_joint(
            name=name, axis=[0, 0, -1 if joint.is_reversed else 1], armature=joint.motor.armature_kgm2
        )
        if joint.limits_rad is not None:
            hinge.limited, hinge.range = True, list(joint.limits_rad)
        carried_kgm2 = joint.motor.armature_kgm2 + 0.1 * sum(each.mass_kg for each in self.joints[index:])
        stiffness = joint.motor.stiffness_nm
        add_servo(spec, name, stiffness, 2.0 * (stiffness * carried_kgm2) ** 0.5)


def _next_frame(joint: Joint) -> Pose:
    """Frame i relative to frame i − 1 after the joint's rotation."""
    half_rad = 0.5 * joint.alpha_rad
    return Pose((joint.a_m, 0.0, joint.d_m), (cos(half_rad), sin(half_rad), 0.0, 0.0))


def _end_m(frame: Pose, begin_m: float) -> Float[np.ndarray, " 3"]:
    """End of a link: where the next one begins, along the axis of the next frame [m]."""
    turned = np.zeros(3)
    mujoco.mju_rotVecQuat(turned, np.array([0.0, 0.0, begin_m]), np.array(frame.quaternion))
    return frame.position_m + turned


def _add_capsule(body: mujoco.MjsBody, begin_m: Any, end_m: Any, radius_m: float, mass_kg: float) -> None:
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CAPSULE,
        fromto=[*map(float, begin_m), *map(float, end_m)],
        size=[radius_m, 0, 0],
        mass=mass_kg,
        rgba=list(_GREY),
        **ROBOT,
    )


_WRIST_M, _BEND_RAD = 0.0741, radians(30.0)
_FOLD_M = _WRIST_M * sin(_BEND_RAD) / sin(2 * _BEND_RAD)  # from a joint of the bent wrist to its axes' intersection
_FOREARM_M, _OFFSET_M = 0.2073, 0.0098
_LARGE = Motor(speed_rad_s=radians(36.0), stiffness_nm=4000.0, armature_kgm2=0.5)
_SMALL = Motor(speed_rad_s=radians(48.0), stiffness_nm=1200.0, armature_kgm2=0.2)
_WIDE_RAD = (-3.0, 3.0)

JACO_2 = Arm(
    name="Kinova Jaco 2, six joints, bent wrist",
    joints=(
        Joint(0.2755, 0.0, pi / 2, 0.0, _LARGE, 0.643, 0.040, begin_m=0.157, is_reversed=True),
        Joint(0.0, 0.41, pi, -pi / 2, _LARGE, 1.169, 0.038, limits_rad=(radians(47.0), radians(313.0))),
        Joint(-_OFFSET_M, 0.0, pi / 2, pi / 2, _LARGE, 0.673, 0.034, limits_rad=(radians(19.0), radians(341.0))),
        Joint(-_FOREARM_M - _FOLD_M, 0.0, 2 * _BEND_RAD, 0.0, _SMALL, 0.221, 0.031, begin_m=-_FOREARM_M),
        Joint(-2 * _FOLD_M, 0.0, 2 * _BEND_RAD, -pi, _SMALL, 0.221, 0.031, begin_m=-_FOLD_M),
        Joint(0.0, 0.0, pi, pi / 2, _SMALL, 0.221, 0.031, begin_m=-_FOLD_M),
    ),
    flange_m=-_FOLD_M - 0.02,
    base_mass_kg=0.718,
    base_radius_m=0.045,
    begins_rad=(_WIDE_RAD, (2.0, 4.3), (0.6, 3.1), _WIDE_RAD, _WIDE_RAD, _WIDE_RAD),
)
"""Lengths, axes, limits, masses and speeds from the manufacturer; servos and capsules are our choice.

Inverse kinematics starts with the elbow up.
"""
