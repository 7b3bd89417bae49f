"""The report on a policy in service: one sentence, what has changed, and whether learning again may pay.

The promise of a policy that was learned from n trajectories has a standard error s, so an estimate from m later ones
has about s √(n/m). The loss d is clearly larger than that for m ≥ n (2s/d)². How much of the loss can be recovered is
known only after learning again.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from halfseen.logs import Logs
from halfseen.logs.columns import shown
from halfseen.logs.data_quality import text_order
from halfseen.monitoring.outcomes import Course, Outcomes
from halfseen.shapes import Float
from halfseen.wording import counted


@dataclass(frozen=True)
class Finding:
    """A change that was detected.

    Parameters
    ----------
    family
        ``"rewards"``, ``"promise"``, ``"inputs"`` or ``"parts"``.
    name
        What has changed.
    words
        How it has changed, in a sentence.
    p_value
        Anytime-valid p-value.
    alarm_at
        Trajectory, counted from 1, at which the change was first detected.
    since, since_low, since_high
        First trajectory after the change, and the interval of its estimate.
    """

    family: str
    name: str
    words: str
    p_value: float
    alarm_at: int
    since: int
    since_low: int
    since_high: int


@dataclass(frozen=True, eq=False)
class Monitored:
    """The result of monitoring a policy by the log of its service.

    Parameters
    ----------
    num_trajectories
        Number of trajectories that have ended.
    promised
        The promise: value, low, high; None if nothing was promised.
    earned
        Mean earned: value, with anytime-valid 95 % bounds that assume no change; and the value since the change of the
        first finding. None if unknown.
    findings
        Detected changes, the first alarm first.
    causes
        After an alarm, the parts that differ from the training log since then, in words.
    notes
        What could not be watched.
    outcomes, course
        The outcome of each trajectory, and the bounds after each weighted one.
    p_values
        By family, after each trajectory: its smallest p-value times the number of its p-values.
    relearning
        Whether learning again may pay; "" if nothing has changed.
    doubts
        What the policy does not know, in words; reported first.
    foreign
        A sentence if the log does not come from the policy's service, else "".
    """

    num_trajectories: int
    promised: dict[str, float] | None
    earned: dict[str, float] | None
    findings: tuple[Finding, ...]
    causes: tuple[str, ...]
    notes: tuple[str, ...]
    outcomes: Outcomes | None
    course: Course | None
    p_values: dict[str, Float[np.ndarray, " n"]]
    relearning: str = ""
    doubts: tuple[str, ...] = ()
    foreign: str = ""

    @property
    def alarm_at(self) -> int | None:
        """Trajectory of the first alarm, counted from 1; None without an alarm."""
        return min((each.alarm_at for each in self.findings), default=None)

    @property
    def sentence(self) -> str:
        """The answer; for a log that does not come from the policy's service, this fact and the alarms only."""
        if self.foreign:
            return f"{self.foreign}.{f' {self._alarm}' if self.findings else ''}"
        return self._alarm

    @property
    def _alarm(self) -> str:
        earned = ""
        if self.earned is not None:
            words = "since then it earns {since:.3g} a trajectory"
            words = words if self.findings else "it earns {value:.3g} a trajectory ({low:.3g} to {high:.3g})"
            earned = words.format(**self.earned)
        if self.promised is not None:
            promise = "{value:.3g} was promised ({low:.3g} to {high:.3g})".format(**self.promised)
            earned = f"{earned}, {promise}" if earned else promise
        if not self.findings:
            seen = (
                f"in {counted(self.num_trajectories, 'trajectory')} nothing{' else' if self.doubts else ''} has changed"
            )
            return f"No alarm: {seen}{'; ' if earned else ''}{earned}."
        first = self.findings[0]
        since = f"since about trajectory {first.since} ({first.since_low} to {first.since_high})"
        return f"Alarm at trajectory {self.alarm_at}: {first.words}, {since}{'; ' if earned else ''}{earned}."

    def as_dict(self) -> dict[str, Any]:
        """All fields except the outcomes, the course and the p-values, ready for JSON.

        After a change the bounds of the mean, which assume none, are null.
        """
        earned: Any = self.earned
        if earned is not None and self.findings:
            earned = {**earned, "low": None, "high": None}
        return {
            "sentence": self.sentence,
            "is_alarm": bool(self.findings),
            "is_of_service": not self.foreign,
            "alarm_at": self.alarm_at,
            "num_trajectories": self.num_trajectories,
            "promised": self.promised,
            "earned": earned,
            "findings": [asdict(each) for each in self.findings],
            "causes": list(self.causes),
            "relearning": self.relearning,
            "doubts": list(self.doubts),
            "notes": list(self.notes),
        }


CLEARLY = 2.0
"""Number of standard errors by which a loss must exceed 0."""
FEWEST = 200
"""Fewest trajectories to learn from again. Without change, a policy of the bin learned from 100 earns a fifth less than
one from 500, and one from 200 a twentieth less than one from 600 (`benchmarks/relearning.py`)."""
MEND_FIRST = "Fix the recording before you learn again: columns have changed, perhaps not the cell."
OWN = 0.98
"""Share of the policy's own actions above which the log shows too little of the other actions."""


def num_needed(value: Mapping[str, float] | None, num_learned: int, now: float | None) -> int | None:
    """Number of trajectories from which learning again may pay; None if nothing was lost.

    Parameters
    ----------
    value
        The promise, ``value`` and ``standard_error``; None if nothing was promised.
    num_learned
        n, the number of trajectories behind the promise.
    now
        Mean earned since the change; None if unknown.

    Examples
    --------
    >>> num_needed({"value": 0.75, "standard_error": 0.125}, 400, 0.5)
    400
    >>> num_needed({"value": 0.75, "standard_error": 0.125}, 400, -0.25)
    200
    """
    if value is None or now is None:
        return FEWEST
    lost = value["value"] - now
    if lost <= 0.0:
        return None
    return max(FEWEST, int(np.ceil(num_learned * (CLEARLY * value["standard_error"] / lost) ** 2)))


def of_names(logs: Logs, since: int | None) -> tuple[str, ...]:
    """Say which trajectory a change begins with, and whether their order may be wrong.

    Parameters
    ----------
    logs
        The trajectories that count.
    since
        Number of the first after a change, from 1; None without a change.
    """
    names = logs.trajectory_ids
    notes = tuple(text_order(names))
    if since is None or str(names[since - 1]) == str(since):
        return notes
    name = shown(names[since - 1])
    return (f"trajectories that count are numbered from 1; number {since} is {name} in the log", *notes)


def relearning(num_since: int, since: str | int, needed: int | None, own: float) -> str:
    """Say whether learning again may pay.

    Parameters
    ----------
    num_since
        Number of trajectories since the change.
    since
        Name of the first of them.
    needed
        Result of `num_needed`.
    own
        Share of their actions that are the policy's.
    """
    there = f"{counted(num_since, 'trajectory')} since the change"
    if needed is None:
        return f"Learning again is not needed: nothing is lost in {there}."
    blind = "; serve with --explore first, as they hold almost only the policy's own actions" if own > OWN else ""
    if num_since < needed:
        return f"Learning again will not pay yet: there are {there}, and about {needed:,} are needed{blind}."
    how = f"halfseen learn LOGS --out FOLDER --since {since}"
    return f"Learning again may pay: there are {there}, and about {needed:,} are needed ({how}){blind}."
