"""The later part of a log, from a trajectory or a date on."""

import re
from collections.abc import Mapping
from datetime import datetime
from typing import Any

import pandas as pd

from halfseen.errors import ArgumentError
from halfseen.logs.columns import shown
from halfseen.logs.logs import Logs

_DAY = r"\d{4}-\d{2}-\d{2}"
_OF_ZONE = re.compile(r"([T ].*?)(?: ?Z|[+-][\d:]+)$")


def since(logs: Logs, when: str | int | datetime) -> Logs:
    """Keep the trajectories from a given one on, in the order of their names; or from a date on.

    Parameters
    ----------
    logs
        The log.
    when
        Name of the first trajectory to keep; or a date, if the trajectories have a column of dates, also as ISO text.
        A date without a zone is one of the column's own clock.

    Raises
    ------
    ArgumentError
        `when` matches no trajectory and no date, or a date is missing, or columns of dates disagree.
    """
    columns = {name: _dates(logs.trajectories[name], _has_zone(when)) for name in logs.trajectory_columns}
    dates = {name: found for name, found in columns.items() if found is not None}
    is_kept = _from_name(logs, when) if not isinstance(when, datetime) else None
    if is_kept is None and dates:
        is_kept = _from_dates(logs, dates, when)
    if is_kept is None or not is_kept.any():
        there = " to ".join(shown(logs.trajectory_ids[k]) for k in (0, -1))
        there += f", or a date by its column {next(iter(dates))!r}, as 2026-01-31" if dates else ""
        raise ArgumentError(f"since is {when!s:.80}, and the log has no such trajectory; give the name of one, {there}")
    return logs if is_kept.all() else logs.select(logs.trajectory_ids[is_kept])


def _from_name(logs: Logs, when: Any) -> Any:
    names = pd.Index(logs.trajectory_ids)
    at = names.map(str).get_indexer([str(when)])[0]
    return None if at < 0 else pd.RangeIndex(len(names)) >= at


def _has_zone(when: Any) -> bool:
    return getattr(pd.to_datetime(when, format="ISO8601", errors="coerce"), "tzinfo", None) is not None


def _dates(values: Any, in_utc: bool) -> Any:
    """A column of dates, also of ISO text, whose offsets are dropped unless `in_utc`; None for another."""
    if pd.api.types.is_datetime64_any_dtype(values):
        return values
    text = values.dropna().astype(str)
    if pd.api.types.is_numeric_dtype(values) or not len(text) or not text.str.match(_DAY).all():
        return None
    is_zoned = text.map(lambda each: _OF_ZONE.search(each) is not None)
    text = text if in_utc else text.str.replace(_OF_ZONE, r"\1", regex=True)
    dates: Any = pd.to_datetime(text, format="ISO8601", errors="coerce", utc=in_utc and bool(is_zoned.any()))
    return None if dates.isna().any() or is_zoned.nunique() > 1 else dates.reindex(values.index)


def _from_dates(logs: Logs, dates: Mapping[str, Any], when: Any) -> Any:
    each = {name: kept for name, column in dates.items() if (kept := _from_date(column, when)) is not None}
    whole = [name for name in each if not dates[name].isna().any()]
    if each and not whole:
        name = next(iter(each))
        lacking = shown(logs.trajectory_ids[dates[name].isna().to_numpy().argmax()])
        raise ArgumentError(f"since is {when!s:.80}, but {name} of trajectory {lacking} is missing; name a trajectory")
    if any((each[name] != each[whole[0]]).any() for name in whole):
        raise ArgumentError(f"since is {when!s:.80}, on which {' and '.join(whole)} disagree; name a trajectory")
    return each[whole[0]] if whole else None


def _from_date(dates: Any, when: Any) -> Any:
    # 1700 may be meant as a trajectory, and 05.01.2026 as either day.
    if not isinstance(when, datetime) and not re.match(_DAY, str(when)):
        return None
    date: Any = pd.to_datetime(when, format="ISO8601", errors="coerce")
    if pd.isna(date):
        return None
    if (date.tzinfo is None) != (dates.dt.tz is None):
        date = date.tz_localize(None) if dates.dt.tz is None else date.tz_localize(dates.dt.tz)
    return (dates >= date).to_numpy()
