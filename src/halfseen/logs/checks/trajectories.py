"""What must hold for trajectories: each ends once, at a time, finished or cut."""

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
"""What is longer is no trajectory but a date, or counted in milliseconds or less [s]; 32 years."""

_ROW = ("trajectory",)


def checked_trajectories(frame: pd.DataFrame) -> pd.DataFrame:
    """Bring the trajectories into order and check them.

    Parameters
    ----------
    frame
        Columns trajectory, end_s [s], ending, and, if any trajectory has one, cause.

    Returns
    -------
    DataFrame
        Sorted by trajectory; a cut without a cause has the cause "unknown".

    Raises
    ------
    LogError
        A column is missing, a trajectory is there twice, or its end is no end.
    """
    require_columns("trajectories", frame, NEEDED["trajectories"])
    refuse_misnamed("trajectories", frame)
    if len(frame) == 0:
        raise LogError("trajectories: there are none; a log has at least one trajectory")
    trajectories = frame.copy()
    trajectories["trajectory"] = as_labels("trajectories", trajectories, "trajectory", is_null_allowed=False)
    trajectories["end_s"] = as_floats("trajectories", trajectories, "end_s")
    trajectories = trajectories.sort_values("trajectory", kind="stable", ignore_index=True)
    _check_ids(trajectories)
    _check_ends(trajectories)
    is_cut = _checked_endings(trajectories)
    trajectories["cause"] = _checked_causes(trajectories, is_cut)
    return with_drop_outs(trajectories)


def _check_ids(trajectories: pd.DataFrame) -> None:
    repeated = trajectories["trajectory"].duplicated().to_numpy()
    refuse(
        trajectories, repeated, "it is in trajectories twice; give each trajectory one row and a name of its own", _ROW
    )


def _check_ends(trajectories: pd.DataFrame) -> None:
    end_s = trajectories["end_s"].to_numpy()
    wrong = ~((end_s > 0) & np.isfinite(end_s))
    remedy = "give the finite time from its beginning to its end, > 0 s"
    refuse(trajectories, wrong, lambda row: f"end_s {end_s[row]} is no end; {remedy}", _ROW)
    dated, remedy = end_s >= EARLIEST_DATE_S, "give the seconds since the trajectory's beginning"
    refuse(trajectories, dated, lambda row: f"end_s {end_s[row]} is a date or no seconds; {remedy}", _ROW)


def _checked_endings(trajectories: pd.DataFrame) -> Bool[np.ndarray, " n"]:
    endings = trajectories["ending"].to_numpy(dtype=object)
    # A list in a cell compares with a word element by element.
    words = pd.Series([ending if isinstance(ending, str) else "" for ending in endings], dtype=object)
    is_cut, is_finished = (words.eq(word).to_numpy(dtype=bool) for word in (CUT, FINISHED))
    remedy = (
        f"{FINISHED!r} where the trajectory reached its own end, and {CUT!r} where something outside the task ended it"
    )
    wrong = ~(is_cut | is_finished)
    refuse(trajectories, wrong, lambda row: f"ending {shown(endings[row])} is unknown; say {remedy}", _ROW)
    return is_cut


def _checked_causes(trajectories: pd.DataFrame, is_cut: Bool[np.ndarray, " n"]) -> pd.Series:
    if "cause" not in trajectories.columns:
        trajectories["cause"] = pd.Series(None, index=trajectories.index, dtype=object)
    causes = as_labels("trajectories", trajectories, "cause", is_null_allowed=True).astype(object)
    is_null = causes.isna().to_numpy()
    remedy = f"only a cut has one: leave it null, or make the ending {CUT!r}"
    wrong = ~is_cut & ~is_null
    refuse(
        trajectories,
        wrong,
        lambda row: f"it finished, yet has the cause {shown(value_at(trajectories, 'cause', row))}; {remedy}",
        _ROW,
    )
    return causes.mask(pd.Series(is_cut & is_null, index=causes.index), UNKNOWN_CAUSE)
