"""A known model → policies: what learning is compared with.

Read down: `belief` (what can be known) → `heuristics` (greedy, with and without history, with and without the penalty
that a WASH avoids) → `pomdp` (looking h steps ahead).
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.planners.heuristics import GreedyPolicy
    from halfseen.planners.pomdp import POMDPPolicy

__all__ = ["GreedyPolicy", "POMDPPolicy"]

__getattr__ = lazy_names(__name__, {"GreedyPolicy": "heuristics", "POMDPPolicy": "pomdp"})
