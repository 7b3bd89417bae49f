"""What is predicted, and how much each row counts: from right-censored times to a target Y(T) and a weight.

Y is a known function of the time. Where it needs the time up to τ only, the event is that min(T, τ) was seen, so a
trajectory that is cut after τ counts in full (design, §2). Rows weigh w = δ / Ĝ(min(T, τ)⁻ | z).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from halfseen.arrays import RowMask, Rows
from halfseen.censoring import CensoringModel, censoring_weights, named_model, uses_covariates
from halfseen.censoring.inputs import checked_ends, checked_floats
from halfseen.censoring.tied_times import clock_tolerance_s
from halfseen.errors import ArgumentError, PositivityError


class Ends(NamedTuple):
    """Observed ends of trajectories [s], and whether they are the trajectory's own; False where it was cut."""

    time: Rows
    is_finished: RowMask


def survival_array(time: ArrayLike, is_finished: ArrayLike) -> np.ndarray:
    """Times and whether they were seen as one structured array, which scikit-learn can split and shuffle.

    Parameters
    ----------
    time
        Observed end of each trajectory [s], shape (n,).
    is_finished
        False where the trajectory was cut, shape (n,).

    Returns
    -------
    ndarray
        Fields ``is_finished`` (bool) and ``time`` (float64), shape (n,), as scikit-survival has it.
    """
    ends, finished = checked_ends(time, is_finished)
    array = np.empty(len(ends), dtype=[("is_finished", np.bool_), ("time", np.float64)])
    array["is_finished"], array["time"] = finished, ends
    return array


def as_ends(y: Any) -> Ends | None:
    """Read the ends of trajectories; None if `y` is a plain column of targets, of which nothing was cut.

    Parameters
    ----------
    y
        A structured array with one boolean field and one of times, as scikit-survival has it; a frame with the columns
        ``is_finished`` and ``time`` or ``time_s``; a tuple (time, is_finished); or one number (or label) a row.

    Raises
    ------
    ArgumentError
        It is none of these, or a time is not finite and positive.
    """
    if isinstance(y, tuple) and len(y) == 2 and np.ndim(y[0]) == 1:
        return Ends(*checked_ends(*y))
    if isinstance(y, pd.DataFrame) and len(y.columns) > 1:
        times = [name for name in ("time", "time_s") if name in y.columns]
        if len(times) != 1 or "is_finished" not in y.columns:
            raise ArgumentError(
                f"y has the columns {list(y.columns)}; give is_finished (False where cut) and one of time and time_s"
            )
        return Ends(*checked_ends(y[times[0]], y["is_finished"]))
    if isinstance(y, np.ndarray) and y.dtype.names:
        flags = [name for name in y.dtype.names if y.dtype[name] == np.bool_]
        times = [name for name in y.dtype.names if y.dtype[name].kind in "fiu"]
        if len(y.dtype.names) != 2 or len(flags) != 1 or len(times) != 1:
            raise ArgumentError(
                f"y has the fields {y.dtype}; give one boolean (True where the end was seen) and one of times"
            )
        return Ends(*checked_ends(y[times[0]], y[flags[0]]))
    return None


def target_values(time: Rows, target: str | Callable[[Rows], Any]) -> Rows:
    """Y(T).

    Raises
    ------
    ArgumentError
        There is no such target, or it gives something else than one finite number a row.
    """
    if callable(target):
        values = checked_floats(target(time), "target(time)")
        if values.shape != time.shape:
            raise ArgumentError(f"target(time) has {len(values)} rows for {len(time)} times; return one number a time")
    elif target == "identity":
        values = time
    elif target == "log":
        values = np.log(np.where(time > 0, time, np.nan))
    else:
        raise ArgumentError(f"target is {target!r}; it is 'identity', 'log' or a function of the times")
    wrong = ~np.isfinite(values)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise ArgumentError(
            f"y, row {row}: the target of {time[row]} is {values[row]}; give a target that is finite there, or mend "
            "the row"
        )
    return values


def row_weights(
    ends: Ends | None,
    rows: np.ndarray,
    counts: Rows,
    censoring: str | CensoringModel,
    tau: float | int | None,
    truncate_at: float | int | None,
) -> tuple[Rows, CensoringModel | None]:
    """Weight of each row, and the censoring model that gave it.

    Parameters
    ----------
    ends
        Times and whether they were seen; None if nothing could be cut.
    rows
        Covariates, for models that use them, shape (n, F), or sets.
    counts
        How many rows each one stands for. Ĝ is fitted to the rows above 0, each once.
    censoring
        Name of a model, a model to fit again, or ``"none"``: rows that were seen count alike.
    tau
        τ [s], if times are restricted.
    truncate_at
        Largest 1/Ĝ allowed, if any.

    Raises
    ------
    ArgumentError
        The model needs covariates, and the rows are sets.
    PositivityError
        Nothing was seen, or Ĝ is 0 where something was.
    """
    if ends is None:
        return counts, None
    time, is_seen = ends
    if tau is not None:
        time, is_seen = np.minimum(time, tau), is_seen | (time >= tau - clock_tolerance_s(time))
    counted = counts > 0
    if not is_seen[counted].any():
        raise PositivityError(
            f"all {len(rows)} trajectories were cut before their target was seen; record until some finish, or give a "
            "tau that some outlived"
        )
    if isinstance(censoring, str) and censoring == "none":
        return counts * is_seen, None
    model = named_model(censoring)
    covariates = rows if uses_covariates(model) else None
    if covariates is not None and covariates.dtype == object:
        raise ArgumentError("censoring uses covariates, and X holds sets; choose 'kaplan-meier'")
    model.fit(ends.time[counted], ends.is_finished[counted], None if covariates is None else covariates[counted])
    weights = censoring_weights(time, is_seen & counted, model, covariates=covariates, truncate_at=truncate_at)
    return counts * weights, model
