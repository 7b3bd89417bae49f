"""A policy beside each of its baselines, by paired differences, and one verdict over all of them.

What a trajectory adds to the value of the policy and what it adds to that of a baseline share its luck, so their
difference trajectory by trajectory has a much narrower interval than the two values.

*Better than all* is an intersection–union test [Berger1982]_: each of the paired differences has to be significant at
the level itself, and no correction is due, for the claim is wrong only if one of them is, which errs at the level. So
the strongest baseline may be found on the same log. What is said of each baseline alone is another matter: of several
true nulls one may look false by chance. Those verdicts rest on p-values that are adjusted by Hochberg's step-up
[Hochberg1988]_: its first step is that very test, so the two cannot contradict each other. For two baselines
it holds whatever the correlation of two normal differences; for more it needs one that is not negative, and the luck of
the policy, which all differences share, makes for that.

A mean as a multiple of another to which the same trajectories add, with its interval by the delta method.

With φ_i and ψ_i what trajectory i adds to the two, and r = φ̄/ψ̄, what it adds to the quotient is r + (φ_i − r ψ_i)/ψ̄:
a paired difference, so that what moves both (the luck of a trajectory) moves the quotient little. The jackknife
divides, too.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from halfseen.evaluation.estimate import Estimate, Possible, estimate_of, within
from halfseen.evaluation.verdict import Needed, Verdict, needed, undone_at, verdict_of
from halfseen.shapes import Float

WRONG_BY = 0.5
"""Standard deviations (of targets about Q) by which the regression of cut stages may be wrong where no weight corrects
it, where two policies meet the same mistake; and Q where weights were cut off, where each policy makes its own. Our
choice, made on logs of the cell that `benchmarks/verdicts.py` has not."""


class Contender(NamedTuple):
    """What a log knows of what a policy earns."""

    name: str
    values: Float[np.ndarray, " n"] | None = None
    """What each trajectory adds to it; None where the log has no such action."""
    without: Float[np.ndarray, " K"] | None = None
    """The same value without each fold."""
    errors: Float[np.ndarray, "n T"] | None = None
    """What 1/Ĝ of each completed stage is multiplied by in it."""
    uncorrected: float = 0.0
    """What it is off by for each standard deviation that the regression of cut stages is [reward]."""
    truncated: float = 0.0
    """The same for each one that Q is, where weights were cut off."""
    possible: Possible | None = None
    """What a trajectory can earn at all."""
    by_model: float = np.nan
    """What Q alone says."""
    weights: Float[np.ndarray, "n T"] | None = None
    """Of the stages, with mean 1."""
    deviation: float = 0.0
    """Standard deviation of the targets of stages about Q [reward]."""
    effective_sample_size: float = 0.0
    why_unknown: str | None = None
    """Why nothing is to be believed, if so."""

    def estimate(self, level: float) -> Estimate:
        """What it earns."""
        assert self.values is not None
        bias = WRONG_BY * (abs(self.uncorrected) + self.truncated)
        least = 0.0 if self.weights is None else _error_of_alike(self.weights, self.deviation)
        found = estimate_of(self.values, self.effective_sample_size, level, self.without, bias, least)
        return found if self.possible is None else within(found, *self.possible)

    def alike_less(self, other: "Contender") -> float:
        """Standard error of that, were all residuals alike; 0 where weights are not known."""
        if self.weights is None or other.weights is None:
            return 0.0
        return _error_of_alike(self.weights - other.weights, max(self.deviation, other.deviation))

    def less(self, other: "Contender", level: float) -> Estimate:
        """How much more it earns than another, trajectory by trajectory."""
        assert self.values is not None
        assert other.values is not None
        size = min(self.effective_sample_size, other.effective_sample_size)
        without = None if self.without is None or other.without is None else self.without - other.without
        bias = WRONG_BY * (abs(self.uncorrected - other.uncorrected) + self.truncated + other.truncated)
        found = estimate_of(self.values - other.values, size, level, without, bias, self.alike_less(other))
        if self.possible is None:
            return found
        theirs = other.estimate(level)
        return within(found, self.possible.low - theirs.high, self.possible.high - theirs.low)


def _error_of_alike(weights: Float[np.ndarray, "n T"], deviation: float) -> float:
    """Standard error of a weighted sum of residuals, were all as large: it does not hang on those of a few stages.

    Where few stages weigh much, theirs may be small by chance, and just then their scatter says too little.
    """
    return deviation * float(np.sqrt((weights**2).sum())) / len(weights)


SEVERITY: dict[Verdict, int] = {"not better": 0, "inconclusive": 1, "better": 2}


@dataclass(frozen=True)
class Comparison:
    """A policy against one baseline.

    Parameters
    ----------
    baseline
        In plain words.
    value
        What it earns, doubly robust; None where the log has no such action.
    difference
        Value of the policy less that of the baseline, trajectory by trajectory; None where that of the baseline is.
    p
        Of the difference being 0, two-sided; None where no interval is to be believed.
    adjusted_p
        The same among all baselines (Hochberg).
    verdict
        ``"better"``, ``"not better"`` or ``"inconclusive"``, by the adjusted p-value.
    reason
        Why, in one sentence.
    gamma
        Γ, how strong an unrecorded cause of cuts would have to be to undo the verdict (see `verdict`); None where
        there is nothing to undo or nothing was cut.
    share
        What the baseline earns as a multiple of what the logging policy does; None where that is not known to be
        above 0.
    needed
        How many times as many trajectories would decide; None where that is not known.
    """

    baseline: str
    value: Estimate | None
    difference: Estimate | None
    p: float | None
    adjusted_p: float | None
    verdict: Verdict
    reason: str
    gamma: float | None = None
    share: Estimate | None = None
    needed: Needed | None = None


def compared(
    ours: Contender,
    theirs: Sequence[Contender],
    level: float,
    excess: Float[np.ndarray, "n T"] | None = None,
    unit: str | None = None,
) -> tuple[Comparison, ...]:
    """Compare a policy with its baselines, at the level of the intervals and of the verdicts.

    `excess` is 1/Ĝ − 1 of each completed stage, 0 elsewhere; None where nothing was cut.
    """
    unknown = [ours.values is None or each.values is None for each in theirs]
    differences = [None if no else ours.less(each, level) for each, no in zip(theirs, unknown, strict=True)]
    p = [
        None if one is None or ours.why_unknown or each.why_unknown else one.p_value
        for each, one in zip(theirs, differences, strict=True)
    ]
    adjusted = iter(hochberg(np.array([each for each in p if each is not None])))
    adjusted_p = [None if each is None else float(next(adjusted)) for each in p]
    found = []
    for baseline, difference, p_value, adjusted in zip(theirs, differences, p, adjusted_p, strict=True):
        more = gamma = None
        if difference is not None:
            # The difference that Q alone says, where there is a Q of both.
            gain = ours.by_model - baseline.by_model
            more = needed(difference, gain if np.isfinite(gain) else difference.value, level, ours.alike_less(baseline))
        if difference is None or adjusted is None:
            why = ours.why_unknown or baseline.why_unknown
            verdict, reason = "inconclusive", why or f"nothing is known of what {baseline.name} earns"
        else:
            verdict, reason = verdict_of(difference, baseline.name, adjusted <= 1.0 - level, unit, more)
            # Of two policies that do the same there is nothing to be undone.
            errors = None if ours.errors is None or baseline.errors is None else ours.errors - baseline.errors
            is_open = verdict == "inconclusive" or difference.standard_error == 0.0
            if excess is not None and excess.any() and errors is not None and not is_open:
                gamma = undone_at(difference, excess, errors)
        value = None if baseline.values is None else baseline.estimate(level)
        found.append(
            Comparison(baseline.name, value, difference, p_value, adjusted, verdict, reason, gamma, needed=more)
        )
    return tuple(found)


def hochberg(p: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
    """Adjusted p-values: of the k-th largest k·p, or that of a larger one if that is less [Hochberg1988]_.

    Examples
    --------
    >>> hochberg(np.array([0.01, 0.04]))
    array([0.02, 0.04])
    """
    down = np.argsort(-p, kind="stable")
    adjusted = np.empty_like(p)
    adjusted[down] = np.minimum.accumulate(np.arange(1, len(p) + 1) * p[down])
    return adjusted


def deciding(comparisons: Sequence[Comparison]) -> Comparison:
    """The one that the verdict over all rests on: the least favourable, then that of the lowest interval."""

    def least(comparison: Comparison) -> tuple[int, float]:
        low = -np.inf if comparison.difference is None else comparison.difference.low
        return SEVERITY[comparison.verdict], low

    return min(comparisons, key=least)


def joint_reason(comparisons: Sequence[Comparison]) -> str:
    """Why the verdict over all is what it is, in one sentence that names the baselines."""
    main = deciding(comparisons)
    beaten = [each for each in comparisons if each is not main and each.verdict == "better"]
    why, semicolon, remedy = main.reason.partition("; ")
    if not beaten:
        return main.reason
    more = [(each.difference.value, each.baseline) for each in beaten if each.difference is not None]
    others = " and ".join(f"{gain:.3g} more than {baseline}" for gain, baseline in more)
    return f"{why}, {'and' if main.verdict == 'better' else 'though'} {others}{semicolon}{remedy}"


def share_of(policy: Contender, today: Contender, level: float) -> Estimate | None:
    """What a policy earns as a multiple of what another does; both meet the same mistake of what stands for cuts.

    None where the other's interval holds 0, or what it earns is not above 0.
    """
    return _quotient(policy, today, level, lambda share: abs(policy.uncorrected - share * today.uncorrected))


def rate_of(earned: Contender, took: Contender, level: float) -> Estimate | None:
    """What is earned for each unit of what it took; two regressions stand for cuts, and may both be wrong.

    None where nobody knows that it took anything.
    """
    return _quotient(earned, took, level, lambda rate: abs(earned.uncorrected) + abs(rate * took.uncorrected))


def _quotient(
    above: Contender, below: Contender, level: float, uncorrected_at: Callable[[float], float]
) -> Estimate | None:
    if above.values is None or below.values is None:
        return None
    lower = below.estimate(level)
    if not lower.low > 0.0:
        return None
    quotient = float(above.values.mean()) / lower.value
    influence = quotient + (above.values - quotient * below.values) / lower.value
    size = min(above.effective_sample_size, below.effective_sample_size)
    truncated = above.truncated + abs(quotient) * below.truncated
    bias, without = WRONG_BY * (uncorrected_at(quotient) + truncated) / lower.value, None
    if above.without is not None and below.without is not None and (below.without > 0.0).all():
        without = above.without / below.without
    return estimate_of(influence, size, level, without, bias)
