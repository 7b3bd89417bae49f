"""The physical cell: arms that try what they planned from their own cloud.

Read down: `contacts` (what holds in simulated contact) → `serial_arm` (what every arm is) → `arm`, or `chain` and
`arm_file` (one of a table, or one of the user's file), `gripper` (what moves) → `cup_walls` (what is held) → `model`
(room, cups, rack and arms as one MuJoCo model) → `kinematics` (which angles bring a hand to a place) → `home` (where
any arm stands and waits) → `motion` (lines and schedules) → `live_cell` (physics that goes on) → `looking` (the camera,
and the truth apart from it).

MuJoCo loads when one of these names is asked for, never when this package is imported.
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.cell.arm import JACO_2, Arm, Joint, Motor
    from halfseen.cell.arm_file import ArmFile
    from halfseen.cell.contacts import Contacts
    from halfseen.cell.gripper import Gripper
    from halfseen.cell.home import robot_of
    from halfseen.cell.kinematics import Kinematics
    from halfseen.cell.live_cell import LiveCell
    from halfseen.cell.looking import Eye, Look
    from halfseen.cell.model import Rack, Robot, cell_model
    from halfseen.cell.serial_arm import SerialArm

__all__ = [
    "JACO_2",
    "Arm",
    "ArmFile",
    "Contacts",
    "Eye",
    "Gripper",
    "Joint",
    "Kinematics",
    "LiveCell",
    "Look",
    "Motor",
    "Rack",
    "Robot",
    "SerialArm",
    "cell_model",
    "robot_of",
]

__getattr__ = lazy_names(
    __name__,
    {
        "JACO_2": "arm",
        "Arm": "arm",
        "ArmFile": "arm_file",
        "Contacts": "contacts",
        "Eye": "looking",
        "Gripper": "gripper",
        "Joint": "arm",
        "Kinematics": "kinematics",
        "LiveCell": "live_cell",
        "Look": "looking",
        "Motor": "arm",
        "Rack": "model",
        "Robot": "model",
        "SerialArm": "serial_arm",
        "cell_model": "model",
        "robot_of": "home",
    },
)
