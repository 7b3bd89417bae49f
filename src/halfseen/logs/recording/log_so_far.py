"""A trajectory that is being recorded, as a log that whoever reads it later can judge now."""

from collections.abc import Sequence
from typing import Any

from halfseen.logs.columns import CUT
from halfseen.logs.journal.tables import STILL_RUNNING, RecordedTrajectory, tables_of
from halfseen.logs.logs import Logs


def log_so_far(events: Sequence[dict[str, Any]]) -> Logs:
    """Give the log of one trajectory, cut at its last event.

    Parameters
    ----------
    events
        Of the trajectory, as a journal has them, the beginning of its first stage first.

    Raises
    ------
    LogError
        What happened so far is none that a log takes.
    """
    first, *others = events
    trajectory = RecordedTrajectory(first)
    for event in others:
        trajectory.add(event)
    trajectory.end(CUT, None, STILL_RUNNING)
    return Logs(**tables_of([trajectory]))
