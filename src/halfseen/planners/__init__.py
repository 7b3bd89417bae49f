"""A known model → policies: what learning is compared with.

Read down: `belief` (what can be known) → `heuristics` (rules of thumb, of one robot and of several) → `one_step` (the
myopic look-ahead), `myopic` (with several robots) → `rollout` (what actions are worth if it decides ever after, those
looked at most that promise most) → `pomdp` (looking h steps ahead, as a policy, or until the time is up),
`explanation` (what each action is worth, and how sure that is), `control` (what a policy earns, with less luck). Of
several robots: `futures` (rollouts, one robot at a time). `named_policy` makes those that go by a name.

What they are measured by: `exact` (the best there is, on small tables), from `exact_labels`, `exact_table`,
`exact_team`, `exact_graph` (what may become of a table), `exact_policies` (what a policy earns there); `relaxation`
(what nobody can beat, on any). `discrete` stands apart: any POMDP given as arrays, solved exactly.
"""

from types import MappingProxyType
from typing import TYPE_CHECKING

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
"""Of each `GreedyPolicy`: whether it uses history, and whether it counts the penalty; of several robots, reserving."""
UNIFORM, PLANNER = "uniform", "planner"
"""`UniformPolicy`; and a `POMDPPolicy` to the end, of several robots a `RolloutPolicy` over a `MyopicPolicy`."""


def named_policy(
    name: str, config: "WorldConfig", random_share: float = 0.0, *, is_team: bool | None = None
) -> "Policy":
    """Make the policy of a name.

    Parameters
    ----------
    name
        One of `HEURISTICS`, `UNIFORM`, `PLANNER`.
    config
        The world that it believes in.
    random_share
        Probability that a step takes an action uniformly at random instead.
    is_team
        Whether robots with a reach of their own work there; None where several do.
    """
    # Names are asked for where no world is loaded yet, and each planner is loaded once it is named.
    from halfseen import planners
    from halfseen.world import UniformPolicy

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
    """Let a policy take some actions uniformly at random.

    A step does so with probability `random_share`; at 0 the policy is given back.
    """
    from halfseen.world import ExploringPolicy

    return ExploringPolicy(policy, random_share) if random_share else policy
