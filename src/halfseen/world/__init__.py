"""The decision process: state, actions, transition, seeing, reward → trajectories; for one robot or several.

Reading order: `random` (draws), `grasping`, `seeing` (the laws; another robot or gripper is another law of grasping) →
`config` (the laws and all parameters) → `scene` (initial arrangement) → `state` (observed and hidden state) → `robots`
(the team at the table) → `actions` (verbs, and what other robots are doing) → `attempts`, `transition` (one step) →
`policy` (interface of policies), `explanation` (their uncertainty) → `rollout` (many tables to their end) → `cuts` →
`logs` with `log_rows`, `log_checks` (conversion to and from logs) → `table_world`, `envs`, `pettingzoo_env` (public
interfaces).
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
    from halfseen.world.policy import ExploringPolicy, Policy, PolicyDraw, UniformPolicy
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
    "PolicyDraw",
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
    "policy": "PolicyDraw ExploringPolicy Policy UniformPolicy",
    "robots": "Robot Team read_team",
    "scene": "Scene",
    "seeing": "AssumedSeeing Glimpse KnownSeeing PersistentSeeing SeeingLaw LookOutcome",
    "state": "Robots TableState Workspace",
    "table_world": "TableWorld",
}
__getattr__ = lazy_names(__name__, {name: module for module, names in _NAMES.items() for name in names.split()})
