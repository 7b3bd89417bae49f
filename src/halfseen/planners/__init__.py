"""Planners: policies computed from a known model, the baselines of learning.

Reading order: `belief` (the posterior) → `heuristics` (rules of thumb, for one robot and for teams) → `one_step` (the
myopic look-ahead), `myopic` (the same for teams) → `rollout` (Q of the look-ahead by rollouts, focused on the most
promising actions) → `pomdp` (h-step look-ahead, as a policy or within a time limit), `explanation` (action values with
their uncertainty), `control` (policy values with reduced variance). For teams: `futures` (rollouts, one robot at a
time). `named_policy` makes a policy by its name.

References to compare with: `exact` (the exact optimum of small tables), from `exact_labels`, `exact_table`,
`exact_team`, `exact_graph` (the state graph of a table) and `exact_policies` (exact policy values); `relaxation` (an
upper bound for larger tables). `discrete` is separate: it solves any POMDP given as arrays exactly.
"""

from types import MappingProxyType
from typing import TYPE_CHECKING

from halfseen.errors import ArgumentError
from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.planners.discrete import DiscreteSolution, solve_discrete
    from halfseen.planners.exact import TableOptimum, TeamOptimum, solve_table, solve_team
    from halfseen.planners.explanation import explain
    from halfseen.planners.futures import RolloutPolicy
    from halfseen.planners.heuristics import GreedyPolicy, OneAtATime, ReservingPolicy, RoundRobin, TeamOfRules
    from halfseen.planners.myopic import MyopicPolicy
    from halfseen.planners.pomdp import Plan, POMDPPolicy, plan
    from halfseen.planners.relaxation import RelaxationBound, information_relaxation_bound
    from halfseen.world import Policy, WorldConfig

__all__ = [
    "DiscreteSolution",
    "GreedyPolicy",
    "MyopicPolicy",
    "OneAtATime",
    "POMDPPolicy",
    "Plan",
    "RelaxationBound",
    "ReservingPolicy",
    "RolloutPolicy",
    "RoundRobin",
    "TableOptimum",
    "TeamOfRules",
    "TeamOptimum",
    "explain",
    "information_relaxation_bound",
    "named_policy",
    "plan",
    "solve_discrete",
    "solve_table",
    "solve_team",
]
_NAMES = {
    "discrete": "DiscreteSolution solve_discrete",
    "exact": "TableOptimum TeamOptimum solve_table solve_team",
    "explanation": "explain",
    "futures": "RolloutPolicy",
    "heuristics": "GreedyPolicy OneAtATime ReservingPolicy RoundRobin TeamOfRules",
    "myopic": "MyopicPolicy",
    "pomdp": "POMDPPolicy Plan plan",
    "relaxation": "RelaxationBound information_relaxation_bound",
}
__getattr__ = lazy_names(__name__, {name: module for module, names in _NAMES.items() for name in names.split()})

HEURISTICS = MappingProxyType(
    {
        "greedy": (False, False),
        "history": (True, False),
        "greedy-penalty": (False, True),
        "history-penalty": (True, True),
    }
)
"""For each `GreedyPolicy`: whether it uses history, and whether it counts the penalty; a team gets a
`ReservingPolicy`."""
UNIFORM, PLANNER = "uniform", "planner"
"""`UniformPolicy`; and a `POMDPPolicy` to the end, or for a team a `RolloutPolicy` over a `MyopicPolicy`."""


def named_policy(
    name: str, config: "WorldConfig", random_share: float = 0.0, *, is_team: bool | None = None
) -> "Policy":
    """Make a policy by its name.

    Parameters
    ----------
    name
        One of `HEURISTICS`, `UNIFORM`, `PLANNER`.
    config
        Its model of the world.
    random_share
        Probability of a uniformly random action at each step.
    is_team
        Whether the policy is for robots with individual reach; by default, whether there are several robots.

    Raises
    ------
    ArgumentError
        There is no policy of this name.
    """
    # Imported here, as names are needed before the world is loaded; each planner loads on first use.
    from halfseen import planners
    from halfseen.world import UniformPolicy

    if name not in (known := (*HEURISTICS, UNIFORM, PLANNER)):
        raise ArgumentError(f"policy is {name!r}; give one of {', '.join(known)}")
    is_team = config.num_robots > 1 if is_team is None else is_team
    policy: Policy
    if name == UNIFORM:
        return UniformPolicy()
    if name != PLANNER:
        rule = planners.GreedyPolicy(config, *HEURISTICS[name])
        policy = planners.ReservingPolicy(config, rule) if is_team else rule
    elif is_team:
        policy = planners.RolloutPolicy(config, planners.MyopicPolicy(config))
    else:
        policy = planners.POMDPPolicy(config, planning_horizon=config.horizon)
    return exploring(policy, random_share)


def exploring(policy: "Policy", random_share: float) -> "Policy":
    """Make a policy take a uniformly random action with probability `random_share` per step; at 0, return it as is."""
    from halfseen.world import ExploringPolicy

    return ExploringPolicy(policy, random_share) if random_share else policy
