"""Names and types of the columns of a log, and errors for broken logs.

An error message gives the place, the fault, the value and the remedy.
"""

import re
from collections.abc import Callable, Collection, Iterable, Sequence
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from halfseen.errors import LogError, closest
from halfseen.logs.missing import remedy_of, share_of
from halfseen.shapes import Bool, Float

LARGEST_FRACTION = 2**53
"""From here on, float64 cannot distinguish neighbouring whole numbers: this one may also represent the next."""

STEPPED_BACK = "stepped_back"
"""Column with the reason why the rule decided in place of the policy, else null; not a covariate."""
ARM, RULE = "arm", "rule"
"""Column of trajectories that a comparison dealt, and its value for those of the rule of today."""
DECIDED_BY = "policy_digest"
"""Column of trajectories with the identifier of the policy in service that decided them."""
ROBOT = "robot"
"""Column of the robot that decides in a stage; a log without it has one robot."""
# fmt: off
COLUMNS: dict[str, dict[str, str | None]] = {
    "stages": {
        "trajectory": "name", "stage": "count", "elapsed_s": "number", "action": "name or null",
        "object": "name or null", "reward": "number", "probability": "number", ROBOT: "name",
        STEPPED_BACK: "name or null",
    },
    "trajectories": {"trajectory": "name", "end_s": "number", "ending": None, "cause": "name or null"},
    "objects": {"trajectory": "name", "stage": "count", "object": "name"},
}
"""Reserved columns of each table, and their types; `type_of` adds those of single robots."""
# fmt: on
_OPTIONAL = {"stages": ("object", "probability", ROBOT, STEPPED_BACK), "trajectories": ("cause",), "objects": ()}
NEEDED = {name: tuple(each for each in of if each not in _OPTIONAL[name]) for name, of in COLUMNS.items()}
"""Required columns of each table."""
STAGE_COLUMNS, TRAJECTORY_COLUMNS, OBJECT_COLUMNS = map(tuple, COLUMNS.values())
OWN_NAMES = frozenset(name for of in COLUMNS.values() for name in of)
NUMBERS = [name for of in COLUMNS.values() for name, kind in of.items() if kind == "number"]
"""Reserved columns of numbers."""
FINISHED, CUT = "finished", "cut"
UNKNOWN_CAUSE = "unknown"

MOST_SHOWN = 200
"""Maximum number of characters of a value in a message."""


# Errors.


def shown(value: object) -> str:
    """Format a value as in the table: 17, but '17' for text, and null for any kind of null."""
    if pd.api.types.is_scalar(value) and bool(np.asarray(pd.isna(value))):
        return "null"
    text = " ".join(map(str.strip, repr(value.item() if isinstance(value, np.generic) else value).splitlines()))
    return text if len(text) <= MOST_SHOWN else f"{text[:MOST_SHOWN]}…"


def value_at(frame: pd.DataFrame, column: str, row: int) -> Any:
    """Read one value with the type of its column; reading a whole row would turn its integers into floats."""
    return frame[column].iloc[row]


def place(frame: pd.DataFrame, row: int, columns: tuple[str, ...] = ("trajectory", "stage")) -> str:
    """Name a row: trajectory 17, stage 4."""
    return ", ".join(f"{column} {shown(value_at(frame, column, row))}" for column in columns)


def first_true(is_so: np.ndarray) -> int | None:
    """The first row in which something is so; None if there is none."""
    return int(np.argmax(is_so)) if is_so.any() else None


def refuse(
    frame: pd.DataFrame,
    wrong: np.ndarray,
    trouble: str | Callable[[int], str],
    columns: tuple[str, ...] = ("trajectory", "stage"),
) -> None:
    """Raise for the first wrong row, if there is one; `trouble` may be a function of that row."""
    if (row := first_true(wrong)) is not None:
        raise LogError(f"{place(frame, row, columns)}: {trouble if isinstance(trouble, str) else trouble(row)}")


def converting(folder: Any) -> str:
    """The remedy for logs of version 1, which called trajectories paths."""
    return f"convert it: halfseen convert {folder} --out NEW"


# Names of columns.


