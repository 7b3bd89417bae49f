"""What is predicted, and how much each row counts: from right-censored times to a target Y(T) and a weight.

Y is a known function of the time. Where it needs the time up to τ only, the event is that min(T, τ) was seen, so a path
that is cut after τ counts in full (design, §2). Rows weigh w = δ / Ĝ(min(T, τ)⁻ | z).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from halfseen.arrays import RowMask, Rows
from halfseen.censoring import CensoringModel, censoring_weights, named_model, uses_covariates
from halfseen.censoring.inputs import checked_ends, checked_floats
from halfseen.errors import ArgumentError, PositivityError

TIME_COLUMNS = ("time", "time_s")
FINISHED_COLUMN = "is_finished"


@dataclass(frozen=True)
class Ends:
    """Observed ends of paths."""

    time: Rows
    is_finished: RowMask
    """False where the path was cut."""

    def restricted(self, tau: float | None) -> "Ends":
        """min(T, τ), and whether it was seen."""
        if tau is None:
            return self
        return Ends(np.minimum(self.time, tau), self.is_finished | (self.time >= tau))


def survival_array(time: ArrayLike, is_finished: ArrayLike) -> np.ndarray:
    """Times and whether they were seen as one structured array, which scikit-learn can split and shuffle.

    Parameters
    ----------
    time
        Observed end of each path [s], shape (n,).
    is_finished
        False where the path was cut, shape (n,).

    Returns
    -------
    ndarray
        Fields ``is_finished`` (bool) and ``time`` (float64), shape (n,), as scikit-survival has it.
    """
    ends, finished = checked_ends(time, is_finished)
    array = np.empty(len(ends), dtype=[(FINISHED_COLUMN, np.bool_), ("time", np.float64)])
    array[FINISHED_COLUMN], array["time"] = finished, ends
    return array


def as_ends(y: Any) -> Ends | None:
    """Read the ends of paths; None if `y` is a plain column of targets, of which nothing was cut.

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
    if isinstance(y, pd.DataFrame) and len(y.columns) > 1:
        return Ends(*checked_ends(*_of_frame(y)))
    if isinstance(y, tuple) and len(y) == 2 and np.ndim(y[0]) == 1:
        return Ends(*checked_ends(y[0], y[1]))
    if isinstance(y, np.ndarray) and y.dtype.names:
        return Ends(*checked_ends(*_of_record(y)))
    return None


def _of_frame(y: pd.DataFrame) -> tuple[Any, Any]:
    times = [name for name in TIME_COLUMNS if name in y.columns]
    if len(times) != 1 or FINISHED_COLUMN not in y.columns:
        raise ArgumentError(
            f"y has the columns {list(y.columns)}; give is_finished (False where cut) and one of time and time_s"
        )
    return y[times[0]], y[FINISHED_COLUMN]


def _of_record(y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    names = y.dtype.names or ()
    flags = [name for name in names if y.dtype[name] == np.bool_]
    times = [name for name in names if y.dtype[name].kind in "fiu"]
    if len(names) != 2 or len(flags) != 1 or len(times) != 1:
        raise ArgumentError(
            f"y has the fields {y.dtype}; give one boolean (True where the end was seen) and one of times"
        )
    return y[times[0]], y[flags[0]]


def checked_tau(tau: float | int | None) -> float | None:
    """τ [s], > 0."""
    if tau is not None and not 0.0 < tau < np.inf:
        raise ArgumentError(f"tau is {tau}; it is a time > 0 s, or None for times that are not restricted")
    return None if tau is None else float(tau)


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


def check_lengths(rows: np.ndarray, targets: np.ndarray) -> None:
    """Refuse rows and targets that do not pair.

    Raises
    ------
    ArgumentError
        Their numbers differ.
    """
    if len(rows) != len(targets):
        raise ArgumentError(f"X has {len(rows)} rows and y has {len(targets)}; give one target a row")


def row_weights(
    ends: Ends | None,
    rows: np.ndarray,
    counts: Rows,
    censoring: str | CensoringModel,
    tau: float | None,
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
        Name of a model, a model to fit anew, or ``"none"``: rows that were seen count alike.
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
    seen, counted = ends.restricted(tau), counts > 0
    if not seen.is_finished[counted].any():
        raise PositivityError(
            f"all {len(rows)} paths were cut before their target was seen; record until some finish, or give a tau "
            "that some outlived"
        )
    if isinstance(censoring, str) and censoring == "none":
        return counts * seen.is_finished, None
    model = named_model(censoring)
    covariates = _covariates(model, rows)
    model.fit(ends.time[counted], ends.is_finished[counted], None if covariates is None else covariates[counted])
    weights = censoring_weights(
        seen.time, seen.is_finished & counted, model, covariates=covariates, truncate_at=truncate_at
    )
    return counts * weights, model


def _covariates(model: CensoringModel, rows: np.ndarray) -> np.ndarray | None:
    if not uses_covariates(model):
        return None
    if rows.dtype == object:
        raise ArgumentError("censoring uses covariates, and X holds sets; choose 'kaplan-meier'")
    return rows
