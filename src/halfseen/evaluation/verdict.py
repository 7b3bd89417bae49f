"""Better than a baseline, not better, or inconclusive; why, in one plain sentence; and how many would decide.

The half-width of an interval shrinks as 1/√n: its standard error σ is the spread of what trajectories add, and the bias
β that it allows for is of stages that more trajectories see end. With a difference of δ,

    n* = n·((β + (z₀.₉₇₅ + z₀.₈) σ) / |δ|)²

trajectories show it in four logs of five. For δ stands what Q alone says, which errs less than the estimate that has to
be shown, and not with it: a log that missed a difference has most often a low estimate of it. Its σ is most often too
large, for one heavy residual suffices; so σ is that of residuals that are all alike, where weights are known, and
`REST` times as much for what else is fitted. δ is taken to be known to σ.

How strong a cause of cuts that was not recorded would have to be to undo a verdict (Γ).

Weights 1/Ĝ are right if, given what was recorded, cuts have nothing to do with what would have followed. Suppose that
something else has a say, and that of two stages which look alike it makes the odds of being seen to the end up to Γ
times as large for one as the model has it, and as small for another: the true weight of a completed stage is then some

    w* ∈ [1 + (w − 1)/Γ, 1 + (w − 1)Γ],    w = 1/Ĝ(U_t⁻)

(the marginal sensitivity model [Tan2006]_). Weights of a stage have a known mean, so what one stage gains another
loses [DornGuo2023]_. Of all such weights those that shift Σ_t E[w* v_t] most, v the weighted error of Q, give Γ to the
stages below the 1/(Γ + 1)-quantile of v (by w − 1), and 1/Γ to those above, or the other way round.

Γ is where the end of the interval that lies nearer to 0, shifted by so much, reaches it. v holds the whole error of Q,
of which the regression of cut stages may know a part; so the true Γ is as large or larger. That the interval itself
would be another under other weights is left out. Γ of 1 trusts the model, and
2 is a cause which doubles or halves the odds.
"""

from dataclasses import dataclass
from math import exp, log
from statistics import NormalDist
from typing import Literal

import numpy as np

from halfseen.evaluation.estimate import Estimate, crossing
from halfseen.shapes import Float

Verdict = Literal["better", "not better", "inconclusive"]

FEWEST_TRAJECTORIES = 10.0
"""Below this effective sample size no interval is believed where products of ratios weigh."""

FEWEST_BY_STATES = 2.0
"""The same where states weigh, whose spread is known from more trajectories than the one that leads to them."""

MOST_UNEXPLORED = 0.02
"""Share of the stages from which on Q alone would speak for the policy."""

LEVEL = 0.95
"""Where nothing else is said."""

MANY_TRAJECTORIES = 1e6
"""More than anybody records."""


REST = 1.15
"""Our choice, made on logs of the cell in `examples/bin_cell`."""
POWER = 0.8
"""Share of the logs that are to decide."""
MANY_TIMES = 100.0
"""More than so many times as many trajectories nobody records."""


@dataclass(frozen=True)
class Needed:
    """How many times as many trajectories decide, at least 1; ∞ where no log of a size that can be recorded does."""

    times: float
    low: float
    high: float
    gain: float
    """δ."""


def needed(difference: Estimate, gain: float, level: float, alike: float | None = None) -> Needed:
    """Tell n*/n, and between what it lies as far as δ is known.

    Parameters
    ----------
    difference
        σ and β.
    gain
        δ.
    level
        Of the interval that is to exclude 0.
    alike
        Standard error if all residuals were alike; None if it is not known.
    """
    normal, error = NormalDist(), REST * alike if alike else difference.standard_error
    reach = difference.bias + (normal.inv_cdf((1.0 + level) / 2.0) + normal.inv_cdf(POWER)) * error

    def times(known: float) -> float:
        found = (reach / known) ** 2 if known > 0 else np.inf
        return max(found, 1.0) if found <= MANY_TIMES else np.inf

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
) -> str | None:
    """Say why a log tells nothing of what a policy earns; None if it does.

    Parameters
    ----------
    who
        The policy, or its baseline.
    support
        Of each stage that the log holds, the share of the logged actions that it would take at all.
    effective_sample_size
        Of the trajectories that follow it.
    unseen
        An action that it takes and that the log never saw completed.
    num_trajectories
        Trajectories of the log.
    trajectories_for_one
        How many trajectories like those of the log are worth one that follows it.
    fewest
        The least effective sample size that is believed.
    unexplored
        Share of the stages in which it does something else where the log was sure to do what it did.
    """
    if unseen is not None:
        return (
            f"{who} takes {unseen}, which no trajectory of the log was seen to complete, so nothing is known of what "
            "it brings; log some trajectories that take it, uniformly at random now and then"
        )
    lacking = np.flatnonzero(support == 0)
    if len(lacking):
        return (
            f"no logged action of stage {lacking[0] + 1} is one that {who} would take; log some trajectories that take "
            "them, uniformly at random now and then"
        )
    if unexplored > MOST_UNEXPLORED:
        return (
            f"in {unexplored:.0%} of the stages {who} does something else where the log took its action with "
            "probability 1, so nothing is known of what that brings; explore there now and then, as halfseen serve "
            "--explore does"
        )
    if effective_sample_size < fewest:
        return (
            f"the effective sample size is {effective_sample_size:.1f} trajectories that follow {who}, and fewer than "
            f"{fewest:g} tell nothing; {_remedy(num_trajectories, fewest * trajectories_for_one)}"
        )
    return None


