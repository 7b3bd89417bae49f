"""Better than a baseline, not better, or inconclusive; the reason in one plain sentence; and the sample size needed.

The half-width of an interval shrinks as 1/√n: its standard error σ is the spread of the contributions of trajectories,
and the bias β that it allows for is due to stages whose ends a longer log would show. With a difference of δ,

    n* = n·((β + (z₀.₉₇₅ + z₀.₈) σ) / |δ|)²

trajectories show it in four logs of five. δ is the difference by Q alone, which has a smaller error than the estimate
to be tested, and an independent one: a log that missed a difference usually has a low estimate of it. The estimated σ
of such a log is usually too large, because one heavy residual suffices. So σ is that of residuals of equal size, if
weights are known, multiplied by `REST` for everything else that is fitted. δ is taken to be known up to σ.

Sensitivity to a cause of cuts that was not recorded (Γ).

Weights 1/Ĝ are right if, given what was recorded, cuts are independent of the future. Suppose that there is another
cause, and that among stages that look alike it changes the odds of being observed to the end by up to a factor of Γ
relative to the model, in either direction: the true weight of a completed stage is then some

    w* ∈ [1 + (w − 1)/Γ, 1 + (w − 1)Γ],    w = 1/Ĝ(U_t⁻)

(the marginal sensitivity model [Tan2006]_). Weights of a stage have a known mean, so what one stage gains another loses
[DornGuo2023]_. Among these weights, those that shift Σ_t E[w* v_t] most, with v the weighted error of Q, assign Γ to
the stages below the 1/(Γ + 1)-quantile of v (by w − 1), and 1/Γ to those above, or vice versa.

Γ is the value at which the interval, shifted by this amount, reaches 0 with its nearer end. v holds the whole error of
Q, part of which the regression of cut stages may predict; so the true Γ is as large or larger. The effect of other
weights on the width of the interval is ignored. Γ = 1 trusts the model; Γ = 2 is a cause that doubles or halves the
odds.
"""

from dataclasses import dataclass
from math import exp, log
from statistics import NormalDist
from typing import Any, Literal

import numpy as np

from halfseen.evaluation.estimate import Estimate
from halfseen.shapes import Float

Verdict = Literal["better", "not better", "inconclusive"]

FEWEST_TRAJECTORIES = 10.0
"""Effective sample size below which no interval is valid with products of ratios."""

FEWEST_BY_STATES = 2.0
"""The same with marginal weights, whose spread is estimated from more trajectories."""

MOST_UNEXPLORED = 0.02
"""Share of the stages above which Q alone would decide for the policy."""

LEVEL = 0.95
"""The default."""

MANY_TRAJECTORIES = 1e6
"""A larger log is impractical."""


REST = 1.15
"""Our choice, made on logs of the cell in `examples/bin_cell`."""
POWER = 0.8
"""Probability that a log decides."""
MANY_TIMES = 100.0
"""A longer log by more than this factor is impractical."""


@dataclass(frozen=True)
class Needed:
    """Factor by which a log must grow to decide, at least 1; ∞ if no practical log does."""

    times: float
    low: float
    high: float
    gain: float
    """δ."""


def needed(difference: Estimate, gain: float, level: float, alike: float | None = None) -> Needed:
    """Compute n*/n, and its range for the uncertainty of δ.

    Parameters
    ----------
    difference
        σ and β.
    gain
        δ.
    level
        Of the interval, which is to exclude 0.
    alike
        Standard error if all residuals were of equal size; None if not known.
    """
    normal, error = NormalDist(), REST * alike if alike else difference.standard_error
    reach = difference.bias + (normal.inv_cdf((1.0 + level) / 2.0) + normal.inv_cdf(POWER)) * error

    def times(known: float) -> float:
        # Compare before squaring, which may overflow.
        is_near = known > 0.0 and reach <= np.sqrt(MANY_TIMES) * known
        return max((reach / known) ** 2, 1.0) if is_near else np.inf

    return Needed(times(abs(gain)), times(abs(gain) + error), times(abs(gain) - error), gain)


def why_unknown(
    who: str,
    support: Float[np.ndarray, " T"],
    effective_sample_size: float,
    unseen: str | None = None,
    num_trajectories: int = 0,
    trajectories_for_one: float = np.inf,
    fewest: float = FEWEST_TRAJECTORIES,
    unexplored: float = 0.0,
    *,
    is_estimated: bool = False,
) -> str | None:
    """Return why a log does not identify the value of a policy; None if it does.

    Parameters
    ----------
    who
        The policy, or its baseline.
    support
        For each stage in the log, the share of the logged actions to which it gives positive probability.
    effective_sample_size
        Of the trajectories, as weighted for the policy.
    unseen
        An action of the policy that was never completed in the log.
    num_trajectories
        Trajectories of the log.
    trajectories_for_one
        Number of logged trajectories that are worth one of the policy.
    fewest
        The smallest effective sample size that is accepted.
    unexplored
        Share of the stages in which the policy deviates where the log never did.
    is_estimated
        Whether the probabilities of the logged actions were estimated.
    """
    if unseen is not None:
        return (
            f"{who} takes {unseen}, which no trajectory of the log completed, so its outcome is unknown; record some "
            "trajectories that take it, uniformly at random now and then"
        )
    lacking = np.flatnonzero(support == 0)
    if len(lacking):
        return (
            f"no logged action of stage {lacking[0] + 1} is one that {who} would take; record some trajectories with "
            "such actions, uniformly at random now and then"
        )
    if unexplored > MOST_UNEXPLORED:
        why = "the log seems never to do so" if is_estimated else "the log took its action with probability 1"
        return (
            f"in {unexplored:.0%} of the stages {who} deviates from the log where {why}, so the outcome is unknown; "
            "explore there now and then, as halfseen serve --explore does"
        )
    if effective_sample_size < fewest:
        return (
            f"the effective sample size is {effective_sample_size:.1f} trajectories that follow {who}, but at least "
            f"{fewest:g} are needed; {_remedy(num_trajectories, fewest * trajectories_for_one)}"
        )
    return None


