"""The decision process: state, actions, transition, seeing, reward → paths.

Read down: `grasping`, `seeing` (the laws; another robot or gripper is another law of grasping), `fitted_grasping`,
`persistent_seeing` (laws whose numbers attempts and labels tell), `grasping_by_robot` (a law for each robot of a team)
→ `config` (they and the numbers) → `scene` (where an episode starts) → `state` (what is seen, what is hidden) →
`action_space` (the verbs) → `dynamics` (one step) → `policy` (what decides), `explanation` (how sure that is) →
`episodes` (many tables to their end) → `cuts` → `recording` (to and from logs) → `table_world` and `gymnasium_env` (the
faces).
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.world.action_space import ActionSpace, Verb
    from halfseen.world.config import WorldConfig
    from halfseen.world.explanation import Explanation
    from halfseen.world.fitted_grasping import FittedGrasping
    from halfseen.world.grasping import Arrangement, AssumedGrasping, Attempt, GraspLaw, KnownGrasping
    from halfseen.world.grasping_by_robot import GraspingByRobot
    from halfseen.world.persistent_seeing import PersistentSeeing
    from halfseen.world.policy import Decision, ExploringPolicy, Policy, UniformPolicy
    from halfseen.world.scene import Scene
    from halfseen.world.seeing import AssumedSeeing, Glimpse, KnownSeeing, SeeingLaw, Told
    from halfseen.world.state import TableState
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
    "PersistentSeeing",
    "Policy",
    "Scene",
    "SeeingLaw",
    "TableState",
    "TableWorld",
    "Told",
    "UniformPolicy",
    "Verb",
    "WorldConfig",
]

__getattr__ = lazy_names(
    __name__,
    {
        "ActionSpace": "action_space",
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
        "Scene": "scene",
        "SeeingLaw": "seeing",
        "TableState": "state",
        "TableWorld": "table_world",
        "Told": "seeing",
        "UniformPolicy": "policy",
        "Verb": "action_space",
        "WorldConfig": "config",
    },
)
