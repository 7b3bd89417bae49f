"""From weighted logs to predictions and policies.

Each folder is one learner; read them down: `svm` (targets that may be cut, paper, eqs. 1 and 2) → `grasp` (does a grasp
succeed?) → `q_learning` (policies, eq. 3).
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.learners.grasp.attempts import attempts
    from halfseen.learners.grasp.beta_grasp import BetaGrasp
    from halfseen.learners.grasp.svm_grasp import SVMGrasp
    from halfseen.learners.q_learning.bootstrap import QBootstrap, bootstrap
    from halfseen.learners.q_learning.explanation import LearnedExplainer
    from halfseen.learners.q_learning.flat_policy import FlatPolicy
    from halfseen.learners.q_learning.linear_policy import LinearTablePolicy
    from halfseen.learners.q_learning.q_learner import CensoredQLearner
    from halfseen.learners.svm.classifier import CensoredSVC
    from halfseen.learners.svm.regressor import CensoredSVR
    from halfseen.learners.svm.set_kernel import SetKernel
    from halfseen.learners.svm.targets import survival_array

__all__ = [
    "BetaGrasp",
    "CensoredQLearner",
    "CensoredSVC",
    "CensoredSVR",
    "FlatPolicy",
    "LearnedExplainer",
    "LinearTablePolicy",
    "QBootstrap",
    "SVMGrasp",
    "SetKernel",
    "attempts",
    "bootstrap",
    "survival_array",
]

__getattr__ = lazy_names(
    __name__,
    {
        "BetaGrasp": "grasp.beta_grasp",
        "CensoredQLearner": "q_learning.q_learner",
        "CensoredSVC": "svm.classifier",
        "CensoredSVR": "svm.regressor",
        "FlatPolicy": "q_learning.flat_policy",
        "LearnedExplainer": "q_learning.explanation",
        "LinearTablePolicy": "q_learning.linear_policy",
        "QBootstrap": "q_learning.bootstrap",
        "SVMGrasp": "grasp.svm_grasp",
        "SetKernel": "svm.set_kernel",
        "attempts": "grasp.attempts",
        "bootstrap": "q_learning.bootstrap",
        "survival_array": "svm.targets",
    },
)
