"""Simulated grasping: contact parameters, a parallel gripper made of boxes, and the walls of hollow cups.

The contact parameters were tuned so that a cup gripped around stays between the pads, slippery or not. They belong to
the simulation, not to a material. The gripper's frame is the flange frame: z points out of the palm, y is the closing
axis; the site ``tcp`` lies between the pads. A cup collides with tables and other cups by its convex hull. A finger
could not reach into a hull, so robots collide with separate boxes that form the cup's walls.
"""

# MuJoCo's names come from compiled modules without stubs, which pyright cannot look into.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from itertools import pairwise
from math import pi
from typing import Any

import mujoco
import numpy as np

from halfseen.errors import SceneError
from halfseen.scene.cups import Cup, handle_bow
from halfseen.scene.rays import ROBOT_GROUP, UNSEEN_GROUP


def require_positive(what: str, part: object, names: Iterable[str]) -> None:
    """Refuse a part if any of the named values is not positive and finite.

    Raises
    ------
    SceneError
        A value, or one of its components, is not.
    """
    for name in names:
        value = getattr(part, name)
        if not all(0 < number < np.inf for number in np.atleast_1d(value)):
            raise SceneError(f"{what}: {name} is {value}; give a positive number")


def require_finite(what: str, part: object, names: Iterable[str]) -> None:
    """Refuse a part if any of the named values is not finite; see `require_positive`."""
    for name in names:
        if not np.isfinite(getattr(part, name)):
            raise SceneError(f"{what}: {name} is {getattr(part, name)}; give a finite number")


def add_servo(spec: mujoco.MjSpec, joint: str, stiffness: float, damping: float) -> mujoco.MjsActuator:
    """Add the position servo of a joint, of the same name [N·m/rad or N/m, and per rate]."""
    servo = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    servo.set_to_position(kp=stiffness, kv=damping)
    return servo


FURNITURE, WALLS, OBSTACLES, FIRST_ROBOT = 1, 2, 4, 8
"""Contact bits. The first is for contacts among cups' hulls and furniture; the next two are for robots with cups' walls
and with furniture. From the last on, each robot has a bit for contacts with other robots."""

ROBOT: dict[str, Any] = {"contype": 0, "conaffinity": WALLS | OBSTACLES, "group": ROBOT_GROUP}
"""Settings of a robot's geoms: they collide with cups' walls and furniture but not with one another, and have their own
group for cameras."""


@dataclass(frozen=True)
class Contacts:
    """Parameters of the solver and of the contact between pads and cups.

    Parameters
    ----------
    timestep_s
        Time step [s].
    friction_to_normal
        Ratio of friction to normal impedance (``impratio``) [-]; a large one keeps held objects from creeping.
    pad_stiffness
        Time constant [s] and damping ratio [-] of a pad.
    pad_impedance
        Smallest and largest impedance of a pad [-], and the depth over which it grows [m].
    pad_friction
        Sliding [-], spinning [m] and rolling [m] friction of pads on cups.
    """

    timestep_s: float = 0.002
    friction_to_normal: float = 10.0
    pad_stiffness: tuple[float, float] = (0.008, 1.0)
    pad_impedance: tuple[float, float, float] = (0.9, 0.97, 0.001)
    pad_friction: tuple[float, float, float] = (0.9, 0.01, 0.0002)

    def solve(self, spec: mujoco.MjSpec) -> None:
        """Set a model's solver options; bodies at rest sleep at no cost."""
        spec.option.timestep = self.timestep_s
        spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        spec.option.impratio = self.friction_to_normal
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.option.enableflags |= int(mujoco.mjtEnableBit.mjENBL_SLEEP)

    def of_pad(self, friction: float | None = None) -> dict[str, Any]:
        """Contact settings for the geom of a pad, or of a cup's wall with its own sliding friction [-]."""
        sliding = self.pad_friction[0] if friction is None else friction
        return {
            "condim": 4,
            "friction": [sliding, *self.pad_friction[1:]],
            "solref": list(self.pad_stiffness),
            "solimp": [*self.pad_impedance, 0.5, 2],
        }


