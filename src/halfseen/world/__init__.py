"""The decision process: state, actions, transition, seeing, reward → trajectories; for one robot, or several.

Read down: `random` (draws), `grasping`, `seeing` (the laws; another robot or gripper is another law of grasping),
`fitted_grasping`, `persistent_seeing` (laws whose numbers attempts and labels tell), `grasping_by_robot` (a law for
each robot) → `config` (they and the numbers) → `scene` (where an episode starts) → `state` (what is seen, what is
hidden) → `robots`, `team_file` (who works at the table) → `actions` (the verbs) → `attempts`, `events`, `transition`
(one step) → `policy` (what decides), `explanation` (how sure that is) → `rollout` (many tables to their end) → `cuts` →
`logs`, `robot_logs` with `log_checks`, `robot_checks`; `drop_outs` (to and from logs) → `table_world`, `envs`,
`pettingzoo_env` (the faces).
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.world.actions import ActionSpace, Verb
    from halfseen.world.config import WorldConfig
    from halfseen.world.drop_outs import cut_at_drop_outs
    from halfseen.world.explanation import Explanation
    from halfseen.world.fitted_grasping import FittedGrasping
    from halfseen.world.grasping import Arrangement, AssumedGrasping, Attempt, GraspLaw, KnownGrasping
    from halfseen.world.grasping_by_robot import GraspingByRobot
    from halfseen.world.logs import check_log
    from halfseen.world.persistent_seeing import PersistentSeeing
    from halfseen.world.policy import Decision, ExploringPolicy, Policy, UniformPolicy
    from halfseen.world.robots import Robot, Team
    from halfseen.world.scene import Scene
    from halfseen.world.seeing import AssumedSeeing, Glimpse, KnownSeeing, SeeingLaw, Told
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
        "FittedGrasping": "fitted_grasping",
        "Glimpse": "seeing",
        "GraspLaw": "grasping",
        "GraspingByRobot": "grasping_by_robot",
        "KnownGrasping": "grasping",
        "KnownSeeing": "seeing",
        "PersistentSeeing": "persistent_seeing",
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
        "cut_at_drop_outs": "drop_outs",
        "read_team": "team_file",
    },
)
