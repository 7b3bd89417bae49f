"""Validation of inputs: array-likes become checked float64 and bool arrays, and messages name bad values.

Covariates: a matrix or a table becomes a checked float64 matrix and its column names.
"""

from contextlib import suppress
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from halfseen.arrays import LEAST_RANGE, RowMask, Rows
from halfseen.errors import ArgumentError
from halfseen.estimator import is_number
from halfseen.shapes import Bool, Float, Int


def checked_ends(time: ArrayLike, is_finished: ArrayLike, name: str = "time") -> tuple[Rows, RowMask]:
    """Check observed ends of trajectories, and whether each trajectory finished.

    Parameters
    ----------
    time
        Observed end of each trajectory [s], finite and positive, shape (n,).
    is_finished
        True if the trajectory finished, False if it was cut, shape (n,); 0 and 1 are accepted.
    name
        Name of `time` in the caller's signature, for the message.
    """
    refuse_other_order(**{name: time, "is_finished": is_finished})
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
            f"{name}, row {row}: {ends[row]} is not the end of a trajectory; give a finite time after the "
            "trajectory's beginning, > 0 s"
        )
    return ends, finished


def checked_floats(values: ArrayLike, name: str, ndim: int = 1) -> np.ndarray:
    """`values` as float64 with `ndim` axes."""
    floats = as_floats(values, name)
    if floats.ndim != ndim:
        raise ArgumentError(f"{name} has shape {floats.shape}; give {ndim} ax{'e' if ndim > 1 else 'i'}s")
    return floats


def as_floats(values: ArrayLike | float, name: str) -> np.ndarray:
    """`values` as float64, of any shape."""
    _refuse_other_kinds(values, name)
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise ArgumentError(f"{name} is not numeric ({error}); give an array of floats") from error


def _refuse_other_kinds(values: Any, name: str) -> None:
    """Refuse masked entries, whose mask NumPy would drop, and dates and complex numbers, which it would convert."""
    if np.ma.is_masked(values):
        row = int(np.argwhere(np.ma.getmaskarray(values))[0][0])
        raise ArgumentError(f"{name}, row {row}: masked; fill it in, or leave the row out knowingly")
    kind = getattr(values, "dtype", None)
    if kind is None:
        # Lists and Arrow arrays have no dtype of their own; a list that is ragged has none, and is refused later.
        with suppress(ValueError):
            kind = np.asarray(values).dtype
    if getattr(kind, "kind", "f") in "mMc":
        raise ArgumentError(f"{name} holds {kind}, not real numbers; convert it, times to seconds")


def checked_times(u: ArrayLike) -> Float[np.ndarray, "..."]:
    """Times of a query as float64; NaN is refused."""
    times = as_floats(u, "u")
    if np.isnan(times).any():
        row = int(np.argmax(np.isnan(times.ravel())))
        raise ArgumentError(f"u, row {row}: nan is not a time; leave out the stages that were not completed")
    return times


def precision_of(values: Any) -> float:
    """Relative rounding of values in half or single precision; 0 in double, to which they are converted."""
    kind: Any = getattr(values, "dtype", None)
    kind = getattr(kind, "numpy_dtype", kind)
    is_short = getattr(kind, "kind", "") == "f" and getattr(kind, "itemsize", 8) < 8
    return float(np.finfo(kind).eps) if is_short else 0.0


def shortest_float(*given: Any) -> type[np.floating]:
    """The float type of the least precise of some values, so that equal times stay equal."""
    precision = max(map(precision_of, given))
    return next((kind for kind in (np.float16, np.float32) if np.finfo(kind).eps == precision), np.float64)


def just_before(times: Float[np.ndarray, "*S"], tolerance_s: float, precision: float) -> Float[np.ndarray, "*S"]:
    """Times less their tolerance: the larger of an absolute one [s], and a relative one."""
    sizes = np.where(np.isfinite(times), np.abs(times), 0.0)
    return np.asarray(times - np.maximum(tolerance_s, precision * sizes))


