"""From weighted logs to predictions and policies.

Each folder is one learner; read them down: `svm` (targets that may be cut, paper, eqs. 1 and 2) → `grasp` (does a grasp
succeed?) → `q_learning` (policies, eq. 3) → `policy_folder` (policies on disk) → `policy_shares`, `policy_reasons`
(what a policy does, and why).
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.learners.grasp.attempts import attempts
    from halfseen.learners.grasp.beta_grasp import BetaGrasp
    from halfseen.learners.grasp.svm_grasp import SVMGrasp
    from halfseen.learners.policy_folder import StoredPolicy, read_policy, write_policy
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
    "StoredPolicy",
    "attempts",
    "bootstrap",
    "read_policy",
    "survival_array",
    "write_policy",
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
        "StoredPolicy": "policy_folder",
        "attempts": "grasp.attempts",
        "bootstrap": "q_learning.bootstrap",
        "read_policy": "policy_folder",
        "survival_array": "svm.targets",
        "write_policy": "policy_folder",
    },
)
