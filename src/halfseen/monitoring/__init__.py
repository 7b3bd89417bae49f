"""Monitoring of a policy in service: whether it earns what was promised and, if not, what changed and since when.

Every result is valid at any time. Without change, the probability of any false alarm in a whole lifetime is meant to
be at most 5 %.

Reading order: `outcomes` (the value of a trajectory under cuts, and bounds on its mean) → `betting` (wealth against
"nothing has changed") → `foreign` (what the policy does not know) → `streams` (what is watched) → `diagnosis` (since
when, and which part broke) → `answer` (the report, and whether to learn again) → `monitor`. A second path is
`comparison` (bounds on the gain over the rule of today) → `dealing` (the verdict, and the arm of the next trajectory).
Separately, `training_log` checks whether a log to be learned from comes from one unchanged cell.
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

_NAMES = {
    "answer": "Finding Monitored",
    "comparison": "Courses",
    "dealing": "Standing Terms standing",
    "monitor": "monitored",
    "outcomes": "BettingBounds CensoredOutcomes",
    "training_log": "Change changes_in",
}
__getattr__ = lazy_names(__name__, {name: module for module, names in _NAMES.items() for name in names.split()})
