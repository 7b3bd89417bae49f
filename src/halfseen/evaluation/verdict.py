"""Better than an opponent, not better, or cannot be said; why, in one plain sentence; and how many would decide.

The half-width of an interval shrinks as 1/√n: its standard error σ is the spread of what trajectories add, and the bias
β that it allows for is of stages that more trajectories see end. With a difference of δ,

    n* = n·((β + (z₀.₉₇₅ + z₀.₈) σ) / |δ|)²

trajectories show it in four logs of five. For δ stands what Q alone says, which errs less than the estimate that has to
be shown, and not with it: a log that missed a difference has most often a low estimate of it. Its σ is most often too
large, for one heavy residual suffices; so σ is that of residuals that are all alike, where weights are known, and
`REST` times as much for what else is fitted. δ is taken to be known to σ.
"""

from statistics import NormalDist
from typing import Literal, NamedTuple

import numpy as np

from halfseen.evaluation.estimate import Estimate
from halfseen.shapes import Float

Verdict = Literal["better", "not better", "cannot be said"]

FEWEST_TRAJECTORIES = 10.0
"""Below this effective sample size no interval is believed where products of ratios weigh."""

FEWEST_BY_STATES = 2.0
"""The same where states weigh, whose spread is known from more trajectories than the one that leads to them."""

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


class Needed(NamedTuple):
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
) -> str | None:
    """Say why a log tells nothing of what a policy earns; None if it does.

    Parameters
    ----------
    who
        The policy, or its opponent.
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
    opponent: str = "the logging policy",
    is_significant: bool = True,
    unit: str | None = None,
    more: Needed | None = None,
) -> tuple[Verdict, str]:
    """Judge by the interval of the paired difference.

    Parameters
    ----------
    difference
        Value of the policy less that of the opponent.
    opponent
        Its name.
    is_significant
        Whether an interval without 0 still counts, given how many were looked at.
    unit
        What rewards are counted in; None if nobody has said.
    more
        How many times as many trajectories would tell, if that is known.
    """
    of = f" {unit}" if unit else ""
    within = _between(difference.low, difference.high, of)
    if difference.low > 0 and is_significant:
        return "better", f"it earns {difference.value:.3g}{of} more a trajectory than {opponent}, {within}"
    if difference.high <= 0 and (is_significant or difference.standard_error == 0):
        less = (
            f"{-difference.value:.3g}{of} less a trajectory than" if difference.value < 0 else "as much a trajectory as"
        )
        return "not better", f"it earns {less} {opponent}, {within}"
    reason = f"it earns {within} a trajectory than {opponent}"
    if difference.low > 0 or difference.high <= 0:
        return "cannot be said", f"{reason}, which is not enough among so many opponents; name fewer"
    return "cannot be said", f"{reason}; {_more_trajectories(more or needed(difference, difference.value, LEVEL))}"


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
    return f"if it is the {gain} that Q says, some {times:.1f} times as many trajectories would tell"
