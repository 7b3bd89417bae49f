"""What a log of a policy in service says: one sentence, what has changed, and whether learning again may pay.

A policy that was learned from n trajectories has a promise with a standard error s, so one of m later ones would have
about s √(n/m). What was lost, d, is clearly more than that from m = n (2s/d)² on. How much of it can be had again only
what is learned can tell.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from halfseen.monitoring.outcomes import Course, Outcomes
from halfseen.shapes import Float
from halfseen.wording import counted


@dataclass(frozen=True)
class Finding:
    """Something that has changed.

    Parameters
    ----------
    family
        ``"rewards"``, ``"promise"``, ``"inputs"`` or ``"parts"``.
    name
        What has changed.
    words
        How, in a sentence.
    p_value
        At any time.
    alarm_at
        Trajectory, counted from 1, at which it was first found.
    since, since_low, since_high
        Trajectory from which on it has changed, and between which that lies.
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
    """What a log of a policy in service says.

    Parameters
    ----------
    num_trajectories
        That have ended.
    promised
        What was promised: value, low, high; None where nothing was.
    earned
        What is earned: value, and bounds at any time, 95 %, as if nothing changed; and value since the first finding's
        change. None where that is not known.
    findings
        What has changed, the first alarm first.
    causes
        Which parts differ from the log that was learned from since then, in words, where there is an alarm.
    notes
        What could not be watched.
    outcomes, course
        What each trajectory adds, and the bounds after each that was weighed.
    p_values
        By name of a family, after each trajectory: the smallest of its p-values times their number.
    relearning
        Whether learning again may pay; "" where nothing has changed.
    doubts
        What the policy does not know, in words; it is told first.
    foreign
        That the log is of no service of the policy, in words; "" where it is.
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
        """Trajectory, counted from 1, at which anything alarmed first; None if nothing did."""
        return min((each.alarm_at for each in self.findings), default=None)

    @property
    def sentence(self) -> str:
        """The answer; where the log is of no service of the policy, that, and alarms alone."""
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
        """All but the course, ready for JSON."""
        return {
            "sentence": self.sentence,
            "is_alarm": bool(self.findings),
            "is_of_service": not self.foreign,
            "alarm_at": self.alarm_at,
            "num_trajectories": self.num_trajectories,
            "promised": self.promised,
            "earned": self.earned,
            "findings": [asdict(each) for each in self.findings],
            "causes": list(self.causes),
            "relearning": self.relearning,
            "doubts": list(self.doubts),
            "notes": list(self.notes),
        }


CLEARLY = 2.0
"""Standard errors."""
FEWEST = 200
"""Trajectories; where nothing changes, a policy of the bin from 100 earns a fifth less than one from 500, and one from
200 a twentieth less than one from 600 (`benchmarks/relearning.py`)."""
MEND_FIRST = "Mend what is recorded before you learn again: columns have changed, and perhaps not the cell."
OWN = 0.98
"""Share of the actions that are the policy's, from which on the log says too little of all others."""


def num_needed(value: Mapping[str, float] | None, num_learned: int, now: float | None) -> int | None:
    """Tell from how many trajectories on learning again may pay; None where nothing was lost.

    Parameters
    ----------
    value
        What was promised, ``value`` and ``standard_error``; None where nothing was.
    num_learned
        n, trajectories behind the promise.
    now
        What is earned since the change; None where that is not known.

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


def relearning(num_since: int, since: str | int, needed: int | None, own: float) -> str:
    """Say whether learning again may pay.

    Parameters
    ----------
    num_since
        Trajectories since the change.
    since
        Name of the first of them.
    needed
        As `num_needed` tells.
    own
        Share of their actions that are the policy's.
    """
    there = f"{counted(num_since, 'trajectory')} since the change"
    if needed is None:
        return f"Learning again need not pay: nothing is lost in {there}."
    blind = "; serve with --explore first, for they show hardly any action but the policy's" if own > OWN else ""
    if num_since < needed:
        return f"Learning again will not pay yet: there are {there}, and about {needed:,} are needed{blind}."
    how = f"halfseen learn LOGS --out FOLDER --since {since}"
    return f"Learning again may pay: there are {there}, and about {needed:,} are needed ({how}){blind}."
