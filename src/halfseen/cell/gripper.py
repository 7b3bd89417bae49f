"""A parallel gripper of boxes: two fingers that slide apart, each with a soft pad at its tip.

Its frame is the flange's: z points out of the palm, y is the closing axis. The site ``tcp`` lies between the pads.
"""

# MuJoCo's names come from compiled modules without stubs, which pyright cannot look into.
# pyright: reportAttributeAccessIssue=false

from dataclasses import dataclass, fields

import mujoco

from halfseen.cell.contacts import ROBOT, Contacts
from halfseen.cell.serial_arm import require_positive
from halfseen.errors import SceneError

_DARK, _GREY, _BLACK = (0.15, 0.15, 0.17, 1.0), (0.6, 0.6, 0.65, 1.0), (0.1, 0.1, 0.1, 1.0)
_BOX = mujoco.mjtGeom.mjGEOM_BOX


@dataclass(frozen=True)
class Gripper:
    """Sizes and force of a gripper.

    Parameters
    ----------
    stroke_m
        Between the pads when open [m].
    finger_m
        Length of a finger, from palm to tip [m].
    finger_width_m, finger_thickness_m
        Across and along the closing axis, the pad's thickness included [m].
    pad_width_m, pad_thickness_m, pad_length_m
        Of a pad: across, along the closing axis, and along the finger [m].
    palm_m
        Sizes of the palm: across, along the closing axis, deep [m].
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
        """From the flange to the tips of the fingers [m]."""
        return self.palm_m[2] + self.finger_m

    @property
    def tcp_m(self) -> float:
        """From the flange to the middle of the pads [m]."""
        return self.tip_m - 0.5 * self.pad_length_m

    def spec(self, contacts: Contacts) -> mujoco.MjSpec:
        """Build the gripper alone: bodies ``hand``, ``finger_left`` and ``finger_right``, a servo for each finger."""
        spec = mujoco.MjSpec()
        hand = spec.worldbody.add_body(name="hand", gravcomp=1.0)
        half = [0.5 * size for size in self.palm_m]
        hand.add_geom(name="palm", type=_BOX, size=half, pos=[0, 0, half[2]], mass=0.5, rgba=list(_DARK), **ROBOT)
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
        finger.add_geom(
            name=f"bar_{side}",
            type=_BOX,
            size=[0.5 * self.finger_width_m, 0.5 * metal_m, 0.5 * self.finger_m],
            pos=[0, sign * (self.pad_thickness_m + 0.5 * metal_m), self.tip_m - 0.5 * self.finger_m],
            mass=0.05,
            rgba=list(_GREY),
            **ROBOT,
        )
        finger.add_geom(
            name=f"pad_{side}",
            type=_BOX,
            size=[0.5 * self.pad_width_m, 0.5 * self.pad_thickness_m, 0.5 * self.pad_length_m],
            pos=[0, sign * 0.5 * self.pad_thickness_m, self.tcp_m],
            mass=0.02,
            rgba=list(_BLACK),
            priority=1,
            **contacts.of_pad(),
            **ROBOT,
        )
        servo = spec.add_actuator(name=slide, target=slide, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.set_to_position(kp=2500.0, kv=60.0)
        servo.forcelimited, servo.forcerange = True, [-self.force_n, self.force_n]


_SIDES = {"left": 1, "right": -1}
"""Sign of the closing axis on which a finger opens."""