def chosen_names(given: Any, known: np.ndarray) -> pd.Index:
    """Names of some trajectories; refuse a mask, unknown names, and names that are given twice."""
    if isinstance(given, str) or not isinstance(given, Iterable):
        raise LogError(f"select takes names of trajectories, not {shown(given)}; give a list of them")
    wanted = pd.Index(given)
    if pd.api.types.is_bool_dtype(wanted.dtype):
        raise LogError("select takes names of trajectories, not a mask; give trajectory_ids[mask]")
    unknown, again = wanted[~wanted.isin(known)], wanted[wanted.duplicated()]
    if len(unknown):
        raise LogError(f"trajectory {shown(unknown[0])}: the log has no such trajectory; see trajectory_ids")
    if len(again):
        raise LogError(f"trajectory {shown(again[0])}: it is named twice, and a log holds it once; name it once")
    return wanted


def is_own_reward(column: str) -> bool:
    """Whether a column of stages is the reward of one robot of several, such as 0_reward."""
    return re.fullmatch(r"\d+_reward", column) is not None


def is_of_one_robot(column: str) -> bool:
    """Whether a column is the reward of one robot of several, or the time or cause of its dropout."""
    return re.fullmatch(r"\d+_(reward|out_s|out_cause)", column) is not None


def robots_that_may_drop_out(trajectories: pd.DataFrame) -> list[int]:
    """Numbers of the robots whose dropouts the trajectories record."""
    found = (re.fullmatch(r"(\d+)_out_s", str(column)) for column in trajectories.columns)
    return sorted(int(each[1]) for each in found if each is not None)


def type_of(table: str, column: str) -> str | None:
    """Type of a reserved column; None for others."""
    if is_of_one_robot(column) and is_own_reward(column) == (table == "stages") and table != "objects":
        return "name or null" if column.endswith("_out_cause") else "number"
    return COLUMNS[table].get(column)


def is_stage_covariate(column: str) -> bool:
    """Whether a column of stages is a covariate: known when the stage began, not an outcome."""
    return column not in STAGE_COLUMNS and not is_own_reward(column)


def require_columns(name: str, frame: pd.DataFrame, needed: Iterable[str]) -> None:
    """Refuse a table that lacks a column; the message lists its columns and the closest match."""
    there = list(frame.columns)
    for column in needed:
        if column not in there:
            close = closest(column, there)
            remedy = f"rename {close!r}?" if close else "add it"
            raise LogError(f"{name}: there is no column {column!r} among {', '.join(there) or 'none'}; {remedy}")


def refuse_repeated(place: object, names: Sequence[str], remedy: str = "drop or rename one") -> None:
    """Refuse a table with two columns of the same name."""
    repeated = next((name for k, name in enumerate(names) if name in names[:k]), None)
    if repeated is not None:
        raise LogError(f"{place}: there are two columns {repeated!r}; {remedy}")


def refuse_misnamed(name: str, frame: pd.DataFrame) -> None:
    """Refuse an extra column that belongs to another table, or whose name is nearly that of a standard column.

    Either would be taken for a covariate, and its meaning would be lost.
    """
    own = COLUMNS[name]
    for column in (column for column in frame.columns if column not in own):
        meant = column.strip().lower()
        if meant in own:
            raise LogError(
                f"{name}: column {column!r} reads like {meant!r}, but is not that column; rename it {meant!r}"
            )
        for owner in (table for table, columns in COLUMNS.items() if meant in columns):
            raise LogError(f"{name}: column {column!r} belongs to {owner}; put it there, or rename it")


# Types of columns.


def as_floats(name: str, frame: pd.DataFrame, column: str) -> pd.Series:
    """Convert a column to float64, null to NaN; text is refused rather than parsed."""
    values: Any = frame[column]
    if values.isna().all():
        return pd.Series(np.nan, index=frame.index, dtype="float64")
    kind = pd.api.types.infer_dtype(values, skipna=True)
    if kind not in {"integer", "floating", "mixed-integer-float", "decimal"}:
        raise LogError(f"{name}: column {column!r} holds {kind}, not numbers; convert it")
    return pd.Series(values.to_numpy(dtype=np.float64, na_value=np.nan), index=frame.index)


