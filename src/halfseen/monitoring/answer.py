"""What a log of a policy in service says: one sentence, what has changed, and the course of things."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from halfseen.monitoring.confidence_sequences import Course
from halfseen.monitoring.outcomes import Outcomes
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

    @property
    def alarm_at(self) -> int | None:
        """Trajectory, counted from 1, at which anything alarmed first; None if nothing did."""
        return min((each.alarm_at for each in self.findings), default=None)

    @property
    def sentence(self) -> str:
        """The answer."""
        earned = ""
        if self.earned is not None:
            words = "since then it earns {since:.3g} a trajectory"
            words = words if self.findings else "it earns {value:.3g} a trajectory ({low:.3g} to {high:.3g})"
            earned = words.format(**self.earned)
        if self.promised is not None:
            promise = "{value:.3g} was promised ({low:.3g} to {high:.3g})".format(**self.promised)
            earned = f"{earned}, {promise}" if earned else promise
        if not self.findings:
            seen = f"in {counted(self.num_trajectories, 'trajectory')} nothing has changed"
            return f"No alarm: {seen}{'; ' if earned else ''}{earned}."
        first = self.findings[0]
        since = f"since about trajectory {first.since} ({first.since_low} to {first.since_high})"
        return f"Alarm at trajectory {self.alarm_at}: {first.words}, {since}{'; ' if earned else ''}{earned}."

    def as_dict(self) -> dict[str, Any]:
        """All but the course, ready for JSON."""
        return {
            "sentence": self.sentence,
            "is_alarm": bool(self.findings),
            "alarm_at": self.alarm_at,
            "num_trajectories": self.num_trajectories,
            "promised": self.promised,
            "earned": self.earned,
            "findings": [asdict(each) for each in self.findings],
            "causes": list(self.causes),
            "relearning": self.relearning,
            "notes": list(self.notes),
        }
