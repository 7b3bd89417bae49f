"""The decision process: state, actions, transition, seeing, reward → trajectories; for one robot, or several.

Read down: `random` (draws), `grasping`, `seeing` (the laws; another robot or gripper is another law of grasping) →
`config` (they and the numbers) → `scene` (where an episode starts) → `state` (what is seen, what is hidden) → `robots`
(who works at the table) → `actions` (the verbs, and what other robots are at) → `attempts`, `transition` (one step) →
`policy` (what decides), `explanation` (how sure that is) → `rollout` (many tables to their end) → `cuts` → `logs` with
`log_rows`, `log_checks` (to and from logs) → `table_world`, `envs`, `pettingzoo_env` (the faces).
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.world.actions import ActionSpace, Verb
    from halfseen.world.config import WorldConfig
    from halfseen.world.cuts import cut_at_drop_outs
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
    from halfseen.world.log_checks import check_log
    from halfseen.world.policy import Decision, ExploringPolicy, Policy, UniformPolicy
    from halfseen.world.robots import Robot, Team, read_team
    from halfseen.world.scene import Scene
    from halfseen.world.seeing import AssumedSeeing, Glimpse, KnownSeeing, LookOutcome, PersistentSeeing, SeeingLaw
    from halfseen.world.state import Robots, TableState, Workspace
    from halfseen.world.table_world import TableWorld

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
    "LookOutcome",
    "PersistentSeeing",
    "Policy",
    "Robot",
    "Robots",
    "Scene",
    "SeeingLaw",
    "TableState",
    "TableWorld",
    "Team",
    "UniformPolicy",
    "Verb",
    "Workspace",
    "WorldConfig",
    "check_log",
    "cut_at_drop_outs",
    "read_team",
]
_NAMES = {
    "actions": "ActionSpace Verb",
    "config": "WorldConfig",
    "cuts": "cut_at_drop_outs",
    "explanation": "Explanation",
    "grasping": "Arrangement AssumedGrasping Attempt FittedGrasping GraspLaw GraspingByRobot KnownGrasping",
    "log_checks": "check_log",
    "policy": "Decision ExploringPolicy Policy UniformPolicy",
    "robots": "Robot Team read_team",
    "scene": "Scene",
    "seeing": "AssumedSeeing Glimpse KnownSeeing PersistentSeeing SeeingLaw LookOutcome",
    "state": "Robots TableState Workspace",
    "table_world": "TableWorld",
}
__getattr__ = lazy_names(__name__, {name: module for module, names in _NAMES.items() for name in names.split()})