def as_counts(name: str, frame: pd.DataFrame, column: str) -> pd.Series:
    """Convert a column of whole numbers to int64."""
    numbers = as_floats(name, frame, column).to_numpy()
    if (row := first_true(~_is_whole(numbers))) is not None:
        raise LogError(
            f"{name}, row {row}, {place(frame, row, ('trajectory',))}: {column} {numbers[row]} is not a whole "
            "number; number the stages of a trajectory 1, 2, 3, …"
        )
    return pd.Series(numbers.astype(np.int64), index=frame.index)


def as_labels(name: str, frame: pd.DataFrame, column: str, *, is_null_allowed: bool) -> pd.Series:
    """Convert a column of names to whole numbers or text, even if nulls turned it into floats."""
    values: Any = frame[column]
    if isinstance(values.dtype, pd.CategoricalDtype):
        values = values.astype(values.cat.categories.dtype)
    is_null = values.isna().to_numpy()
    if is_null.any() and not is_null_allowed:
        raise LogError(f"{name}, row {int(np.argmax(is_null))}: {column} is null; every row needs its {column}")
    if is_null.all():
        return pd.Series(None, index=frame.index, dtype=object)
    kind = pd.api.types.infer_dtype(values, skipna=True)
    if kind not in {"integer", "string", "floating"}:
        raise LogError(f"{name}: column {column!r} holds {kind}, not names; give whole numbers or text")
    if not pd.api.types.is_float_dtype(values.dtype):
        return values
    numbers = values.to_numpy(dtype=np.float64, na_value=np.nan)
    if (row := first_true(~is_null & ~_is_whole(numbers))) is not None:
        is_large = abs(numbers[row]) >= LARGEST_FRACTION
        why = ", as floats from 2^53 on do not hold every whole number" if is_large else ""
        raise LogError(
            f"{name}, row {row}: {column} {numbers[row]} is not a valid name{why}; give whole numbers or text"
        )
    return values.astype("Int64" if is_null.any() else "int64")


def _is_whole(numbers: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Which are whole numbers that float64 represents exactly."""
    return (np.abs(numbers) < LARGEST_FRACTION) & (numbers == np.floor(numbers))


def check_covariates(name: str, frame: pd.DataFrame, known: Collection[str], *, may_be_null: bool = False) -> None:
    """Refuse null, NaN and infinity in numeric covariates and in lists of numbers; null may be allowed."""
    for column in (column for column in frame.columns if column not in known):
        wrong = _missing_numbers(frame[column])
        is_null = frame[column].isna().to_numpy(dtype=bool) if wrong.any() else wrong
        wrong = wrong & ~is_null if may_be_null else wrong
        columns = OBJECT_COLUMNS if name == "objects" else ("trajectory", "stage")
        refuse(frame, wrong, partial(_missing_in_words, name, frame, column, is_null), columns)


def _missing_in_words(name: str, frame: pd.DataFrame, column: str, is_null: Bool[np.ndarray, " rows"], row: int) -> str:
    what = f"covariate {column} is {shown(value_at(frame, column, row))}"
    if name == "objects" or not is_null[row]:
        return f"{what}; give the number that the policy saw, or leave column {column!r} of {name} out"
    return f"{what}, as in {share_of(int(is_null.sum()), len(frame))} read together; {remedy_of(column)}"


def _missing_numbers(values: Any) -> Bool[np.ndarray, " rows"]:
    """Rows with a missing or infinite number, in a numeric column or in a list of numbers."""
    if pd.api.types.is_numeric_dtype(values.dtype):
        return ~np.isfinite(values.to_numpy(dtype=np.float64, na_value=np.nan))
    if values.dtype == object and pd.api.types.infer_dtype(values, skipna=True) == "mixed":
        lists: Any = pa.array(values, from_pandas=True)
        item = lists.type.value_type if pa.types.is_list(lists.type) else pa.string()
        if pa.types.is_floating(item) or pa.types.is_integer(item) or pa.types.is_null(item):
            missing = np.array(lists.is_null())
            is_wrong = ~np.isfinite(lists.flatten().cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False))
            missing[np.array(lists.value_parent_indices(), dtype=np.int64)[is_wrong]] = True
            return missing
    return np.zeros(len(values), dtype=bool)
