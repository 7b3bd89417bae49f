"""A known model → policies: what learning is compared with.

Read down: `belief` (what can be known) → `heuristics` (rules of thumb, of one robot and of several) → `one_step` (the
myopic look-ahead), `myopic` (with several robots) → `rollout` (what actions are worth if it decides ever after, those
looked at most that promise most) → `pomdp` (looking h steps ahead, as a policy, or until the time is up),
`explanation` (what each action is worth, and how sure that is), `control` (what a policy earns, with less luck). Of
several robots: `futures` (rollouts, one robot at a time). `named` makes those that go by a name.

What they are measured by: `exact` (the best there is, on small tables), from `exact_labels`, `exact_table`,
`exact_team`, `exact_graph` (what may become of a table) and `exact_policies` (what a policy earns there); `relaxation`
(what nobody can beat, on any). `discrete` stands apart: any POMDP given as arrays, solved exactly.
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.planners.discrete import DiscreteSolution, solve_discrete
    from halfseen.planners.exact import TableOptimum, TeamOptimum, solve_table, solve_team
    from halfseen.planners.explanation import explain
    from halfseen.planners.futures import RolloutPolicy
    from halfseen.planners.heuristics import GreedyPolicy, OneAtATime, ReservingPolicy, RoundRobin, TeamOfRules
    from halfseen.planners.myopic import MyopicPolicy
    from halfseen.planners.named import named_policy
    from halfseen.planners.pomdp import Plan, POMDPPolicy, plan
    from halfseen.planners.relaxation import RelaxationBound, information_relaxation_bound

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
    "named": "named_policy",
    "pomdp": "POMDPPolicy Plan plan",
    "relaxation": "RelaxationBound information_relaxation_bound",
}
__getattr__ = lazy_names(__name__, {name: module for module, names in _NAMES.items() for name in names.split()})
