"""From weighted logs to policies: censored Q-learning.

Read down: `least_squares` (one weighted regression) → `recursion` (eq. 3, backwards) → `table_features` (what Q looks
at on a table) → `encoding` (logs → arrays) → `linear_policy` (what was learned) → `q_learner` (the estimator).
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.learners.linear_policy import LinearTablePolicy
    from halfseen.learners.q_learner import CensoredQLearner

__all__ = ["CensoredQLearner", "LinearTablePolicy"]

__getattr__ = lazy_names(__name__, {"CensoredQLearner": "q_learner", "LinearTablePolicy": "linear_policy"})
