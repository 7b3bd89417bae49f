"""The state of a comparison, and the probability with which the next trajectory goes to the policy.

The share of the policy doubles, up to a half, each time the possible loss a trajectory halves, counted from one
standard deviation of the trajectories' totals. The share drops to 0 for good once harm is shown or the loss so far may
exceed its bound. With N trajectories of the policy and a lower bound L of its gain, this loss is N·max(0, −L), where
the loss of one trajectory is at most the range of the totals. The probability of the last trajectory shows whether the
policy was promoted (1) or stopped (0), so a log of trajectories holds the whole state.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from halfseen.errors import ArgumentError
from halfseen.estimator import is_number
from halfseen.monitoring.comparison import NOISE, ComparisonCache, CountedTrajectories, Courses, bound, counted
from halfseen.wording import counted as counted_in_words

POLICY = "policy"
PROMOTES, HARMS = 0.025, 0.05
"""Probabilities of promoting a policy that is no better, and of a loss beyond its bound."""
LARGEST_SHARE = 0.5
"""Before a policy is promoted; a fair coin is the most informative."""
MOST_MORE = 100_000
EXTRA_NATS = 1.0
"""Cost in log wealth of not knowing the best bet."""

Verdict = Literal["promoted", "stopped", "going on"]


@dataclass(frozen=True)
class Terms:
    """Settings of a comparison.

    Parameters
    ----------
    share
        Initial probability of the policy, in (0, 0.5].
    most_loss
        Largest total loss of the policy against the rule, exceeded with probability at most 0.05 [reward]; None for no
        bound, so that only harm stops the policy.

    Raises
    ------
    ArgumentError
        A number is out of range.
    """

    share: float = 0.2
    most_loss: float | None = None

    def __post_init__(self) -> None:
        if not (is_number(self.share) and 0.0 < self.share <= LARGEST_SHARE):
            raise ArgumentError(f"share is {self.share!r}; give a probability above 0 and at most {LARGEST_SHARE}")
        if self.most_loss is not None and not (is_number(self.most_loss) and self.most_loss > 0.0):
            raise ArgumentError(f"most_loss is {self.most_loss!r}; give a total reward above 0, or None for no bound")


@dataclass(frozen=True)
class Standing:
    """State of a comparison.

    Parameters
    ----------
    num, num_policy
        Number of trajectories dealt until the verdict, and of those dealt to the policy.
    gain
        Estimated gain of the policy over the rule, a trajectory [reward]; None if unknown.
    low, high
        Bounds of the gain [reward]. For a policy that is no better, `low` ever exceeds 0 with probability at most
        0.025.
    worst_loss
        Upper bound of the policy's total loss [reward], exceeded with probability at most 0.05.
    share
        Probability that the next trajectory goes to the policy.
    verdict
        "promoted", "stopped" or "going on".
    more
        Approximate number of further trajectories until a verdict; None if unknown.
    hidden
        How much of the gain cuts may hide [reward]; `low` and `high` allow for it.
    """

    num: int
    num_policy: int
    gain: float | None
    low: float | None
    high: float | None
    worst_loss: float | None
    share: float
    verdict: Verdict
    more: int | None
    hidden: float = 0.0

    def __str__(self) -> str:
        stands = "the comparison goes on" if self.verdict == "going on" else f"the policy is {self.verdict}"
        so_far = f"{stands} after {counted_in_words(self.num, 'trajectory')}, {self.num_policy:,} by the policy"
        if self.low is None or self.high is None:
            if self.verdict == "stopped":
                return f"{so_far}: it may have lost {self.worst_loss or 0.0:.2g}, and its gain stays unknown"
            return f"{so_far}: the policy's gain is not known yet; that takes more finished trajectories of both"
        known = f"{so_far}: the policy's gain is {_signed(self.low)} to {_signed(self.high)} a trajectory"
        if self.hidden:
            known = f"{known}, of which cuts may hide {self.hidden:.2g}"
        if self.verdict == "stopped":
            return f"{known}, and it may have lost {self.worst_loss or 0.0:.2g}"
        if self.verdict == "promoted":
            return known
        more = "how many more" if self.more is None else f"about {float(f'{self.more:.2g}'):,.0f} more"
        return f"{known}; {'it is unknown ' if self.more is None else ''}{more} would decide it"


def _signed(number: float) -> str:
    return f"{number:+.2g}".replace("-", "−") if number else "0"


def standing(
    courses: Courses, terms: Terms, of: CountedTrajectories | None = None, kept: ComparisonCache | None = None
) -> Standing:
    """Compute the state of a comparison.

    Parameters
    ----------
    courses
        Its trajectories.
    terms
        Its settings.
    of
        Their contributions, if already computed.
    kept
        Cache from earlier trajectories.

    Raises
    ------
    ArgumentError
        The stages are not sorted by trajectory, or a chance is no probability.
    """
    if not (np.diff(courses.trajectory, prepend=0, append=max(courses.num - 1, 0)) >= 0).all():
        raise ArgumentError("trajectory: the stages are not sorted by trajectory, numbered from 0; sort them")
    if not ((courses.chance >= 0.0) & (courses.chance <= 1.0)).all():
        raise ArgumentError("chance: a trajectory was dealt with no probability; give numbers in [0, 1]")
    of, num_policy = counted(courses) if of is None else of, int(courses.is_policy.sum())
    kept = ComparisonCache() if kept is None else kept
    kept.begin()
    low, high, likely = (bound(of, alpha, side, kept) for alpha, side in ((PROMOTES, 1), (PROMOTES, -1), (HARMS, 1)))
    worst = num_policy * min(max(0.0, -likely), float(np.ptp(courses.totals()))) if num_policy else 0.0
    is_harm = len(of.excess) > 0 and bool(kept.best(of, 0.0, -1) >= -np.log(HARMS))
    verdict = _verdict(courses, terms, low, is_harm, worst)
    share = {"promoted": 1.0, "stopped": 0.0, "going on": _share(courses, terms, likely)}[verdict]
    # Of trajectories that were not randomised, nothing is learned.
    gain = float(of.bet_on @ of.excess / (of.bet_on @ of.share)) if of.bet_on.any() else np.nan
    more = _more(of) if verdict == "going on" else None
    known = [_finite(each) for each in (gain, low, high, worst)]
    # After the verdict, trajectories are no longer dealt.
    is_dealt = (courses.chance > 0.0) & (courses.chance < 1.0)
    dealt = int(is_dealt.sum()), int(courses.is_policy[is_dealt].sum())
    # The bounds rest on trajectories that were randomised; the first after the verdict is not.
    is_bet = of.bet_on != 0.0
    hidden = float(max(of.too_high[is_bet][-1], of.too_low[is_bet][-1])) if is_bet.any() else 0.0
    return Standing(*dealt, known[0], known[1], known[2], known[3], share, verdict, more, _finite(hidden) or 0.0)


def _finite(number: float) -> float | None:
    if not np.isfinite(number):
        return None
    return float(number) if abs(number) > NOISE else 0.0


def _verdict(courses: Courses, terms: Terms, low: float, is_harm: bool, worst: float) -> Verdict:
    last = courses.chance[-1] if courses.num else terms.share
    if last in (0.0, 1.0):
        return "promoted" if last else "stopped"
    if low > 0.0:
        return "promoted"
    most = np.inf if terms.most_loss is None else terms.most_loss
    return "stopped" if is_harm or worst > most else "going on"


def _share(courses: Courses, terms: Terms, likely: float) -> float:
    if likely >= 0.0:
        return LARGEST_SHARE
    deviation = float(courses.totals().std()) if courses.num else 0.0
    halved = np.log2(deviation / -likely) if np.isfinite(likely) and deviation > 0.0 else 0.0
    return min(LARGEST_SHARE, terms.share * 2.0 ** max(0, int(halved)))


def _more(of: CountedTrajectories) -> int | None:
    """Number of trajectories until the wealth of an ideal bet suffices, at the share of the latest trajectories."""
    if not len(of.excess):
        return None
    is_gain = (of.bet_on @ of.excess) > 0.0
    hidden = of.too_high[-1] if is_gain else -of.too_low[-1]
    outcome = of.bet_on * (of.excess - hidden * of.share)
    half = outcome[len(outcome) // 2 :]
    if (half.mean() > 0.0) != is_gain:
        return None
    need = -np.log(PROMOTES if is_gain else HARMS) + EXTRA_NATS
    rate = 0.5 * half.mean() ** 2 / max(float(np.mean(half**2)), 1e-300)
    had = 0.5 * outcome.mean() ** 2 / max(float(np.mean(outcome**2)), 1e-300) * len(outcome)
    more = max(need - had, 0.0) / rate if rate > 0.0 else np.inf
    return max(1, round(float(more))) if more <= MOST_MORE else None
