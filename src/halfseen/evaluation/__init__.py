"""The value of a policy before it runs: off-policy evaluation on logs of which trajectories were right-censored.

The modules, in order: `targets` (the policy's probabilities, and its baselines) → `specification` (the task, and the
models of Q and of the cuts) → `weights` (importance weights of trajectories, and the doubly robust value), `marginal`
(the same by states) → `problem` (one log, one policy) → `logging_rule` (the logging policy without its exploration) →
`comparison` → `verdict`. `off_policy` combines them; `held_out` evaluates a way of learning by the log that was used
for learning.
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.evaluation.comparison import Comparison
    from halfseen.evaluation.estimate import Estimate
    from halfseen.evaluation.evaluation import Evaluation
    from halfseen.evaluation.held_out import HeldOutVerdict, held_out_verdict
    from halfseen.evaluation.off_policy import QSpec, evaluate
    from halfseen.evaluation.targets import Baseline, FixedSequence

__all__ = [
    "Baseline",
    "Comparison",
    "Estimate",
    "Evaluation",
    "FixedSequence",
    "HeldOutVerdict",
    "QSpec",
    "evaluate",
    "held_out_verdict",
]

__getattr__ = lazy_names(
    __name__,
    {
        "Comparison": "comparison",
        "Estimate": "estimate",
        "Evaluation": "evaluation",
        "FixedSequence": "targets",
        "HeldOutVerdict": "held_out",
        "Baseline": "targets",
        "QSpec": "specification",
        "evaluate": "off_policy",
        "held_out_verdict": "held_out",
    },
)
