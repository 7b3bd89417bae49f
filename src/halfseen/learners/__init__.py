"""From weighted logs to predictions and policies.

Each folder is one learner; read them down: `q_learning` (policies, paper, eq. 3).
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.learners.q_learning.linear_policy import LinearTablePolicy
    from halfseen.learners.q_learning.q_learner import CensoredQLearner

__all__ = ["CensoredQLearner", "LinearTablePolicy"]

__getattr__ = lazy_names(
    __name__,
    {"CensoredQLearner": "q_learning.q_learner", "LinearTablePolicy": "q_learning.linear_policy"},
)
