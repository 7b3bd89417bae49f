"""The decision process: state, actions, transition, seeing, reward → paths.

Read down: `config` (the numbers) → `scene` (where an episode starts) → `state` (what is seen, what is hidden) →
`actions` → `dynamics` (one step) → `policy` (what decides), `explanation` (how sure that is) → `episodes` (many tables
to their end) → `cuts` → `recording` (to and from logs) → `table_world` and `gymnasium_env` (the faces).
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.world.config import WorldConfig
    from halfseen.world.explanation import Explanation
    from halfseen.world.policy import Decision, ExploringPolicy, Policy, UniformPolicy
    from halfseen.world.scene import Scene
    from halfseen.world.state import TableState
    from halfseen.world.table_world import TableWorld

__all__ = [
    "Decision",
    "Explanation",
    "ExploringPolicy",
    "Policy",
    "Scene",
    "TableState",
    "TableWorld",
    "UniformPolicy",
    "WorldConfig",
]

__getattr__ = lazy_names(
    __name__,
    {
        "Decision": "policy",
        "Explanation": "explanation",
        "ExploringPolicy": "policy",
        "Policy": "policy",
        "Scene": "scene",
        "TableState": "state",
        "TableWorld": "table_world",
        "UniformPolicy": "policy",
        "WorldConfig": "config",
    },
)
