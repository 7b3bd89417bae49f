"""The physical cell: arms that try what they planned from their own cloud.

Read down: `contacts` (what holds in simulated contact) → `arm`, `gripper` (what moves) → `cup_walls` (what is held) →
`model` (room, cups, rack and arms as one MuJoCo model) → `kinematics` (which angles bring a hand to a place) → `motion`
(lines and schedules) → `live_cell` (physics that goes on) → `looking` (the camera, and the truth apart from it).

MuJoCo loads when one of these names is asked for, never when this package is imported.
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.cell.arm import JACO_2, Arm, Joint, Motor
    from halfseen.cell.contacts import Contacts
    from halfseen.cell.gripper import Gripper
    from halfseen.cell.kinematics import Kinematics
    from halfseen.cell.live_cell import LiveCell
    from halfseen.cell.looking import Eye, Look
    from halfseen.cell.model import Rack, Robot, cell_model

__all__ = [
    "JACO_2",
    "Arm",
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
    "cell_model",
]

__getattr__ = lazy_names(
    __name__,
    {
        "JACO_2": "arm",
        "Arm": "arm",
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
        "cell_model": "model",
    },
)
