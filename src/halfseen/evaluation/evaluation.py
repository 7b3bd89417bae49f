"""What is known of a policy from a log: three estimates, what its opponents earn, and a verdict."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from halfseen.evaluation.comparison import Comparison
from halfseen.evaluation.estimate import Estimate
from halfseen.evaluation.per_hour import PerHour
from halfseen.evaluation.sensitivity import in_words
from halfseen.evaluation.verdict import Verdict


@dataclass(frozen=True)
class Evaluation:
    """The value E[Σ_t R_t] of a policy, from a log that another one made.

    Parameters
    ----------
    importance_sampling
        From the weights alone: rewards of trajectories that did as the policy would.
    fitted_q
        From the model alone: Q̂ of the policy where trajectories begin. Its interval does not know of a wrong model.
    doubly_robust
        From both, right if one of them is; this is the one to read.
    logging
        What the logging policy earns, had nothing been cut.
    difference
        Doubly robust value less that of the opponent that the verdict rests on, trajectory by trajectory; less that of
        the logging policy where the log has not what this opponent does.
    verdict
        ``"better"``: than every opponent; ``"not better"``: than some; or ``"cannot be said"``.
    reason
        Why, in one sentence that names the opponent.
    support
        Of each stage, the share of the logged actions that the policy would take at all.
    num_trajectories
        Trajectories of the log.
    level
        Of the intervals.
    comparisons
        The policy against each opponent.
    notes
        How the logging policy without its exploration was found, or why it was not.
    reward_unit
        What rewards are counted in; None if nobody has said.
    share
        The doubly robust value as a multiple of what the logging policy earns; None where that is not known to be
        above 0.
    per_hour
        What the policy and the logging policy earn in an hour of the clock; None where nobody asked.
    """

    importance_sampling: Estimate
    fitted_q: Estimate
    doubly_robust: Estimate
    logging: Estimate
    difference: Estimate
    verdict: Verdict
    reason: str
    support: tuple[float, ...]
    num_trajectories: int
    level: float
    comparisons: tuple[Comparison, ...] = ()
    notes: tuple[str, ...] = ()
    reward_unit: str | None = None
    share: Estimate | None = None
    per_hour: PerHour | None = None

    def as_dict(self) -> dict[str, Any]:
        """Everything, ready for JSON."""
        return asdict(self)

    @property
    def sentence(self) -> str:
        """The verdict and its reason."""
        return f"{self.verdict.capitalize()}: {self.reason}."

    @property
    def sensitivity(self) -> str:
        """How strong an unrecorded cause of cuts would have to be to undo the verdict, in one sentence; "" if open."""
        if self.verdict == "cannot be said":
            return ""
        gammas = [one.gamma for one in self.comparisons if one.verdict == self.verdict and one.gamma is not None]
        # "Better" falls with the first opponent that is not beaten; "not better" stands while one is not.
        return in_words((min if self.verdict == "better" else max)(gammas)) + "." if gammas else ""

    def __str__(self) -> str:
        interval = f"{100.0 * self.level:g}% interval"
        rows = {
            "doubly robust": self.doubly_robust,
            "importance sampling": self.importance_sampling,
            "fitted Q": self.fitted_q,
        }
        head = ("", "value", interval, "effective sample size")
        values = [head, *((name, *_cells(each), f"{each.effective_sample_size:.1f}") for name, each in rows.items())]
        head = ("against", "value", interval, "difference", interval, "adjusted p", "verdict")
        against = [head, *(_against(each) for each in self.comparisons)]
        said = [self.sentence, *filter(None, [self.sensitivity])]
        return "\n".join([*said, "", *_aligned(values), "", *_aligned(against)])


def _cells(estimate: Estimate | None) -> tuple[str, str]:
    if estimate is None:
        return "", ""
    return f"{estimate.value:.4g}", f"{estimate.low:.4g} to {estimate.high:.4g}"


def _against(comparison: Comparison) -> tuple[str, ...]:
    p = "" if comparison.adjusted_p is None else f"{comparison.adjusted_p:.2g}"
    return (comparison.opponent, *_cells(comparison.value), *_cells(comparison.difference), p, comparison.verdict)


def _aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(
            cell.rjust(width) if k else cell.ljust(width)
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
        )
        for row in rows
    ]