def _remedy(num_trajectories: int, enough: float) -> str:
    closer = "of a logging policy that is closer to this one"
    if not enough < MANY_TRAJECTORIES:
        return f"no log of a size that can be recorded would do: record some trajectories {closer}"
    if enough <= num_trajectories:
        return f"record more trajectories, or some {closer}"
    size = 10.0 ** np.floor(np.log10(enough))
    return f"some {np.ceil(enough / size) * size:,.0f} trajectories like these would do, or fewer {closer}"


def verdict_of(
    difference: Estimate,
    baseline: str = "the logging policy",
    is_significant: bool = True,
    unit: str | None = None,
    more: Needed | None = None,
) -> tuple[Verdict, str]:
    """Judge by the interval of the paired difference.

    Parameters
    ----------
    difference
        Value of the policy less that of the baseline.
    baseline
        Its name.
    is_significant
        Whether an interval without 0 still counts, given how many were looked at.
    unit
        What rewards are counted in; None if nobody has said.
    more
        How many times as many trajectories would decide, if that is known.
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
        return "inconclusive", f"{reason}, which is not enough among so many baselines; name fewer"
    return "inconclusive", f"{reason}; {_more_trajectories(more or needed(difference, difference.value, LEVEL))}"


def _between(low: float, high: float, of: str) -> str:
    """Ends of an interval of a gain, as how much less and how much more."""
    if low < 0 < high:
        return f"between {-low:.3g} less and {high:.3g}{of} more"
    if high <= 0:
        return f"between {abs(high):.3g} and {-low:.3g}{of} less"
    return f"between {low:.3g} and {high:.3g}{of} more"


def _more_trajectories(more: Needed) -> str:
    if np.isinf(more.times):
        return "there is no significant difference, nor would a log many times as large show one if that is all"
    gain = f"{abs(more.gain):.3g} {'less' if more.gain < 0 else 'more'}"
    times = np.ceil(more.times * 10) / 10
    return f"if it truly is the {gain} that Q says, about {times:.1f} times as many trajectories would decide"


STRONGEST = 100.0
"""Γ beyond which nothing is looked for."""


def shift(excess: Float[np.ndarray, "n T"], error: Float[np.ndarray, "n T"], gamma: float) -> float:
    """The furthest that causes of strength Γ ≥ 1 take Σ_t E[w v_t] down, by w − 1 of stages and v."""
    return float(sum(_shift(*columns, gamma) for columns in zip(excess.T, error.T, strict=True)) / len(excess))


def undone_at(difference: Estimate, excess: Float[np.ndarray, "n T"], error: Float[np.ndarray, "n T"]) -> float:
    """Γ that takes an interval to 0, by w − 1 of each completed stage and what w is multiplied by in the difference.

    1 where the interval holds 0 already; `STRONGEST` where nothing weaker does it.
    """
    is_above = difference.value > 0
    lead = difference.low if is_above else -difference.high
    if lead <= 0:
        return 1.0
    signed = error if is_above else -error
    if lead + shift(excess, signed, STRONGEST) > 0:
        return STRONGEST
    log_gamma = crossing(lambda each: lead + shift(excess, signed, exp(each)), 0.0, log(STRONGEST))
    return exp(log_gamma)


def in_words(gamma: float) -> str:
    """Say how much it would take, in one sentence."""
    how = f"more than {STRONGEST:g}" if gamma >= STRONGEST else f"{gamma:.2g}"
    if gamma < 1.05:
        return "Any cause of cuts that is not in the log could undo this"
    return (
        f"To undo this, a cause of cuts that is not in the log would have to change the odds of being cut by a factor "
        f"of {how}"
    )


def _shift(excess: Float[np.ndarray, " n"], error: Float[np.ndarray, " n"], gamma: float) -> float:
    """The same of one stage, summed over trajectories."""
    order = np.argsort(error, kind="stable")
    excess, error = np.maximum(excess[order], 0.0), error[order]
    total = excess.sum()
    # Of each stage as much of its excess gets Γ as lies below the quantile: of one all, of the next a part, then none.
    raised = np.clip(total / (gamma + 1.0) - (np.cumsum(excess) - excess), 0.0, excess)
    return float(np.sum(error * ((gamma - 1.0) * raised - (1.0 - 1.0 / gamma) * (excess - raised))))
