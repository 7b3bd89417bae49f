"""A known model → policies: what learning is compared with.

Read down: `belief` (what can be known) → `heuristics` (greedy, with and without history, with and without the penalty
that a WASH avoids) → `one_step` (the myopic look-ahead) → `trajectories` (what follows under it) → `rollout` (what
actions are worth then, those looked at most that promise most) → `pomdp` (looking h steps ahead, as a policy, or until
the time is up), `explanation` (what each action is worth, and how sure that is). Of several robots: `rules` (of thumb),
`myopic` (the look one step ahead), `futures` (rollouts, one robot at a time). `named` makes those that go by a name.
What they are measured by: `exact` (the best there is, on small tables), `relaxation` (what
nobody can beat, on any). `discrete` stands apart: any POMDP given as arrays, solved exactly.
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.planners.discrete import DiscreteSolution, solve_discrete
    from halfseen.planners.exact import TableOptimum, TeamOptimum, solve_table, solve_team
    from halfseen.planners.explanation import explain
    from halfseen.planners.futures import RolloutPolicy
    from halfseen.planners.heuristics import GreedyPolicy
    from halfseen.planners.myopic import MyopicPolicy
    from halfseen.planners.named import named_policy
    from halfseen.planners.pomdp import Plan, POMDPPolicy, plan
    from halfseen.planners.relaxation import RelaxationBound, information_relaxation_bound
    from halfseen.planners.rules import OneAtATime, ReservingPolicy, RoundRobin, TeamOfRules

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

__getattr__ = lazy_names(
    __name__,
    {
        "DiscreteSolution": "discrete",
        "GreedyPolicy": "heuristics",
        "MyopicPolicy": "myopic",
        "OneAtATime": "rules",
        "POMDPPolicy": "pomdp",
        "Plan": "pomdp",
        "RelaxationBound": "relaxation",
        "ReservingPolicy": "rules",
        "RolloutPolicy": "futures",
        "RoundRobin": "rules",
        "TableOptimum": "exact",
        "TeamOfRules": "rules",
        "TeamOptimum": "exact",
        "explain": "explanation",
        "information_relaxation_bound": "relaxation",
        "named_policy": "named",
        "plan": "pomdp",
        "solve_discrete": "discrete",
        "solve_table": "exact",
        "solve_team": "exact",
    },
)
