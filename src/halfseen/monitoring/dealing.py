"""How a comparison stands, and with which chance the next trajectory goes to the policy.

The share doubles, up to a half, as often as the loss that it may bring a trajectory halves from one standard deviation
of what trajectories earn. It falls to 0 for good once harm is seen, or once the loss so far may exceed its bound: with
N trajectories of the policy and a lower bound L of its gain, N·max(0, −L), where none loses more than the range of what
trajectories earned. The chance of the last trajectory says whether it was promoted (1) or stopped (0), so that a log of
trajectories holds the whole state.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from halfseen.monitoring.comparison import Counted, Courses, Kept, bound, counted

ARM = "arm"
"""Column of a log's trajectories: to which each was dealt."""
POLICY, RULE = "policy", "rule"
PROMOTES, HARMS = 0.025, 0.05
"""Chances of promoting what is no better, and of a loss beyond its bound."""
LARGEST_SHARE = 0.5
"""Before a policy is promoted: a fair coin tells most."""
MOST_MORE = 100_000
EXTRA_NATS = 1.0
"""What not knowing how much to bet costs."""

Verdict = Literal["promoted", "stopped", "going on"]


@dataclass(frozen=True)
class Terms:
    """How a comparison is held.

    Parameters
    ----------
    share
        Chance of the policy at first, in (0, 0.5].
    most_loss
        What the policy may lose against the rule in all, with chance 0.05 at most more [reward]; None for no bound, and
        then it is stopped where harm is seen.
    """

    share: float = 0.2
    most_loss: float | None = None


@dataclass(frozen=True)
class Standing:
    """How a comparison stands.

    Parameters
    ----------
    num, num_policy
        Trajectories that were dealt until the verdict, and to the policy.
    gain
        What the policy earns more a trajectory than the rule [reward]; None where nothing is known.
    low, high
        Bounds of the gain [reward]: `low` is above 0 of a policy that is no better with chance 0.025 at most, ever.
    worst_loss
        What its trajectories lost in all at most [reward]; more with chance 0.05 at most.
    share
        Chance of the policy in the next trajectory.
    verdict
        "promoted", "stopped" or "going on".
    more
        About how many trajectories more would decide; None where nobody knows.
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

    def __str__(self) -> str:
        so_far = f"after {self.num} trajectories, {self.num_policy} by the policy"
        if self.low is None or self.high is None:
            return f"{self.verdict} {so_far}: nothing is known of its gain"
        known = f"it gains {_signed(self.low)} to {_signed(self.high)} a trajectory"
        if self.verdict != "going on":
            return f"{self.verdict} {so_far}: {known}"
        more = "nobody knows how many more would decide" if self.more is None else f"about {self.more:,} more decide"
        return f"going on {so_far}: {known}; {more}"


def _signed(number: float) -> str:
    return f"{number:+.2g}".replace("-", "−")


def standing(courses: Courses, terms: Terms, of: Counted | None = None, kept: Kept | None = None) -> Standing:
    """Work out how a comparison stands.

    Parameters
    ----------
    courses
        Its trajectories.
    terms
        How it is held.
    of
        What they add, where that is known.
    kept
        What was worked out of those before them.
    """
    of, num_policy = counted(courses) if of is None else of, int(courses.is_policy.sum())
    kept = Kept() if kept is None else kept
    kept.begin()
    low, high, likely = (bound(of, alpha, side, kept) for alpha, side in ((PROMOTES, 1), (PROMOTES, -1), (HARMS, 1)))
    worst = num_policy * min(max(0.0, -likely), float(np.ptp(courses.totals()))) if num_policy else 0.0
    is_harm = len(of.excess) > 0 and bool(kept.best(of, 0.0, -1) >= -np.log(HARMS))
    verdict = _verdict(courses, terms, low, is_harm, worst)
    share = {"promoted": 1.0, "stopped": 0.0, "going on": _share(courses, terms, likely)}[verdict]
    gain = float(of.bet_on @ of.excess / (of.bet_on @ of.share)) if len(of.excess) else np.nan
    more = _more(of) if verdict == "going on" else None
    known = [_finite(each) for each in (gain, low, high, worst)]
    # Once the verdict is there, trajectories are no longer dealt.
    is_dealt = (courses.chance > 0.0) & (courses.chance < 1.0)
    dealt = int(is_dealt.sum()), int(courses.is_policy[is_dealt].sum())
    return Standing(*dealt, known[0], known[1], known[2], known[3], share, verdict, more)


def _finite(number: float) -> float | None:
    return float(number) if np.isfinite(number) else None


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
    halved = np.log2(float(courses.totals().std()) / -likely) if np.isfinite(likely) and courses.num else 0.0
    return min(LARGEST_SHARE, terms.share * 2.0 ** max(0, int(halved)))


def _more(of: Counted) -> int | None:
    """Trajectories until the wealth of who knows how much to bet is large enough, at the share of the last ones."""
    if not len(of.excess):
        return None
    outcome = of.bet_on * of.excess
    half = outcome[len(outcome) // 2 :]
    need = -np.log(PROMOTES if half.mean() > 0.0 else HARMS) + EXTRA_NATS
    rate = 0.5 * half.mean() ** 2 / max(float(np.mean(half**2)), 1e-300)
    had = 0.5 * outcome.mean() ** 2 / max(float(np.mean(outcome**2)), 1e-300) * len(outcome)
    more = max(need - had, 0.0) / rate if rate > 0.0 else np.inf
    return max(1, round(float(more))) if more <= MOST_MORE else None