def checked_truncation(truncate_at: float | int | None) -> float | int | None:
    """Refuse a bound on the weights below 1: every weight 1/Ĝ is at least 1."""
    if truncate_at is not None and not (is_number(truncate_at) and truncate_at >= 1.0):
        raise ArgumentError(
            f"truncate_at is {truncate_at!r}; weights are at least 1, so give a finite bound ≥ 1, or None"
        )
    return truncate_at


def _checked_bools(values: ArrayLike, name: str) -> RowMask:
    _refuse_other_kinds(values, name)
    flags = np.asarray(values)
    if flags.ndim != 1:
        raise ArgumentError(f"{name} has shape {flags.shape}; give one axis")
    if flags.dtype == np.bool_:
        return flags
    # Nullable booleans arrive as objects, indicators as 0 and 1; anything else is invalid.
    wrong = ~pd.Series(flags).isin([0, 1]).to_numpy(dtype=bool)
    if wrong.any():
        row = int(np.argmax(wrong))
        value = flags[row : row + 1].tolist()[0]
        raise ArgumentError(
            f"{name}, row {row}: {value!r} is neither True nor False; give True where finished and False where cut"
        )
    return flags.astype(np.bool_)


def refuse_other_order(**given: Any) -> None:
    """Refuse pandas values of the same labels in different orders: rows are matched by their places."""
    first = None
    for name, values in given.items():
        labels = values.index if isinstance(values, pd.Series | pd.DataFrame) else None
        if labels is None or not labels.is_unique:
            continue
        first = (name, labels) if first is None else first
        if len(labels) == len(first[1]) and not labels.equals(first[1]) and labels.isin(first[1]).all():
            row = int(np.argmax(np.asarray(labels != first[1])))
            raise ArgumentError(
                f"{name}, row {row}: its label is {labels.tolist()[row]!r}, but that of {first[0]} is "
                f"{first[1].tolist()[row]!r}; sort "
                f"both alike, as {name}.loc[{first[0]}.index] does, or drop labels that name no trajectory"
            )


LARGEST = 1e75
"""Covariates of larger size, or all smaller than its inverse, over- or underflow when squared twice."""


def checked_covariates(
    covariates: Any, num_rows: int, kind: str, names: list[str] | None = None
) -> tuple[Float[np.ndarray, "n p"], list[str]]:
    """Covariates of trajectories as float64, and the names of their columns.

    Parameters
    ----------
    covariates
        One row per trajectory, shape (n, p): array-like, or a pandas or Arrow table, whose names are kept.
    num_rows
        Number of trajectories.
    kind
        The calling model, for the message.
    names
        Columns of the fit; a table is reordered to match. None at the fit.
    """
    if covariates is None:
        raise ArgumentError(f"{kind} needs covariates, one row for each trajectory; give them, or use KaplanMeier")
    table = _as_table(covariates)
    if table is not None:
        values, found = _table_values(table, names), [str(name) for name in table.columns]
        found = found if names is None else names
    else:
        values = _matrix(covariates)
        found = [f"column {j}" for j in range(values.shape[1])] if names is None else names
    if len(values) != num_rows:
        raise ArgumentError(
            f"covariates has {len(values)} rows for {num_rows} trajectories; give one row per trajectory"
        )
    if values.shape[1] != len(found):
        raise ArgumentError(
            f"covariates has {values.shape[1]} columns, but the fit had {len(found)}; give the same columns"
        )
    if values.shape[1] == 0:
        raise ArgumentError("covariates has no columns; give at least one, or use KaplanMeier")
    wrong = np.argwhere(~np.isfinite(values))
    if len(wrong):
        row, column = wrong[0]
        raise ArgumentError(
            f"covariates, row {row}, {found[column]}: {values[row, column]} is not a value; fill it in, or "
            "leave the trajectory out knowingly"
        )
    sizes = np.abs(values).max(axis=0, initial=0.0)
    extreme = np.flatnonzero((sizes > LARGEST) | ((sizes > 0.0) & (sizes < 1.0 / LARGEST)))
    if len(extreme):
        column = extreme[0]
        raise ArgumentError(f"covariates, {found[column]}: the largest is {sizes[column]:g}; give it in another unit")
    return values, found


