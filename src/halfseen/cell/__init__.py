"""The physical cell: arms that try what they planned from their own cloud.

Read down: `contacts` (what holds in simulated contact) → `serial_arm` (what every arm is) → `arm`, or `chain` and
`arm_file` (one of a table, or one of the user's file), `gripper` (what moves) → `cup_walls` (what is held) → `model`
(room, cups, rack and arms as one MuJoCo model) → `kinematics` (which angles bring a hand to a place) → `home` (where
any arm stands and waits) → `motion` (lines and schedules) → `commands` (what a robot is told) → `live_cell` (physics
that goes on) → `looking`, `cut_by_arms` (the camera, the truth apart from it, and what an arm cuts from view) →
`grasps`, `clearance` (where a hand could close, and what is in its way) → `planning` (how it gets there, or why not) →
`fetching`, `racking`, `showing`, `attempt` (what is done with it, and what is told of that) → `facts`, `memory` (what
the robot knows) → `camera_errors` (what it believes wrongly) → `stops` (what cuts) → `workcell` (all of that as one
table and its robots) → `table_state` (what a policy decides in) → `truth`, `luck`, `account` (what it earns) →
`clearing`, `episode` (one table to its end), `several` (the same with several arms) → `campaign` (many) → `summary`,
`film`; `trying` → `calibration` (laws from what was tried).

MuJoCo loads when one of these names is asked for, never when this package is imported.
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.cell.arm import JACO_2, Arm, Joint, Motor, SerialArm
    from halfseen.cell.arm_file import ArmFile
    from halfseen.cell.calibration.calibrate import LiftAtRandom
    from halfseen.cell.camera import Eye, Look
    from halfseen.cell.campaign import Campaign, Conditions
    from halfseen.cell.episode import TeamRun, play, play_team
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
    "Conditions",
    "Contacts",
    "Eye",
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
    "play_team",
    "robot_of",
]

__getattr__ = lazy_names(
    __name__,
    {
        "JACO_2": "arm",
        "Arm": "arm",
        "ArmFile": "arm_file",
        "Contacts": "gripper",
        "Eye": "camera",
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
        "LiftAtRandom": "calibration.calibrate",
        "Memory": "memory",
        "Run": "rewards",
        "Stops": "live_cell",
        "Workcell": "workcell",
        "play": "episode",
        "PAIR": "model",
        "TeamRun": "episode",
        "play_team": "episode",
    },
)
