"""A policy in service: whether what was promised is earned, and if not, what has changed and since when.

Everything here may be looked at at any time. The chance that anything alarms in a lifetime without change is meant to
be 5 % at most.

Read it down: `confidence_sequences` (bounds on a mean) → `outcomes` (what a trajectory adds under
cuts) → `betting` (wealth against "nothing has changed") → `joint` (the same by a classifier) → `change_point` (since
when) → `streams` (what is watched) → `diagnosis` (which part broke) → `answer` → `monitor`. And `comparison`
(bounds on the gain over the rule of today) → `dealing` (how a comparison stands, and who gets the next trajectory).
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.monitoring.answer import Finding, Monitored
    from halfseen.monitoring.comparison import Courses
    from halfseen.monitoring.confidence_sequences import BettingBounds
    from halfseen.monitoring.dealing import Standing, Terms, standing
    from halfseen.monitoring.monitor import monitored
    from halfseen.monitoring.outcomes import CensoredOutcomes

__all__ = [
    "BettingBounds",
    "CensoredOutcomes",
    "Courses",
    "Finding",
    "Monitored",
    "Standing",
    "Terms",
    "monitored",
    "standing",
]

__getattr__ = lazy_names(
    __name__,
    {
        "BettingBounds": "confidence_sequences",
        "CensoredOutcomes": "outcomes",
        "Courses": "comparison",
        "Finding": "answer",
        "Monitored": "answer",
        "Standing": "dealing",
        "Terms": "dealing",
        "monitored": "monitor",
        "standing": "dealing",
    },
)
