"""Better than an opponent, not better, or cannot be said; and why, in one plain sentence."""

from typing import Literal

import numpy as np

from halfseen.evaluation.advice import Needed, needed
from halfseen.evaluation.estimate import Estimate
from halfseen.shapes import Float

Verdict = Literal["better", "not better", "cannot be said"]

FEWEST_PATHS = 10.0
"""Below this effective sample size no interval is believed where products of ratios weigh."""

FEWEST_BY_STATES = 2.0
"""The same where states weigh, whose spread is known from more paths than the one that leads to them."""

LEVEL = 0.95
"""Where nothing else is said."""

MANY_PATHS = 1e6
"""More than anybody records."""


def why_unknown(
    who: str,
    support: Float[np.ndarray, " T"],
    effective_sample_size: float,
    unseen: str | None = None,
    num_paths: int = 0,
    paths_for_one: float = np.inf,
    fewest: float = FEWEST_PATHS,
) -> str | None:
    """Say why a log tells nothing of what a policy earns; None if it does.

    Parameters
    ----------
    who
        The policy, or its opponent.
    support
        Of each stage that the log holds, the share of the logged actions that it would take at all.
    effective_sample_size
        Of the paths that follow it.
    unseen
        An action that it takes and that the log never saw completed.
    num_paths
        Paths of the log.
    paths_for_one
        How many paths like those of the log are worth one that follows it.
    fewest
        The least effective sample size that is believed.
    """
    if unseen is not None:
        return (
            f"{who} takes {unseen}, which no path of the log was seen to complete, so nothing is known of what it "
            "brings; log some paths that take it, uniformly at random now and then"
        )
    lacking = np.flatnonzero(support == 0)
    if len(lacking):
        return (
            f"no logged action of stage {lacking[0] + 1} is one that {who} would take; log some paths that take "
            "them, uniformly at random now and then"
        )
    if effective_sample_size < fewest:
        return (
            f"the effective sample size is {effective_sample_size:.1f} paths that follow {who}, and fewer than "
            f"{fewest:g} tell nothing; {_remedy(num_paths, fewest * paths_for_one)}"
        )
    return None


def _remedy(num_paths: int, enough: float) -> str:
    closer = "of a logging policy that is closer to this one"
    if not enough < MANY_PATHS:
        return f"no log of a size that can be recorded would do: record some paths {closer}"
    if enough <= num_paths:
        return f"record more paths, or some {closer}"
    size = 10.0 ** np.floor(np.log10(enough))
    return f"some {np.ceil(enough / size) * size:,.0f} paths like these would do, or fewer {closer}"


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
        How many times as many paths would tell, if that is known.
    """
    of = f" {unit}" if unit else ""
    within = _between(difference.low, difference.high, of)
    if difference.low > 0 and is_significant:
        return "better", f"it earns {difference.value:.3g}{of} more a path than {opponent}, {within}"
    if difference.high <= 0 and (is_significant or difference.standard_error == 0):
        less = f"{-difference.value:.3g}{of} less a path than" if difference.value < 0 else "as much a path as"
        return "not better", f"it earns {less} {opponent}, {within}"
    reason = f"it earns {within} a path than {opponent}"
    if difference.low > 0 or difference.high <= 0:
        return "cannot be said", f"{reason}, which is not enough among so many opponents; name fewer"
    return "cannot be said", f"{reason}; {_more_paths(more or needed(difference, difference.value, LEVEL))}"


def _between(low: float, high: float, of: str) -> str:
    """Ends of an interval of a gain, as how much less and how much more."""
    if low < 0 < high:
        return f"between {-low:.3g} less and {high:.3g}{of} more"
    if high <= 0:
        return f"between {abs(high):.3g} and {-low:.3g}{of} less"
    return f"between {low:.3g} and {high:.3g}{of} more"


def _more_paths(more: Needed) -> str:
    if np.isinf(more.times):
        return "there is no significant difference, nor would a log many times as large show one if that is all"
    gain = f"{abs(more.gain):.3g} {'less' if more.gain < 0 else 'more'}"
    return f"if it is the {gain} that Q says, some {np.ceil(more.times * 10) / 10:.1f} times as many paths would tell"
