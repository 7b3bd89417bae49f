"""What every fit and every weight accepts: array-likes in, checked float64 and bool out, bad values named."""

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from halfseen.arrays import RowMask, Rows
from halfseen.errors import ArgumentError
from halfseen.shapes import Float


def checked_ends(time: ArrayLike, is_finished: ArrayLike, name: str = "time") -> tuple[Rows, RowMask]:
    """Observed ends of trajectories and whether each was the trajectory's own.

    Parameters
    ----------
    time
        Observed end of each trajectory [s], finite and positive, shape (n,).
    is_finished
        True where the trajectory reached its own end, False where it was cut, shape (n,); 0 and 1 will do.
    name
        What `time` is called in the caller's signature, for the message.

    Raises
    ------
    ArgumentError
        There are no rows, the lengths differ, or a value is none that a trajectory can have; the row is named.
    """
    ends = checked_floats(time, name)
    finished = _checked_bools(is_finished, "is_finished")
    if len(ends) != len(finished):
        raise ArgumentError(
            f"{name} has {len(ends)} rows and is_finished has {len(finished)}; give one of each per trajectory"
        )
    if len(ends) == 0:
        raise ArgumentError(f"{name} has no rows; give at least one trajectory")
    wrong = ~((ends > 0) & np.isfinite(ends))
    if wrong.any():
        row = int(np.argmax(wrong))
        raise ArgumentError(
            f"{name}, row {row}: {ends[row]} is no end of a trajectory; give a finite time after the trajectory's "
            "beginning, > 0 s"
        )
    return ends, finished


def checked_floats(values: ArrayLike, name: str, ndim: int = 1) -> np.ndarray:
    """`values` as float64 with `ndim` axes."""
    try:
        floats = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ArgumentError(f"{name} is not made of numbers ({error}); give an array of floats") from error
    if floats.ndim != ndim:
        raise ArgumentError(f"{name} has shape {floats.shape}; give {ndim} ax{'e' if ndim > 1 else 'i'}s")
    return floats


def checked_times(u: ArrayLike) -> Float[np.ndarray, "..."]:
    """Times asked about as float64; NaN is none.

    Raises
    ------
    ArgumentError
        A time is NaN; its row is named.
    """
    times = np.asarray(u, dtype=np.float64)
    if np.isnan(times).any():
        row = int(np.argmax(np.isnan(times.ravel())))
        raise ArgumentError(f"u, row {row}: nan is no time; leave out the stages that were not completed")
    return times


def checked_truncation(truncate_at: float | int | None) -> float | int | None:
    """Refuse a bound on the weights that none could meet: every weight 1/Ĝ is at least 1."""
    if truncate_at is not None and not 1.0 <= truncate_at < np.inf:
        raise ArgumentError(
            f"truncate_at is {truncate_at}; weights are at least 1, so give a finite bound ≥ 1, or None"
        )
    return truncate_at


def _checked_bools(values: ArrayLike, name: str) -> RowMask:
    flags = np.asarray(values)
    if flags.ndim != 1:
        raise ArgumentError(f"{name} has shape {flags.shape}; give one axis")
    if flags.dtype == np.bool_:
        return flags
    # A nullable boolean arrives as objects, an indicator as 0 and 1; anything else is no answer to yes or no.
    wrong = ~pd.Series(flags).isin([0, 1]).to_numpy(dtype=bool)
    if wrong.any():
        row = int(np.argmax(wrong))
        value = flags[row : row + 1].tolist()[0]
        raise ArgumentError(f"{name}, row {row}: {value!r} is neither; give True where finished and False where cut")
    return flags.astype(np.bool_)
