"""The physical cell: arms that execute grasps planned from their own point cloud.

Reading order: `gripper`, `arm` or `chain` and `arm_file`, `model` (the cell as one MuJoCo model) → `kinematics`
(joint angles for a hand pose) → `live_cell`, `camera` (physics and looks) → `grasps`, `planning` (where a hand closes,
how it gets there, and where an arm waits) → `fetching` (what an arm does with an object) → `facts`, `memory` (what the
robot knows) → `workcell` (one table and its robots) → `table_state`, `rewards` (a policy's state and its rewards) →
`space`, `executor` (K arms on one clock) → `episode` (one table to its end) → `campaign` (many) → `summary`, `film`;
`calibration` (models fitted to attempts).

MuJoCo loads when one of these names is first used, not when this package is imported.
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
    from halfseen.cell.kinematics import Kinematics
    from halfseen.cell.live_cell import LiveCell, Stops
    from halfseen.cell.memory import Memory
    from halfseen.cell.model import PAIR, MountedArm, Rack, Station, cell_model
    from halfseen.cell.planning import robot_of
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
    "MountedArm",
    "Rack",
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

_NAMES = {
    "arm": "Arm JACO_2 Joint Motor SerialArm",
    "arm_file": "ArmFile",
    "camera": "CellCamera Look",
    "campaign": "Campaign Conditions LiftAtRandom",
    "episode": "TeamRun play",
    "grasps": "Grasp",
    "gripper": "Contacts Gripper",
    "kinematics": "Kinematics",
    "live_cell": "LiveCell Stops",
    "memory": "Memory",
    "model": "PAIR Rack MountedArm Station cell_model",
    "planning": "robot_of",
    "rewards": "Run",
    "table_state": "Belief",
    "workcell": "Workcell",
}
__getattr__ = lazy_names(__name__, {name: module for module, names in _NAMES.items() for name in names.split()})
