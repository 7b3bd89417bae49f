"""A policy against each of its baselines, by paired differences, and one verdict over all of them.

The contributions of a trajectory to the value of the policy and to that of a baseline share its noise, so their paired
difference has a much narrower interval than the two values.

*Better than all* is an intersection–union test [Berger1982]_: each of the paired differences must be significant at the
level itself. No correction is needed, because the claim is false only if one of them is false, and that test errs at
the level. So the strongest baseline may be identified on the same log. Verdicts on single baselines are different:
among several true nulls one may be rejected by chance. These verdicts use p-values adjusted by Hochberg's step-up
procedure [Hochberg1988]_. Its first step is the intersection–union test, so the two cannot contradict each other. With
two baselines it is valid for any correlation of two normal differences; with more it needs non-negative correlations,
which the noise of the policy, common to all differences, induces.

A ratio of two means over the same trajectories has an interval by the delta method. With φ_i and ψ_i the contributions
of trajectory i to the two means, and r = φ̄/ψ̄, its contribution to the ratio is r + (φ_i − r ψ_i)/ψ̄. This is a paired
difference, so noise common to both has little effect on the ratio. The jackknife takes ratios, too.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from halfseen.evaluation.estimate import Estimate, Possible, estimate_of, within
from halfseen.evaluation.verdict import Needed, Verdict, needed, undone_at, verdict_of
from halfseen.shapes import Float

WRONG_BY = 0.5
"""Assumed error, in standard deviations (of targets about Q), of the regression of cut stages where no weight corrects
it, which two policies share; and of Q where weights were truncated, which each policy has separately. Our choice, made
on logs of the cell that are not in `benchmarks/verdicts.py`."""


class Contender(NamedTuple):
    """Evidence of a log on the value of a policy."""

    name: str
    values: Float[np.ndarray, " n"] | None = None
    """Contribution of each trajectory; None if the log does not have such an action."""
    without: Float[np.ndarray, " K"] | None = None
    """The same value without each fold."""
    errors: Float[np.ndarray, "n T"] | None = None
    """Factor of 1/Ĝ of each completed stage in the value."""
    uncorrected: float = 0.0
    """Bias per standard deviation of error of the regression of cut stages [reward]."""
    truncated: float = 0.0
    """Bias per standard deviation of error of Q where weights were truncated [reward]."""
    possible: Possible | None = None
    """Range of possible returns."""
    by_model: float = np.nan
    """Value by Q alone."""
    weights: Float[np.ndarray, "n T"] | None = None
    """Of the stages, with mean 1."""
    deviation: float = 0.0
    """Standard deviation of the targets of stages about Q [reward]."""
    effective_sample_size: float = 0.0
    why_unknown: str | None = None
    """Why the value is unknown, if it is."""

    def estimate(self, level: float) -> Estimate:
        """Its value."""
        assert self.values is not None
        bias = WRONG_BY * (abs(self.uncorrected) + self.truncated)
        least = 0.0 if self.weights is None else _error_of_alike(self.weights, self.deviation)
        found = estimate_of(self.values, self.effective_sample_size, level, self.without, bias, least)
        return found if self.possible is None else within(found, *self.possible)

    def alike_less(self, other: "Contender") -> float:
        """Standard error of the difference if all residuals were of equal size; 0 if weights are not known."""
        if self.weights is None or other.weights is None:
            return 0.0
        return _error_of_alike(self.weights - other.weights, max(self.deviation, other.deviation))

    def less(self, other: "Contender", level: float) -> Estimate:
        """Its value minus that of another, by paired differences."""
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
    """Standard error of a weighted sum of residuals of equal size, so it does not depend on those of a few stages.

    If few stages have large weights, their residuals may be small by chance, and then their scatter underestimates the
    error.
    """
    return deviation * float(np.sqrt((weights**2).sum())) / len(weights)


SEVERITY: dict[Verdict, int] = {"not better": 0, "inconclusive": 1, "better": 2}


@dataclass(frozen=True)
class Comparison:
    """A policy compared with one baseline.

    Parameters
    ----------
    baseline
        Its name in plain words.
    value
        Its value, doubly robust; None if the log does not have such an action.
    difference
        Value of the policy minus that of the baseline, by paired differences; None if `value` is.
    p
        Two-sided p-value of a difference of 0; None if no interval is valid.
    adjusted_p
        The same, adjusted for the number of baselines (Hochberg).
    verdict
        ``"better"``, ``"not better"`` or ``"inconclusive"``, by the adjusted p-value.
    reason
        The reason, in one sentence.
    gamma
        Γ, the strength of an unrecorded cause of cuts that would overturn the verdict (see `verdict`); None if there is
        nothing to overturn or nothing was cut.
    share
        Value of the baseline as a multiple of that of the logging policy; None if the latter is not known to be above
        0.
    needed
        Factor by which the number of trajectories must grow for a decision; None if it is not known.
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
    """Compare a policy with its baselines; `level` is that of the intervals and the verdicts.

    `excess` is 1/Ĝ − 1 of each completed stage, 0 elsewhere; None if nothing was cut.
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
            # The difference by Q alone, if both have a Q.
            gain = ours.by_model - baseline.by_model
            more = needed(difference, gain if np.isfinite(gain) else difference.value, level, ours.alike_less(baseline))
        if difference is None or adjusted is None:
            why = ours.why_unknown or baseline.why_unknown
            verdict, reason = "inconclusive", why or f"the value of {baseline.name} is unknown"
        else:
            verdict, reason = verdict_of(difference, baseline.name, adjusted <= 1.0 - level, unit, more)
            # For two identical policies there is nothing to overturn.
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
    """Adjusted p-values: k·p for the k-th largest, or that of a larger one if it is smaller [Hochberg1988]_.

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
    """The comparison that decides the joint verdict: the least favourable, then that with the lowest interval."""

    def least(comparison: Comparison) -> tuple[int, float]:
        low = -np.inf if comparison.difference is None else comparison.difference.low
        return SEVERITY[comparison.verdict], low

    return min(comparisons, key=least)


def joint_reason(comparisons: Sequence[Comparison]) -> str:
    """Reason of the joint verdict, in one sentence that names the baselines."""
    main = deciding(comparisons)
    beaten = [each for each in comparisons if each is not main and each.verdict == "better"]
    why, semicolon, remedy = main.reason.partition("; ")
    if not beaten:
        return main.reason
    more = [(each.difference.value, each.baseline) for each in beaten if each.difference is not None]
    others = " and ".join(f"{gain:.3g} more than {baseline}" for gain, baseline in more)
    # A reason without an interval does not begin with what the policy earns.
    though = "though" if main.adjusted_p is not None else "though it earns"
    return f"{why}, {'and' if main.verdict == 'better' else though} {others}{semicolon}{remedy}"


def share_of(policy: Contender, today: Contender, level: float) -> Estimate | None:
    """Value of a policy as a multiple of another's; both share the bias of what replaces cuts.

    None if the other's interval contains 0 or its value is not above 0.
    """
    return _quotient(policy, today, level, lambda share: abs(policy.uncorrected - share * today.uncorrected))


def rate_of(earned: Contender, took: Contender, level: float) -> Estimate | None:
    """Reward per unit of cost; the regressions of cut stages for both may be biased.

    None if the cost is not known to be above 0.
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