def _remedy(num_trajectories: int, enough: float) -> str:
    closer = "of a logging policy that is closer to this one"
    if not enough < MANY_TRAJECTORIES:
        return f"no log of practical size would do: record some trajectories {closer}"
    if enough <= num_trajectories:
        return f"record more trajectories, or some {closer}"
    size = 10.0 ** np.floor(np.log10(enough))
    return f"about {np.ceil(enough / size) * size:,.0f} trajectories like these would do, or fewer {closer}"


def verdict_of(
    difference: Estimate,
    baseline: str = "the logging policy",
    is_significant: bool = True,
    unit: str | None = None,
    more: Needed | None = None,
) -> tuple[Verdict, str]:
    """Decide by the interval of the paired difference.

    Parameters
    ----------
    difference
        Value of the policy minus that of the baseline.
    baseline
        Its name.
    is_significant
        Whether an interval without 0 is significant after the adjustment for several baselines.
    unit
        Unit of rewards; None if not given.
    more
        Factor by which a log must grow to decide, if known.
    """
    of = f" {unit}" if unit else ""
    within = _between(difference.low, difference.high, of)
    if difference.low > 0 and is_significant:
        return "better", f"it earns {difference.value:.3g}{of} more a trajectory than {baseline}, {within}"
    if difference.high <= 0 and (is_significant or difference.standard_error == 0):
        less = (
            f"{-difference.value:.3g}{of} less a trajectory than" if difference.value < 0 else "as much a trajectory as"
        )
        return "not better", f"it earns {less} {baseline}, {within}"
    reason = f"it earns {within} a trajectory than {baseline}"
    if difference.low > 0 or difference.high <= 0:
        return "inconclusive", f"{reason}, which is not significant among so many baselines; give fewer"
    return "inconclusive", f"{reason}; {_more_trajectories(more or needed(difference, difference.value, LEVEL))}"


def _between(low: float, high: float, of: str) -> str:
    """Ends of an interval of a gain in words, as less and more."""
    if low < 0 < high:
        return f"between {-low:.3g} less and {high:.3g}{of} more"
    if high <= 0:
        return f"between {abs(high):.3g} and {abs(low):.3g}{of} less"
    return f"between {low:.3g} and {high:.3g}{of} more"


def _more_trajectories(more: Needed) -> str:
    if np.isinf(more.times):
        return (
            "there is no significant difference, and a log many times as large would not show one if it is this small"
        )
    gain = f"{abs(more.gain):.3g} {'less' if more.gain < 0 else 'more'}"
    if more.times <= 1.0:
        return f"most logs of this size would show the {gain} that Q says, so Q may be wrong"
    times = np.ceil(more.times * 10) / 10
    return f"if it truly is the {gain} that Q says, about {times:.1f} times as many trajectories would decide"


STRONGEST = 100.0
"""Largest Γ that is considered."""


def shift(excess: Float[np.ndarray, "n T"], error: Float[np.ndarray, "n T"], gamma: float) -> float:
    """Largest downward shift of Σ_t E[w v_t] by causes of strength Γ ≥ 1, given w − 1 of stages and v."""
    return float(sum(_shift(*columns, gamma) for columns in zip(excess.T, error.T, strict=True)) / len(excess))


def undone_at(difference: Estimate, excess: Float[np.ndarray, "n T"], error: Float[np.ndarray, "n T"]) -> float:
    """Γ that moves an interval to 0, given w − 1 of each completed stage and the factor of w in the difference.

    1 if the interval already contains 0; `STRONGEST` if no weaker cause suffices.
    """
    is_above = difference.value > 0
    lead = difference.low if is_above else -difference.high
    if lead <= 0:
        return 1.0
    signed = error if is_above else -error
    if lead + shift(excess, signed, STRONGEST) > 0:
        return STRONGEST
    from scipy.optimize import brentq

    log_gamma: Any = brentq(lambda each: lead + shift(excess, signed, exp(each)), 0.0, log(STRONGEST))
    return exp(log_gamma)


def in_words(gamma: float) -> str:
    """State the required strength of a cause in one sentence."""
    how = f"more than {STRONGEST:g}" if gamma >= STRONGEST else f"{gamma:.2g}"
    if gamma < 1.05:
        return "Any cause of cuts that is not in the log could overturn this"
    return (
        "To overturn this, a cause of cuts that is not in the log would have to change the odds of being cut by a "
        f"factor of {how}"
    )


def _shift(excess: Float[np.ndarray, " n"], error: Float[np.ndarray, " n"], gamma: float) -> float:
    """The same for one stage, summed over trajectories."""
    order = np.argsort(error, kind="stable")
    excess, error = np.maximum(excess[order], 0.0), error[order]
    total = excess.sum()
    # Γ applies to the excess below the quantile: fully to the first stages, partly to the next, and not to the rest.
    raised = np.clip(total / (gamma + 1.0) - (np.cumsum(excess) - excess), 0.0, excess)
    return float(np.sum(error * ((gamma - 1.0) * raised - (1.0 - 1.0 / gamma) * (excess - raised))))