_DARK, _GREY, _BLACK = (0.15, 0.15, 0.17, 1.0), (0.6, 0.6, 0.65, 1.0), (0.1, 0.1, 0.1, 1.0)
_BOX = mujoco.mjtGeom.mjGEOM_BOX


@dataclass(frozen=True)
class Gripper:
    """Dimensions and force of a gripper.

    Parameters
    ----------
    stroke_m
        Largest opening between the pads [m].
    finger_m
        Length of a finger, from palm to tip [m].
    finger_width_m, finger_thickness_m
        Size of a finger across and along the closing axis, including the pad [m].
    pad_width_m, pad_thickness_m, pad_length_m
        Size of a pad across and along the closing axis, and along the finger [m].
    palm_m
        Size of the palm across and along the closing axis, and its depth [m].
    force_n
        Largest force of a finger [N].

    Raises
    ------
    SceneError
        A number is not positive, a pad is larger than its finger, or the palm is narrower than the stroke.
    """

    stroke_m: float = 0.140
    finger_m: float = 0.080
    finger_width_m: float = 0.018
    finger_thickness_m: float = 0.013
    pad_width_m: float = 0.022
    pad_thickness_m: float = 0.007
    pad_length_m: float = 0.032
    palm_m: tuple[float, float, float] = (0.040, 0.164, 0.040)
    force_n: float = 25.0

    def __post_init__(self) -> None:
        require_positive("gripper", self, [field.name for field in fields(self)])
        for small, large, length_m in (
            ("stroke_m", "palm_m[1]", self.palm_m[1]),
            ("pad_length_m", "finger_m", self.finger_m),
            ("pad_thickness_m", "finger_thickness_m", self.finger_thickness_m),
        ):
            if getattr(self, small) >= length_m:
                raise SceneError(f"gripper: {small} is {getattr(self, small)}; make it less than {large}, {length_m}")

    @property
    def tip_m(self) -> float:
        """Distance from the flange to the fingertips [m]."""
        return self.palm_m[2] + self.finger_m

    @property
    def tcp_m(self) -> float:
        """Distance from the flange to the middle of the pads [m]."""
        return self.tip_m - 0.5 * self.pad_length_m

    def spec(self, contacts: Contacts) -> mujoco.MjSpec:
        """Build the gripper alone: bodies ``hand``, ``finger_left`` and ``finger_right``, and a servo per finger."""
        spec = mujoco.MjSpec()
        hand = spec.worldbody.add_body(name="hand", gravcomp=1.0)
        _add_box(hand, "palm", self.palm_m, (0.0, 0.0, 0.5 * self.palm_m[2]), mass=0.5, rgba=list(_DARK))
        hand.add_site(name="tcp", pos=[0, 0, self.tcp_m])
        for side, sign in _SIDES.items():
            self._add_finger(spec, hand, side, sign, contacts)
        mirror = spec.add_equality(name="mirror", type=mujoco.mjtEq.mjEQ_JOINT, objtype=mujoco.mjtObj.mjOBJ_JOINT)
        mirror.name1, mirror.name2 = (f"slide_{side}" for side in _SIDES)
        mirror.data[:5], mirror.solref = [0, 1, 0, 0, 0], [0.004, 1]
        return spec

    def _add_finger(self, spec: mujoco.MjSpec, hand: mujoco.MjsBody, side: str, sign: int, contacts: Contacts) -> None:
        finger, slide = hand.add_body(name=f"finger_{side}", gravcomp=1.0), f"slide_{side}"
        finger.add_joint(
            name=slide,
            type=mujoco.mjtJoint.mjJNT_SLIDE,
            axis=[0, sign, 0],
            limited=True,
            range=[0, 0.5 * self.stroke_m],
            armature=0.3,
            damping=[20, 0, 0],
        )
        metal_m = self.finger_thickness_m - self.pad_thickness_m
        bar_m, pad_m = (
            (self.finger_width_m, metal_m, self.finger_m),
            (self.pad_width_m, self.pad_thickness_m, self.pad_length_m),
        )
        bar_at_m = (0.0, sign * (self.pad_thickness_m + 0.5 * metal_m), self.tip_m - 0.5 * self.finger_m)
        pad_at_m, touch = (0.0, sign * 0.5 * self.pad_thickness_m, self.tcp_m), contacts.of_pad()
        _add_box(finger, f"bar_{side}", bar_m, bar_at_m, mass=0.05, rgba=list(_GREY))
        _add_box(finger, f"pad_{side}", pad_m, pad_at_m, mass=0.02, rgba=list(_BLACK), priority=1, **touch)
        servo = add_servo(spec, slide, stiffness=2500.0, damping=60.0)
        servo.forcelimited, servo.forcerange = True, [-self.force_n, self.force_n]


