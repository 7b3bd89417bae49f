"""A known model → policies: what learning is compared with.

Read down: `belief` (what can be known) → `heuristics` (greedy, with and without history, with and without the penalty
that a WASH avoids) → `pomdp` (looking h steps ahead). `discrete` stands apart: any POMDP given as arrays, solved
exactly.
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.planners.discrete import DiscreteSolution, solve_discrete
    from halfseen.planners.heuristics import GreedyPolicy
    from halfseen.planners.pomdp import POMDPPolicy

__all__ = ["DiscreteSolution", "GreedyPolicy", "POMDPPolicy", "solve_discrete"]

__getattr__ = lazy_names(
    __name__,
    {
        "DiscreteSolution": "discrete",
        "GreedyPolicy": "heuristics",
        "POMDPPolicy": "pomdp",
        "solve_discrete": "discrete",
    },
)
