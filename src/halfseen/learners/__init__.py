"""From weighted logs to predictions and policies.

Each folder is one learner; read them down: `svm` (targets that may be cut, paper, eqs. 1 and 2) → `q_learning`
(policies, eq. 3). Neither knows of tables; `halfseen.tables` does.
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.learners.q_learning.bootstrap import QBootstrap, bootstrap
    from halfseen.learners.q_learning.flat_policy import FlatPolicy
    from halfseen.learners.q_learning.q_learner import CensoredQLearner
    from halfseen.learners.svm.classifier import CensoredSVC
    from halfseen.learners.svm.regressor import CensoredSVR
    from halfseen.learners.svm.set_kernel import SetKernel
    from halfseen.learners.svm.targets import survival_array

__all__ = [
    "CensoredQLearner",
    "CensoredSVC",
    "CensoredSVR",
    "FlatPolicy",
    "QBootstrap",
    "SetKernel",
    "bootstrap",
    "survival_array",
]

__getattr__ = lazy_names(
    __name__,
    {
        "CensoredQLearner": "q_learning.q_learner",
        "CensoredSVC": "svm.classifier",
        "CensoredSVR": "svm.regressor",
        "FlatPolicy": "q_learning.flat_policy",
        "QBootstrap": "q_learning.bootstrap",
        "SetKernel": "svm.set_kernel",
        "bootstrap": "q_learning.bootstrap",
        "survival_array": "svm.targets",
    },
)