def _add_box(
    body: mujoco.MjsBody, name: str, size_m: Sequence[float], middle_m: Sequence[float], **settings: Any
) -> None:
    """Add a part of the robot by its full size."""
    half_m = [0.5 * size for size in size_m]
    body.add_geom(name=name, type=_BOX, size=half_m, pos=list(middle_m), **settings, **ROBOT)


_SIDES = {"left": 1, "right": -1}  # sign of each finger's opening direction along the closing axis


NUM_WALLS = 16
_NUM_HANDLE_PARTS = 5


def add_walls(body: mujoco.MjsBody, cup: Cup, contacts: Contacts, friction: float | None = None) -> None:
    """Add massless walls, a bottom and a handle to the body of a cup.

    Parameters
    ----------
    friction
        Sliding friction on pads [-]; None for the value of `contacts`.
    """
    shared = {"mass": 0, "contype": WALLS, "conaffinity": 0, "group": UNSEEN_GROUP, "priority": 2}
    shared |= contacts.of_pad(friction)
    for angle_rad in 2 * pi * (np.arange(NUM_WALLS) + 0.5) / NUM_WALLS:
        _add_wall(body, cup, angle_rad, shared)
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=[cup.base_radius_m, 0.5 * cup.bottom_m, 0],
        pos=[0, 0, 0.5 * cup.bottom_m],
        **shared,
    )
    if cup.handle_m > 0:
        _add_handle(body, cup, shared)


def _add_wall(body: mujoco.MjsBody, cup: Cup, angle_rad: float, shared: dict[str, Any]) -> None:
    """Add a box that covers a part of the circumference and leans like the cup's wall."""
    radial = np.array([np.cos(angle_rad), np.sin(angle_rad), 0.0])
    around = np.array([-np.sin(angle_rad), np.cos(angle_rad), 0.0])
    up = (cup.rim_radius_m - cup.base_radius_m) / cup.height_m * radial + [0.0, 0.0, 1.0]
    up /= np.linalg.norm(up)
    out, middle_m = np.cross(around, up), cup.radius_at(0.5 * cup.height_m)
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.stack([out, around, up], axis=1).ravel())
    length_m = np.hypot(cup.height_m, cup.rim_radius_m - cup.base_radius_m)
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[0.5 * cup.wall_m, middle_m * np.tan(pi / NUM_WALLS), 0.5 * length_m],
        pos=list(radial * middle_m + [0.0, 0.0, 0.5 * cup.height_m] - 0.5 * cup.wall_m * out),
        quat=list(quaternion),
        **shared,
    )


def _add_handle(body: mujoco.MjsBody, cup: Cup, shared: dict[str, Any]) -> None:
    bow_m, radius_m = handle_bow(cup, _NUM_HANDLE_PARTS + 1)
    for begin_m, end_m in pairwise(bow_m):
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=[*begin_m, *end_m], size=[radius_m, 0, 0], **shared)
