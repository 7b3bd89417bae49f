"""From weighted logs to predictions and policies.

Two learners: `svm` predicts targets that may be censored (paper, eqs. 1 and 2), and censored Q-learning in this folder
learns policies (eq. 3). Neither depends on tables; `halfseen.tables` builds on them.
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.learning.discrete_policy import DiscretePolicy
    from halfseen.learning.named_task import NamedActions
    from halfseen.learning.q_learner import CensoredQLearner
    from halfseen.learning.q_space import CrossValidation, KernelQ, LinearQ, QuadraticQ
    from halfseen.learning.resampling import QBootstrap, bootstrap
    from halfseen.learning.svm.estimators import CensoredSVC, CensoredSVR
    from halfseen.learning.svm.kernels import SetKernel
    from halfseen.learning.svm.rows import survival_array
    from halfseen.learning.targets import BuckleyJames, DoublyRobust, Unweighted, Weighted
    from halfseen.learning.task import Task

__all__ = [
    "BuckleyJames",
    "CensoredQLearner",
    "CensoredSVC",
    "CensoredSVR",
    "CrossValidation",
    "DiscretePolicy",
    "DoublyRobust",
    "KernelQ",
    "LinearQ",
    "NamedActions",
    "QBootstrap",
    "QuadraticQ",
    "SetKernel",
    "Task",
    "Unweighted",
    "Weighted",
    "bootstrap",
    "survival_array",
]

__getattr__ = lazy_names(
    __name__,
    {
        "BuckleyJames": "targets",
        "CensoredQLearner": "q_learner",
        "CensoredSVC": "svm.estimators",
        "CensoredSVR": "svm.estimators",
        "CrossValidation": "q_space",
        "DoublyRobust": "targets",
        "DiscretePolicy": "discrete_policy",
        "KernelQ": "q_space",
        "LinearQ": "q_space",
        "NamedActions": "named_task",
        "QBootstrap": "resampling",
        "QuadraticQ": "q_space",
        "SetKernel": "svm.kernels",
        "Task": "task",
        "Unweighted": "targets",
        "Weighted": "targets",
        "bootstrap": "resampling",
        "survival_array": "svm.rows",
    },
)