def rows_of(covariates: Any, rows: Int[np.ndarray, " k"], num_trajectories: int) -> Any:
    """Repeat the covariates of these trajectories, as a table if they were one."""
    if covariates is None:
        return None
    known = _known(covariates)
    if len(known) != num_trajectories:
        raise ArgumentError(
            f"covariates has {len(known)} rows for {num_trajectories} trajectories; give one row per trajectory"
        )
    return known.iloc[rows] if isinstance(known, pd.DataFrame) else known[rows]


def checked_question(
    u: ArrayLike, covariates: Any, kind: str, names: list[str]
) -> tuple[Float[np.ndarray, "..."], Float[np.ndarray, "m p"]]:
    """Check the times of a query [s], and the covariates: a row per entry of the first axis, or one row for all."""
    times = checked_times(u)
    is_single = covariates is not None and len(_known(covariates)) == 1
    num_rows = len(times) if times.ndim and not is_single else 1
    values, _ = checked_covariates(covariates, num_rows, kind, names)
    return times, values


def varies(covariates: Float[np.ndarray, "n p"]) -> Bool[np.ndarray, " p"]:
    """Which covariates differ between rows by more than rounding."""
    return np.ptp(covariates, axis=0) > LEAST_RANGE * np.abs(covariates).max(axis=0)


def refuse_constant(covariates: Float[np.ndarray, "n p"], names: list[str]) -> None:
    """Refuse a covariate that is the same for all trajectories."""
    constant = ~varies(covariates)
    if constant.any():
        column = int(np.argmax(constant))
        raise ArgumentError(
            f"covariates, {names[column]}: {covariates[0, column]:g} in every row, so it does not distinguish "
            "trajectories; leave it out"
        )


def _known(covariates: Any) -> pd.DataFrame | np.ndarray:
    table = _as_table(covariates)
    return np.atleast_1d(np.asarray(covariates)) if table is None else table


def _as_table(covariates: Any) -> pd.DataFrame | None:
    if isinstance(covariates, pd.Series):
        return covariates.to_frame()
    if hasattr(covariates, "column_names"):
        return covariates.to_pandas()
    return covariates if isinstance(covariates, pd.DataFrame) else None


def _matrix(covariates: Any) -> Float[np.ndarray, "n p"]:
    _refuse_other_kinds(covariates, "covariates")
    try:
        values = np.asarray(covariates, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise ArgumentError(f"covariates is not numeric ({error}); encode categories as numbers") from error
    if values.ndim != 2:
        raise ArgumentError(
            f"covariates has shape {values.shape}; give one row per trajectory and one column per covariate"
        )
    return values


def _table_values(table: pd.DataFrame, names: list[str] | None) -> Float[np.ndarray, "n p"]:
    table = table.set_axis([str(name) for name in table.columns], axis=1)
    if table.columns.has_duplicates:
        twice = table.columns[table.columns.duplicated()][0]
        raise ArgumentError(f"covariates has two columns {twice!r}; rename one")
    if names is not None:
        missing, unknown = set(names) - set(table.columns), set(table.columns) - set(names)
        if missing or unknown:
            wrong = f"lacks {sorted(missing)[0]!r}" if missing else f"has {sorted(unknown)[0]!r}, unknown to the fit"
            raise ArgumentError(f"covariates {wrong}; give the columns of the fit: {', '.join(names)}")
        table = table.loc[:, names]
    if all(isinstance(kind, np.dtype) and kind.kind in "biuf" for kind in table.dtypes):
        return np.ascontiguousarray(table.to_numpy(dtype=np.float64))
    columns = []
    for name in table.columns:
        _refuse_other_kinds(table[name], f"covariates, {name}")
        try:
            columns.append(np.asarray(table[name].astype("float64")))
        except (TypeError, ValueError) as error:
            raise ArgumentError(
                f"covariates, {name}: not numeric ({error}); encode its categories as numbers"
            ) from error
    return np.stack(columns, axis=1) if columns else np.empty((len(table), 0))
