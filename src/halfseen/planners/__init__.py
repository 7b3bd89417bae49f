"""A known model → policies: what learning is compared with.

Read down: `belief` (what can be known) → `heuristics` (greedy, with and without history, with and without the penalty
that a WASH avoids) → `one_step` (a closed look one step ahead) → `rollout` (sampled futures under that look) → `pomdp`
(looking h steps ahead), `explanation` (what each action is worth, and how sure that is). What they are measured by:
`optimum` (the best there is, on small tables), `optimum_bound` (what nobody can beat, on any). Any problem that can be
drawn from: `generative` (the protocol) → `search_tree`, `pomcp` (search until the time is up) → `table_problem` (the
table as such a problem). `discrete` stands apart: any POMDP given as arrays, solved exactly.
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.planners.discrete import DiscreteSolution, solve_discrete
    from halfseen.planners.explanation import explain
    from halfseen.planners.generative import Control, GenerativeProblem, Step, updated_particles
    from halfseen.planners.heuristics import GreedyPolicy
    from halfseen.planners.optimum import TableOptimum, solve_table
    from halfseen.planners.optimum_bound import RelaxationBound, information_relaxation_bound
    from halfseen.planners.pomcp import Plan, plan
    from halfseen.planners.pomdp import POMDPPolicy
    from halfseen.planners.table_problem import TableProblem

__all__ = [
    "Control",
    "DiscreteSolution",
    "GenerativeProblem",
    "GreedyPolicy",
    "POMDPPolicy",
    "Plan",
    "RelaxationBound",
    "Step",
    "TableOptimum",
    "TableProblem",
    "explain",
    "information_relaxation_bound",
    "plan",
    "solve_discrete",
    "solve_table",
    "updated_particles",
]

__getattr__ = lazy_names(
    __name__,
    {
        "Control": "generative",
        "DiscreteSolution": "discrete",
        "GenerativeProblem": "generative",
        "GreedyPolicy": "heuristics",
        "POMDPPolicy": "pomdp",
        "Plan": "pomcp",
        "RelaxationBound": "optimum_bound",
        "Step": "generative",
        "TableOptimum": "optimum",
        "TableProblem": "table_problem",
        "explain": "explanation",
        "information_relaxation_bound": "optimum_bound",
        "plan": "pomcp",
        "solve_discrete": "discrete",
        "solve_table": "optimum",
        "updated_particles": "generative",
    },
)
