"""The clock of a trajectory that is being recorded: read from the machine, or given with each event; never both."""

import time
from dataclasses import dataclass, replace
from math import log
from typing import Any

from halfseen.errors import LogError
from halfseen.logs.journal.values import checked_number
from halfseen.logs.schema import EARLIEST_DATE_S, UNIT_TOLERANCE

RESOLUTION_S = 1e-9
"""What a clock can tell apart [s]; a trajectory that was torn before its clock moved ends there."""

_REMEDY = "give the time since the trajectory began [s]"


@dataclass(frozen=True)
class TrajectoryClock:
    """Seconds since a trajectory began, which never go back.

    Parameters
    ----------
    at_s
        Time of the last event [s].
    is_given
        Whether times are given; None until the first event tells.
    began_s
        When the trajectory began, on the machine's clock [s].
    completed_s
        When its last stage was completed [s].
    """

    at_s: float = 0.0
    is_given: bool | None = None
    began_s: float = 0.0
    completed_s: float = 0.0

    @classmethod
    def started(cls) -> "TrajectoryClock":
        """A clock that begins to count now."""
        return cls(began_s=time.monotonic())

    def read_s(self) -> float:
        """Read the machine's clock [s], in nanoseconds, and never the same twice, however coarse that clock is."""
        return max(round(time.monotonic() - self.began_s, 9), round(self.at_s + RESOLUTION_S, 9))

    def advanced(self, at_s: float, elapsed_s: Any) -> "TrajectoryClock":
        """The clock after an event at this time, which was given as `elapsed_s` or, if None, read."""
        return replace(self, at_s=at_s, is_given=elapsed_s is not None)

    def time_of(self, elapsed_s: Any, where: str, *, is_later: bool = False) -> float:
        """Time of an event [s], given or, if None, read; checked to be no earlier (or later) than the last event."""
        if self.is_given not in (None, elapsed_s is not None):
            word = "missing" if elapsed_s is None else "given"
            raise LogError(f"{where}: elapsed_s is {word}, unlike before in this trajectory; give it always or never")
        if elapsed_s is None:
            return self.read_s()
        at_s = checked_number(elapsed_s, "elapsed_s", where, _REMEDY)
        if at_s < self.at_s or (is_later and at_s == self.at_s):
            word = "is before" if at_s < self.at_s else "is still"
            raise LogError(f"{where}: elapsed_s {at_s} {word} the {self.at_s} of the event before; {_REMEDY}")
        if 0.0 < at_s < RESOLUTION_S:
            raise LogError(
                f"{where}: elapsed_s {at_s} is less than the {RESOLUTION_S} s that clocks tell apart; {_REMEDY}"
            )
        if at_s >= EARLIEST_DATE_S:
            raise LogError(f"{where}: elapsed_s {at_s} is a date or no seconds; {_REMEDY}")
        return at_s

    def end_s(self, elapsed_s: Any, where: str) -> float:
        """Time of the trajectory's end [s]: without a word about it, a clock that is given stands at the last event."""
        return self.at_s if self.is_given and elapsed_s is None else self.time_of(elapsed_s, where)

    def check_units(self, end_s: float, where: str) -> None:
        """Refuse a given end at a power of a thousand times the last stage's clock, which `Logs` takes for a unit."""
        if not self.is_given or self.completed_s == 0.0:  # a clock that still stands tells no unit
            return
        thousands = log(end_s / self.completed_s) / log(1000.0)
        if round(thousands) > 0 and abs(thousands - round(thousands)) < 2 * UNIT_TOLERANCE:
            raise LogError(
                f"{where}: elapsed_s {end_s} is {1000.0 ** round(thousands):.0e} times the {self.completed_s} of the "
                "completed stage, as if units were mixed; give both in seconds"
            )
