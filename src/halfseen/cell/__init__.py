"""The physical cell: arms that try what they planned from their own cloud.

Read down: `contacts` (what holds in simulated contact) → `arm`, `gripper` (what moves) → `cup_walls` (what is held) →
`model` (room, cups, rack and arms as one MuJoCo model) → `kinematics` (where a hand is, and how it gets there).

MuJoCo loads when one of these names is asked for, never when this package is imported.
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.cell.arm import JACO_2, Arm, Joint, Motor
    from halfseen.cell.contacts import Contacts
    from halfseen.cell.gripper import Gripper
    from halfseen.cell.kinematics import Kinematics
    from halfseen.cell.model import Rack, Robot, cell_model

__all__ = ["JACO_2", "Arm", "Contacts", "Gripper", "Joint", "Kinematics", "Motor", "Rack", "Robot", "cell_model"]

__getattr__ = lazy_names(
    __name__,
    {
        "JACO_2": "arm",
        "Arm": "arm",
        "Contacts": "contacts",
        "Gripper": "gripper",
        "Joint": "arm",
        "Kinematics": "kinematics",
        "Motor": "arm",
        "Rack": "model",
        "Robot": "model",
        "cell_model": "model",
    },
)
