"""Where a recording stands: values that are replaced whole, after each event."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from halfseen.errors import LogError
from halfseen.logs.checks import EARLIEST_DATE_S, UNIT_TOLERANCE, thousandfold
from halfseen.logs.recorded import RESOLUTION_S
from halfseen.logs.values import Schema, checked_number

_CLOCK_REMEDY = "give the time since the trajectory began [s]"


@dataclass(frozen=True)
class TrajectoryState:
    """Where a trajectory that is being recorded stands, and its clock, which never goes back.

    Parameters
    ----------
    name
        What it is called.
    number
        Its number among the trajectories that this recorder began.
    stage
        Number of the stage that began last; 0 before the first.
    is_in_stage, has_action
        Whether that stage is in progress, and began with an action.
    is_ended
        Whether the trajectory is finished or cut.
    at_s
        Time of the last event [s].
    is_given
        Whether times are given, not read from the machine's clock; None before the first.
    began_s
        When the trajectory began, on the machine's clock [s].
    completed_s
        When its last stage was completed [s].
    noted_s
        When it was last known on disk to be running [s].
    events
        Its events so far, where somebody checks the trajectory as it grows; else empty.
    """

    name: int | str
    number: int = 0
    stage: int = 0
    is_in_stage: bool = False
    has_action: bool = False
    is_ended: bool = False
    at_s: float = 0.0
    is_given: bool | None = None
    began_s: float = 0.0
    completed_s: float = 0.0
    noted_s: float = 0.0
    events: tuple[dict[str, Any], ...] = ()

    @classmethod
    def of(cls, events: Sequence[dict[str, Any]]) -> "TrajectoryState":
        """Where a trajectory stands whose events a journal has; its clock is one that is given from now on."""
        last = next(event for event in reversed(events) if event["event"] == "stage")
        done = [event for event in events if event["event"] == "done"]
        return cls(
            name=last["trajectory"],
            number=1,
            stage=last["stage"],
            is_in_stage=not done or events.index(done[-1]) < events.index(last),
            has_action="action" in last,
            at_s=max(event.get("at_s", 0.0) for event in events),
            is_given=True,
            completed_s=done[-1]["at_s"] if done else 0.0,
            events=tuple(events),
        )

    def started(self) -> "TrajectoryState":
        """The state whose clock begins to count now."""
        return replace(self, began_s=time.monotonic())

    def read_s(self) -> float:
        """Read the machine's clock [s], in nanoseconds, and never the same twice, however coarse that clock is."""
        return max(round(time.monotonic() - self.began_s, 9), round(self.at_s + RESOLUTION_S, 9))

    def after(self, at_s: float, elapsed_s: Any, **changed: Any) -> "TrajectoryState":
        """The state after an event at a time that was given as `elapsed_s` or, if None, read."""
        return replace(self, at_s=at_s, is_given=elapsed_s is not None, **changed)

    def time_of(self, elapsed_s: Any, where: str, *, is_later: bool = False) -> float:
        """Time of an event [s], given or, if None, read; checked to be no earlier (or later) than the last event."""
        if self.is_given not in (None, elapsed_s is not None):
            word = "missing" if elapsed_s is None else "given"
            raise LogError(f"{where}: elapsed_s is {word}, unlike before in this trajectory; give it always or never")
        if elapsed_s is None:
            return self.read_s()
        at_s = checked_number(elapsed_s, "elapsed_s", where, _CLOCK_REMEDY)
        trouble = None
        if at_s < self.at_s or (is_later and at_s == self.at_s):
            trouble = f"{'is before' if at_s < self.at_s else 'is still'} the {self.at_s} of the event before"
        elif 0.0 < at_s < RESOLUTION_S:
            trouble = f"is less than the {RESOLUTION_S} s that clocks tell apart"
        elif at_s >= EARLIEST_DATE_S:
            trouble = "is a date or no seconds"
        if trouble is not None:
            raise LogError(f"{where}: elapsed_s {at_s} {trouble}; {_CLOCK_REMEDY}")
        return at_s

    def end_s(self, elapsed_s: Any, where: str) -> float:
        """Time of the trajectory's end [s]: without a word about it, a clock that is given stands at the last event."""
        return self.at_s if self.is_given and elapsed_s is None else self.time_of(elapsed_s, where)

    def check_units(self, end_s: float, where: str) -> None:
        """Refuse a given end at a power of a thousand times the last stage's clock, which `Logs` takes for a unit."""
        times = float(thousandfold(end_s, self.completed_s, 2 * UNIT_TOLERANCE)) if self.is_given else 0.0
        if times > 1.0:
            raise LogError(
                f"{where}: elapsed_s {end_s} is {times:.0e} times the {self.completed_s} of the completed stage, as if "
                "units were mixed; give both in seconds"
            )


@dataclass(frozen=True)
class Recorded:
    """What a folder holds.

    Parameters
    ----------
    schema
        Names and kinds of what was recorded so far.
    num_shares
        Of how many robots each stage tells the rewards; None before the first completed stage.
    trajectory
        The trajectory that began last; None before the first of this recorder.
    """

    schema: Schema = field(default_factory=Schema)
    num_shares: int | None = None
    trajectory: TrajectoryState | None = None


def torn_by(events: list[dict[str, Any]], event: dict[str, Any]) -> list[dict[str, Any]]:
    """Events of the trajectory in progress after one more; empty where none is."""
    match event["event"]:
        case "stage" if event["stage"] == 1:
            return [event]
        case "finished" | "cut" | "hole":
            return []
        case "stage" | "done" | "running" | "out" if events:
            events.append(event)
    return events
