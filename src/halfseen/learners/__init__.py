"""From weighted logs to predictions and policies.

Each folder is one learner; read them down: `svm` (targets that may be cut, paper, eqs. 1 and 2) → `q_learning`
(policies, eq. 3). Neither knows of tables; `halfseen.tables` does.
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.learners.q_learning.bootstrap import QBootstrap, bootstrap
    from halfseen.learners.q_learning.flat_policy import FlatPolicy
    from halfseen.learners.q_learning.named_actions import NamedActions
    from halfseen.learners.q_learning.q_learner import CensoredQLearner
    from halfseen.learners.q_learning.q_space import CrossValidation, KernelQ, LinearQ, QuadraticQ
    from halfseen.learners.q_learning.targets import BuckleyJames, DoublyRobust, Unweighted, Weighted
    from halfseen.learners.q_learning.task import Task
    from halfseen.learners.svm.classifier import CensoredSVC
    from halfseen.learners.svm.regressor import CensoredSVR
    from halfseen.learners.svm.set_kernel import SetKernel
    from halfseen.learners.svm.targets import survival_array

__all__ = [
    "BuckleyJames",
    "CensoredQLearner",
    "CensoredSVC",
    "CensoredSVR",
    "CrossValidation",
    "DoublyRobust",
    "FlatPolicy",
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
        "BuckleyJames": "q_learning.targets",
        "CensoredQLearner": "q_learning.q_learner",
        "CensoredSVC": "svm.classifier",
        "CensoredSVR": "svm.regressor",
        "CrossValidation": "q_learning.q_space",
        "DoublyRobust": "q_learning.targets",
        "FlatPolicy": "q_learning.flat_policy",
        "KernelQ": "q_learning.q_space",
        "LinearQ": "q_learning.q_space",
        "NamedActions": "q_learning.named_actions",
        "QBootstrap": "q_learning.bootstrap",
        "QuadraticQ": "q_learning.q_space",
        "SetKernel": "svm.set_kernel",
        "Task": "q_learning.task",
        "Unweighted": "q_learning.targets",
        "Weighted": "q_learning.targets",
        "bootstrap": "q_learning.bootstrap",
        "survival_array": "svm.targets",
    },
)
