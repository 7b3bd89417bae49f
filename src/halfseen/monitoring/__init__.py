"""A policy in service: whether what was promised is earned, and if not, what has changed and since when.

Everything here may be looked at at any time. The chance that anything alarms in a lifetime without change is meant to
be 5 % at most.

Read it down: `outcomes` (what a trajectory adds under cuts, and bounds on its mean) → `betting` (wealth against
"nothing has changed") → `foreign` (what the policy does not know) → `streams` (what is watched) → `diagnosis` (since
when, and which part broke) → `answer` (with whether to learn again) → `monitor`. And `comparison` (bounds on the gain
over the rule of today) → `dealing` (how a comparison stands, and who gets the next trajectory). Beside them
`training_log` asks of a log before it is learned from whether it is of one cell.
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.monitoring.answer import Finding, Monitored
    from halfseen.monitoring.comparison import Courses
    from halfseen.monitoring.dealing import Standing, Terms, standing
    from halfseen.monitoring.monitor import monitored
    from halfseen.monitoring.outcomes import BettingBounds, CensoredOutcomes
    from halfseen.monitoring.training_log import Change, changes_in

__all__ = [
    "BettingBounds",
    "CensoredOutcomes",
    "Change",
    "Courses",
    "Finding",
    "Monitored",
    "Standing",
    "Terms",
    "changes_in",
    "monitored",
    "standing",
]

__getattr__ = lazy_names(
    __name__,
    {
        "BettingBounds": "outcomes",
        "CensoredOutcomes": "outcomes",
        "Change": "training_log",
        "Courses": "comparison",
        "Finding": "answer",
        "Monitored": "answer",
        "Standing": "dealing",
        "Terms": "dealing",
        "changes_in": "training_log",
        "monitored": "monitor",
        "standing": "dealing",
    },
)
