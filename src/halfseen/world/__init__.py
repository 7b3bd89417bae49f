"""The decision process: state, actions, transition, seeing, reward → trajectories; for one robot, or several.

Read down: `random` (draws), `grasping`, `seeing` (the laws; another robot or gripper is another law of grasping) →
`config` (they and the numbers) → `scene` (where an episode starts) → `state` (what is seen, what is hidden) → `robots`,
`team_file` (who works at the table) → `actions` (the verbs) → `attempts`, `events`, `transition` (one step) → `policy`
(what decides), `explanation` (how sure that is), `others` (what a robot knows of the others) → `rollout` (many tables
to their end) → `cuts` → `logs`, `robot_logs` with `log_checks` (to and from logs) → `table_world`, `envs`,
`pettingzoo_env` (the faces).
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.world.actions import ActionSpace, Verb
    from halfseen.world.config import WorldConfig
    from halfseen.world.explanation import Explanation
    from halfseen.world.grasping import (
        Arrangement,
        AssumedGrasping,
        Attempt,
        FittedGrasping,
        GraspingByRobot,
        GraspLaw,
        KnownGrasping,
    )
    from halfseen.world.logs import check_log
    from halfseen.world.policy import Decision, ExploringPolicy, Policy, UniformPolicy
    from halfseen.world.robot_logs import cut_at_drop_outs
    from halfseen.world.robots import Robot, Team
    from halfseen.world.scene import Scene
    from halfseen.world.seeing import AssumedSeeing, Glimpse, KnownSeeing, PersistentSeeing, SeeingLaw, Told
    from halfseen.world.state import Robots, TableState, Workspace
    from halfseen.world.table_world import TableWorld
    from halfseen.world.team_file import read_team

__all__ = [
    "ActionSpace",
    "Arrangement",
    "AssumedGrasping",
    "AssumedSeeing",
    "Attempt",
    "Decision",
    "Explanation",
    "ExploringPolicy",
    "FittedGrasping",
    "Glimpse",
    "GraspLaw",
    "GraspingByRobot",
    "KnownGrasping",
    "KnownSeeing",
    "PersistentSeeing",
    "Policy",
    "Robot",
    "Robots",
    "Scene",
    "SeeingLaw",
    "TableState",
    "TableWorld",
    "Team",
    "Told",
    "UniformPolicy",
    "Verb",
    "Workspace",
    "WorldConfig",
    "check_log",
    "cut_at_drop_outs",
    "read_team",
]

__getattr__ = lazy_names(
    __name__,
    {
        "ActionSpace": "actions",
        "Arrangement": "grasping",
        "AssumedGrasping": "grasping",
        "AssumedSeeing": "seeing",
        "Attempt": "grasping",
        "Decision": "policy",
        "Explanation": "explanation",
        "ExploringPolicy": "policy",
        "FittedGrasping": "grasping",
        "Glimpse": "seeing",
        "GraspLaw": "grasping",
        "GraspingByRobot": "grasping",
        "KnownGrasping": "grasping",
        "KnownSeeing": "seeing",
        "PersistentSeeing": "seeing",
        "Policy": "policy",
        "Robot": "robots",
        "Robots": "state",
        "Scene": "scene",
        "SeeingLaw": "seeing",
        "TableState": "state",
        "TableWorld": "table_world",
        "Team": "robots",
        "Told": "seeing",
        "UniformPolicy": "policy",
        "Verb": "actions",
        "Workspace": "state",
        "WorldConfig": "config",
        "check_log": "logs",
        "cut_at_drop_outs": "robot_logs",
        "read_team": "team_file",
    },
)
