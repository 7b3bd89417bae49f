"""What must hold for paths: each ends once, at a time, finished or cut."""

import numpy as np
import pandas as pd

from halfseen.errors import LogError
from halfseen.logs.checks.robots import with_drop_outs
from halfseen.logs.columns import (
    CUT,
    FINISHED,
    NEEDED,
    UNKNOWN_CAUSE,
    as_floats,
    as_labels,
    refuse_misnamed,
    require_columns,
)
from halfseen.logs.refusal import refuse, shown, value_at
from halfseen.shapes import Bool

EARLIEST_DATE_S = 1e9
"""What is longer is no path but a date, or counted in milliseconds or less [s]; 32 years."""

_ROW = ("path",)


def checked_paths(frame: pd.DataFrame) -> pd.DataFrame:
    """Bring the paths into order and check them.

    Parameters
    ----------
    frame
        Columns path, end_s [s], ending, and, if any path has one, cause.

    Returns
    -------
    DataFrame
        Sorted by path; a cut without a cause has the cause "unknown".

    Raises
    ------
    LogError
        A column is missing, a path is there twice, or its end is no end.
    """
    require_columns("paths", frame, NEEDED["paths"])
    refuse_misnamed("paths", frame)
    if len(frame) == 0:
        raise LogError("paths: there are none; a log has at least one path")
    paths = frame.copy()
    paths["path"] = as_labels("paths", paths, "path", is_null_allowed=False)
    paths["end_s"] = as_floats("paths", paths, "end_s")
    paths = paths.sort_values("path", kind="stable", ignore_index=True)
    _check_ids(paths)
    _check_ends(paths)
    is_cut = _checked_endings(paths)
    paths["cause"] = _checked_causes(paths, is_cut)
    return with_drop_outs(paths)


def _check_ids(paths: pd.DataFrame) -> None:
    repeated = paths["path"].duplicated().to_numpy()
    refuse(paths, repeated, "it is in paths twice; give each path one row and a name of its own", _ROW)


def _check_ends(paths: pd.DataFrame) -> None:
    end_s = paths["end_s"].to_numpy()
    wrong = ~((end_s > 0) & np.isfinite(end_s))
    remedy = "give the finite time from its beginning to its end, > 0 s"
    refuse(paths, wrong, lambda row: f"end_s {end_s[row]} is no end; {remedy}", _ROW)
    dated, remedy = end_s >= EARLIEST_DATE_S, "give the seconds since the path's beginning"
    refuse(paths, dated, lambda row: f"end_s {end_s[row]} is a date or no seconds; {remedy}", _ROW)


def _checked_endings(paths: pd.DataFrame) -> Bool[np.ndarray, " n"]:
    endings = paths["ending"].to_numpy(dtype=object)
    # A list in a cell compares with a word element by element.
    words = pd.Series([ending if isinstance(ending, str) else "" for ending in endings], dtype=object)
    is_cut, is_finished = (words.eq(word).to_numpy(dtype=bool) for word in (CUT, FINISHED))
    remedy = f"{FINISHED!r} where the path reached its own end, and {CUT!r} where something outside the task ended it"
    wrong = ~(is_cut | is_finished)
    refuse(paths, wrong, lambda row: f"ending {shown(endings[row])} is unknown; say {remedy}", _ROW)
    return is_cut


def _checked_causes(paths: pd.DataFrame, is_cut: Bool[np.ndarray, " n"]) -> pd.Series:
    if "cause" not in paths.columns:
        paths["cause"] = pd.Series(None, index=paths.index, dtype=object)
    causes = as_labels("paths", paths, "cause", is_null_allowed=True).astype(object)
    is_null = causes.isna().to_numpy()
    remedy = f"only a cut has one: leave it null, or make the ending {CUT!r}"
    wrong = ~is_cut & ~is_null
    refuse(
        paths,
        wrong,
        lambda row: f"it finished, yet has the cause {shown(value_at(paths, 'cause', row))}; {remedy}",
        _ROW,
    )
    return causes.mask(pd.Series(is_cut & is_null, index=causes.index), UNKNOWN_CAUSE)
