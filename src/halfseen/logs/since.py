"""The later part of a log: from a trajectory, or a date, on."""

from datetime import datetime
from typing import Any

import pandas as pd

from halfseen.errors import ArgumentError
from halfseen.logs.columns import shown
from halfseen.logs.logs import Logs


def since(logs: Logs, when: str | int | datetime) -> Logs:
    """Keep the trajectories from one on, in the order of their names; or from a date on.

    Parameters
    ----------
    logs
        The log.
    when
        Name of the first one that is kept; or a date, where the trajectories have a column of dates.

    Raises
    ------
    ArgumentError
        There is no such trajectory, and no such date.
    """
    dates = [name for name in logs.trajectory_columns if pd.api.types.is_datetime64_any_dtype(logs.trajectories[name])]
    is_kept = _from_name(logs, when) if not isinstance(when, datetime) else None
    if is_kept is None and dates:
        is_kept = _from_date(logs.trajectories[dates[0]], when)
    if is_kept is None or not is_kept.any():
        there = " to ".join(shown(logs.trajectory_ids[k]) for k in (0, -1))
        there += f", or a date by its column {dates[0]!r}" if dates else ""
        raise ArgumentError(f"since is {when!s:.80}, and the log has no such trajectory; give the name of one, {there}")
    return logs if is_kept.all() else logs.select(logs.trajectory_ids[is_kept])


def _from_name(logs: Logs, when: Any) -> Any:
    names = pd.Index(logs.trajectory_ids)
    at = names.map(str).get_indexer([str(when)])[0]
    return None if at < 0 else pd.RangeIndex(len(names)) >= at


def _from_date(dates: Any, when: Any) -> Any:
    date: Any = pd.to_datetime(when, errors="coerce") if isinstance(when, str | datetime) else pd.NaT
    if pd.isna(date):
        return None
    if (date.tzinfo is None) != (dates.dt.tz is None):
        date = date.tz_localize(None) if dates.dt.tz is None else date.tz_localize(dates.dt.tz)
    return (dates >= date).to_numpy()
