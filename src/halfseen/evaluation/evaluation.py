"""What is known of a policy from a log: three estimates, the logging policy's own, and a verdict."""

from dataclasses import asdict, dataclass
from typing import Any

from halfseen.evaluation.estimate import Estimate
from halfseen.evaluation.verdict import Verdict


@dataclass(frozen=True)
class Evaluation:
    """The value E[Σ_t R_t] of a policy, from a log that another one made.

    Parameters
    ----------
    importance_sampling
        From the weights alone: rewards of paths that did as the policy would.
    fitted_q
        From the model alone: Q̂ of the policy where paths begin. Its interval does not know of a wrong model.
    doubly_robust
        From both, right if one of them is; this is the one to read.
    logging
        What the logging policy earns, had nothing been cut.
    difference
        Doubly robust value less that of the logging policy, path by path.
    verdict
        ``"better"``, ``"not better"`` or ``"cannot be said"``.
    reason
        Why, in one sentence.
    support
        Of each stage, the share of the logged actions that the policy would take at all.
    num_paths
        Paths of the log.
    level
        Of the intervals.
    """

    importance_sampling: Estimate
    fitted_q: Estimate
    doubly_robust: Estimate
    logging: Estimate
    difference: Estimate
    verdict: Verdict
    reason: str
    support: tuple[float, ...]
    num_paths: int
    level: float

    def as_dict(self) -> dict[str, Any]:
        """Everything, ready for JSON."""
        return asdict(self)

    @property
    def sentence(self) -> str:
        """The verdict and its reason."""
        return f"{self.verdict.capitalize()}: {self.reason}."

    def __str__(self) -> str:
        rows = {
            "doubly robust": self.doubly_robust,
            "importance sampling": self.importance_sampling,
            "fitted Q": self.fitted_q,
            "logging policy": self.logging,
            "difference": self.difference,
        }
        head = f"{'':<20}{'value':>10}{f'{self.level:.0%} interval':>24}{'effective sample size':>23}"
        return "\n".join([self.sentence, "", head, *(_line(name, each) for name, each in rows.items())])


def _line(name: str, estimate: Estimate) -> str:
    interval = f"{estimate.low:.4g} to {estimate.high:.4g}"
    return f"{name:<20}{estimate.value:>10.4g}{interval:>24}{estimate.effective_sample_size:>23.1f}"
