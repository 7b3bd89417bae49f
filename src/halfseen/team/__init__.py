"""Several robots at one table (design, §9): who decides when, knowing what the others are at.

Read down: `state` (what each robot is at) → `robots`, `team`, `team_file` (who they are, what they reach) → `config` →
`actions` → `dynamics` (from one decision to the next; drop-outs) → `policy`, `fit` → `episodes` → `recording` (to and
from logs) → `own_part`, `drop_outs` (parts of a log) → `read_log`, `others`, `makespan`, `attempts`, `grasp_by_robot`,
`features`, `rewards`, `task`, `learned_policy`, `decided` (what a team learns, and what that does in a log) →
`each_alone`, `rules`, `named`, `myopic`, `rollout` (what it is compared with) → `grid_grasping`, `optimum` with
`optimum_model`, `_events`, `_asking` (the best there is on a small table) → `team_world`, `gymnasium_env`,
`pettingzoo_env` (the faces).
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.team.config import TeamConfig
    from halfseen.team.drop_outs import cut_at_drop_outs
    from halfseen.team.each_alone import EachAlone
    from halfseen.team.myopic import MyopicTeam
    from halfseen.team.own_part import alone
    from halfseen.team.policy import ExploringTeam, TeamPolicy, UniformTeam
    from halfseen.team.recording import check_log
    from halfseen.team.robots import Robot
    from halfseen.team.rules import TeamOfRules
    from halfseen.team.state import TeamState, Workspace
    from halfseen.team.task import TeamTask
    from halfseen.team.team import Team
    from halfseen.team.team_file import read_team
    from halfseen.team.team_world import TeamWorld

__all__ = [
    "EachAlone",
    "ExploringTeam",
    "MyopicTeam",
    "Robot",
    "Team",
    "TeamConfig",
    "TeamOfRules",
    "TeamPolicy",
    "TeamState",
    "TeamTask",
    "TeamWorld",
    "UniformTeam",
    "Workspace",
    "alone",
    "check_log",
    "cut_at_drop_outs",
    "read_team",
]

__getattr__ = lazy_names(
    __name__,
    {
        "EachAlone": "each_alone",
        "ExploringTeam": "policy",
        "MyopicTeam": "myopic",
        "Robot": "robots",
        "Team": "team",
        "TeamConfig": "config",
        "TeamOfRules": "rules",
        "TeamPolicy": "policy",
        "TeamState": "state",
        "TeamTask": "task",
        "TeamWorld": "team_world",
        "UniformTeam": "policy",
        "Workspace": "state",
        "alone": "own_part",
        "check_log": "recording",
        "cut_at_drop_outs": "drop_outs",
        "read_team": "team_file",
    },
)
