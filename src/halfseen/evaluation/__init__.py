"""The value of a policy before it runs: off-policy evaluation on logs of which trajectories were right-censored.

Read it down: `targets` (what the policy would do, and what it is compared with) → `specification` (what is decided, and
how Q and the cuts are modelled) → `weights` (what each trajectory stands for, and the doubly robust value), `marginal`
(the same by states) → `problem` (one log, one policy) → `logging_rule` (the logging policy without its exploration) →
`comparison` → `verdict`; `off_policy` puts them together, and `held_out` judges a way of learning by the log that was
learned from.
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
