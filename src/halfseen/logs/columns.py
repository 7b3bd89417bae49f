"""Which columns each table has, and of which types."""

import re
from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from halfseen.errors import LogError
from halfseen.logs.frames import LARGEST_FRACTION
from halfseen.logs.refusal import place, shown, value_at
from halfseen.shapes import Bool, Float
from halfseen.suggestions import closest

STAGE_COLUMNS = ("trajectory", "stage", "elapsed_s", "action", "object", "reward", "probability", "robot")
TRAJECTORY_COLUMNS = ("trajectory", "end_s", "ending", "cause")
OBJECT_COLUMNS = ("trajectory", "stage", "object")
_OF_ONE_ROBOT = re.compile(r"\d+_reward")

NEEDED = {
    "stages": ("trajectory", "stage", "elapsed_s", "action", "reward"),
    "trajectories": ("trajectory", "end_s", "ending"),
    "objects": OBJECT_COLUMNS,
}
"""Columns that each table has, whatever else is known."""

_OWN = {"stages": STAGE_COLUMNS, "trajectories": TRAJECTORY_COLUMNS, "objects": OBJECT_COLUMNS}

FINISHED, CUT = "finished", "cut"
UNKNOWN_CAUSE = "unknown"


def is_own_reward(column: str) -> bool:
    """Whether a column of stages is what one robot of several brought, such as 0_reward."""
    return _OF_ONE_ROBOT.fullmatch(column) is not None


def is_stage_covariate(column: str) -> bool:
    """Whether a column of stages tells what was known when the stage began, not what came of it."""
    return column not in STAGE_COLUMNS and not is_own_reward(column)


def require_columns(name: str, frame: pd.DataFrame, needed: Iterable[str]) -> None:
    """Refuse a table that lacks a column; the message names those there and the closest match."""
    there = list(frame.columns)
    for column in needed:
        if column not in there:
            close = closest(column, there)
            remedy = f"rename {close!r}?" if close else "add it"
            raise LogError(f"{name}: there is no column {column!r} among {', '.join(there) or 'none'}; {remedy}")


def refuse_misnamed(name: str, frame: pd.DataFrame) -> None:
    """Refuse an extra column that belongs to another table, or whose name is nearly one that has a meaning.

    Either would be taken for a covariate, and what it says would be lost.
    """
    own = _OWN[name]
    for column in frame.columns:
        meant = column.strip().lower()
        if column not in own and meant in own:
            raise LogError(f"{name}: column {column!r} reads like {meant!r} and is none; rename it {meant!r}")
        owner = next((table for table, columns in _OWN.items() if meant in columns), name)
        if column not in own and owner != name:
            raise LogError(f"{name}: column {column!r} belongs to {owner}; put it there, or rename it")


def as_floats(name: str, frame: pd.DataFrame, column: str) -> pd.Series:
    """Turn a column into float64 with NaN where null; text is refused rather than parsed."""
    values: Any = frame[column]
    if values.isna().all():
        return pd.Series(np.nan, index=frame.index, dtype="float64")
    kind = pd.api.types.infer_dtype(values, skipna=True)
    if kind not in {"integer", "floating", "mixed-integer-float", "decimal"}:
        raise LogError(f"{name}: column {column!r} holds {kind}, not numbers; convert it")
    return pd.Series(values.to_numpy(dtype=np.float64, na_value=np.nan), index=frame.index)


def as_counts(name: str, frame: pd.DataFrame, column: str) -> pd.Series:
    """Turn a column of whole numbers into int64."""
    numbers = as_floats(name, frame, column).to_numpy()
    wrong = ~_is_whole(numbers)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise LogError(
            f"{name}, row {row}, {place(frame, row, ('trajectory',))}: {column} {numbers[row]} is no whole number; "
            "number the stages of a trajectory 1, 2, 3, …"
        )
    return pd.Series(numbers.astype(np.int64), index=frame.index)


def as_labels(name: str, frame: pd.DataFrame, column: str, *, is_null_allowed: bool) -> pd.Series:
    """Turn a column of names into whole numbers or text, whatever null did to its type on the way."""
    values: Any = frame[column]
    if isinstance(values.dtype, pd.CategoricalDtype):
        values = values.astype(values.cat.categories.dtype)
    is_null = values.isna().to_numpy()
    if is_null.any() and not is_null_allowed:
        raise LogError(f"{name}, row {int(np.argmax(is_null))}: {column} is null; every row needs its {column}")
    kind = pd.api.types.infer_dtype(values, skipna=True)
    if kind not in {"integer", "string", "floating", "empty"}:
        raise LogError(f"{name}: column {column!r} holds {kind}, not names; give whole numbers or text")
    if not pd.api.types.is_float_dtype(values.dtype) or is_null.all():
        return values
    numbers = values.to_numpy(dtype=np.float64, na_value=np.nan)
    wrong = ~is_null & ~_is_whole(numbers)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise LogError(f"{name}, row {row}: {column} {numbers[row]} is no name; give whole numbers or text")
    return values.astype("Int64" if is_null.any() else "int64")


def _is_whole(numbers: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Which are whole numbers that fractions tell apart."""
    return (np.abs(numbers) <= LARGEST_FRACTION) & (numbers == np.floor(numbers))


def check_covariates(name: str, frame: pd.DataFrame, known: tuple[str, ...]) -> None:
    """Refuse null, NaN and infinity among numeric covariates, those in lists included."""
    columns = ("trajectory", "stage", "object") if name == "objects" else ("trajectory", "stage")
    for column in frame.columns:
        missing = _missing_numbers(frame[column]) if column not in known else np.zeros(0, dtype=bool)
        if missing.any():
            row = int(np.argmax(missing))
            raise LogError(
                f"{place(frame, row, columns)}: covariate {column} is {shown(value_at(frame, column, row))}; give the "
                f"number that the policy saw, or leave column {column!r} of {name} out"
            )


def _missing_numbers(values: Any) -> Bool[np.ndarray, " rows"]:
    """Rows that lack a finite number, in a numeric column or inside a list of numbers."""
    if pd.api.types.is_numeric_dtype(values.dtype):
        missing = values.isna().to_numpy()
        return missing | np.isinf(values.to_numpy(dtype=np.float64, na_value=np.nan))
    if values.dtype == object and pd.api.types.infer_dtype(values, skipna=True) == "mixed":
        return _missing_in_lists(pa.array(values, from_pandas=True))
    return np.zeros(len(values), dtype=bool)


def _missing_in_lists(lists: Any) -> Bool[np.ndarray, " rows"]:
    if not pa.types.is_list(lists.type) or not _holds_numbers(lists.type.value_type):
        return np.zeros(len(lists), dtype=bool)
    missing = np.array(lists.is_null())
    is_wrong = ~np.isfinite(lists.flatten().cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False))
    missing[np.array(lists.value_parent_indices(), dtype=np.int64)[is_wrong]] = True
    return missing


def _holds_numbers(kind: pa.DataType) -> bool:
    return pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_null(kind)
