"""A known model → policies: what learning is compared with.

Read down: `belief` (what can be known) → `heuristics` (greedy, with and without history, with and without the penalty
that a WASH avoids) → `one_step` (the myopic look-ahead) → `rollout` (rollouts under it, most of them of the actions
that promise most) → `pomdp` (looking h steps ahead, as a policy), `anytime` (the same until the time is up),
`explanation` (what each action is worth, and how sure that is). What they are measured by: `optimum` (the best there
is, on small tables), `optimum_bound` (what nobody can beat, on any). `discrete` stands apart: any POMDP given as
arrays, solved exactly.
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.planners.anytime import Plan, plan, warm_up
    from halfseen.planners.discrete import DiscreteSolution, solve_discrete
    from halfseen.planners.explanation import explain
    from halfseen.planners.heuristics import GreedyPolicy
    from halfseen.planners.optimum import TableOptimum, solve_table
    from halfseen.planners.optimum_bound import RelaxationBound, information_relaxation_bound
    from halfseen.planners.pomdp import POMDPPolicy

__all__ = [
    "DiscreteSolution",
    "GreedyPolicy",
    "POMDPPolicy",
    "Plan",
    "RelaxationBound",
    "TableOptimum",
    "explain",
    "information_relaxation_bound",
    "plan",
    "solve_discrete",
    "solve_table",
    "warm_up",
]

__getattr__ = lazy_names(
    __name__,
    {
        "DiscreteSolution": "discrete",
        "GreedyPolicy": "heuristics",
        "POMDPPolicy": "pomdp",
        "Plan": "anytime",
        "RelaxationBound": "optimum_bound",
        "TableOptimum": "optimum",
        "explain": "explanation",
        "information_relaxation_bound": "optimum_bound",
        "plan": "anytime",
        "solve_discrete": "discrete",
        "solve_table": "optimum",
        "warm_up": "anytime",
    },
)
