"""The physical cell: arms that try what they planned from their own cloud.

Read down: `gripper`, `arm` or `chain` and `arm_file`, `model` (what there is, as one MuJoCo model) → `kinematics`,
`home` (angles of a hand) → `live_cell`, `camera` (physics and looks) → `grasps`, `planning` (where a hand closes, and
how it gets there) → `fetching` (what an arm does with an object) → `facts`, `memory` (what the robot knows) →
`workcell` (one table and its robots) → `table_state`, `rewards` (what a policy decides in, and what it earns) →
`space`, `executor` (K arms in one clock) → `episode` (one table to its end) → `campaign` (many) → `summary`, `film`;
`calibration` (laws from what was tried).

MuJoCo loads when one of these names is asked for, never when this package is imported.
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.cell.arm import JACO_2, Arm, Joint, Motor, SerialArm
    from halfseen.cell.arm_file import ArmFile
    from halfseen.cell.camera import CellCamera, Look
    from halfseen.cell.campaign import Campaign, Conditions, LiftAtRandom
    from halfseen.cell.episode import TeamRun, play
    from halfseen.cell.grasps import Grasp
    from halfseen.cell.gripper import Contacts, Gripper
    from halfseen.cell.home import robot_of
    from halfseen.cell.kinematics import Kinematics
    from halfseen.cell.live_cell import LiveCell, Stops
    from halfseen.cell.memory import Memory
    from halfseen.cell.model import PAIR, Rack, Robot, Station, cell_model
    from halfseen.cell.rewards import Run
    from halfseen.cell.table_state import Belief
    from halfseen.cell.workcell import Workcell

__all__ = [
    "JACO_2",
    "PAIR",
    "Arm",
    "ArmFile",
    "Belief",
    "Campaign",
    "CellCamera",
    "Conditions",
    "Contacts",
    "Grasp",
    "Gripper",
    "Joint",
    "Kinematics",
    "LiftAtRandom",
    "LiveCell",
    "Look",
    "Memory",
    "Motor",
    "Rack",
    "Robot",
    "Run",
    "SerialArm",
    "Station",
    "Stops",
    "TeamRun",
    "Workcell",
    "cell_model",
    "play",
    "robot_of",
]

__getattr__ = lazy_names(
    __name__,
    {
        "JACO_2": "arm",
        "Arm": "arm",
        "ArmFile": "arm_file",
        "Contacts": "gripper",
        "CellCamera": "camera",
        "Gripper": "gripper",
        "Joint": "arm",
        "Kinematics": "kinematics",
        "LiveCell": "live_cell",
        "Look": "camera",
        "Motor": "arm",
        "Rack": "model",
        "Robot": "model",
        "Station": "model",
        "SerialArm": "arm",
        "cell_model": "model",
        "robot_of": "home",
        "Belief": "table_state",
        "Campaign": "campaign",
        "Conditions": "campaign",
        "Grasp": "grasps",
        "LiftAtRandom": "campaign",
        "Memory": "memory",
        "Run": "rewards",
        "Stops": "live_cell",
        "Workcell": "workcell",
        "play": "episode",
        "PAIR": "model",
        "TeamRun": "episode",
    },
)
