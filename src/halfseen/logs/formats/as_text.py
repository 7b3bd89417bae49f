"""Columns as text, in words for their types that fit into JSON, and what of a log does not come back from a form.

What `losses` does not name comes back equal, to the last type and bit, from CSV and from whatever else keeps cells as
text.
"""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import pandas as pd
import pyarrow as pa

from halfseen.errors import ArgumentError, LogError
from halfseen.logs.logs import Logs
from halfseen.logs.missing import missing_in, share_of
from halfseen.reading import MOST_LEVELS, check_levels

ColumnType: TypeAlias = str | Mapping[str, Any]
"""Name of a type, such as ``"double"`` or ``"list<int64>"``; for categories ``{"categories": …, …}``."""

_NUMBERS = [f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)]
_PLAIN = {name: pa.type_for_alias(name) for name in [*_NUMBERS, "float", "double", "bool", "string", "null"]}
_TIMES = {"date32[day]": pa.date32()}
# Whole numbers that may be null, as pandas calls them; text of pandas' own has a name that no type of Arrow has.
_NULLABLE = re.compile(r"U?Int(8|16|32|64)|Float(32|64)|boolean")
_PANDAS_TEXT = "String"
PARQUET, CSV, MINARI = "parquet", "csv", "minari"


def column_type(table: str, frame: pd.DataFrame, column: str) -> ColumnType:
    """Name the type of a column of checked logs.

    Raises
    ------
    LogError
        The column is of a type that has no text of its own.
    """
    values = frame[column]
    if isinstance(values.dtype, pd.CategoricalDtype):
        categories = values.dtype.categories.to_series(name=column)
        kind = column_type(table, categories.to_frame(), column)
        cells = texts(categories, kind)
        return {"categories": cells, "type": kind, "is_ordered": bool(values.dtype.ordered)}
    if _NULLABLE.fullmatch(str(values.dtype)):
        return str(values.dtype)
    if str(values.dtype) == "string":
        return _PANDAS_TEXT
    kind = type_name(pa.array(values, from_pandas=True).type)
    if kind is None:
        raise LogError(
            f"{table}: column {column!r} holds {pa.array(values, from_pandas=True).type}, which has no form as text; "
            "drop it or turn it into numbers, text, times or lists of these"
        )
    return kind


def column_types(tables: Mapping[str, pd.DataFrame]) -> dict[str, dict[str, ColumnType]]:
    """Name the types of all columns of the tables of checked logs."""
    return {name: {column: column_type(name, table, column) for column in table} for name, table in tables.items()}


def as_cells(values: Any, kind: ColumnType) -> pa.Array:
    """Bring a column into the form in which it is written: lists as JSON, times as ISO 8601, the rest as it is."""
    if isinstance(kind, Mapping):
        values = values.astype(object)
    cells: Any = pa.array(values, from_pandas=True)
    if pa.types.is_list(cells.type):
        lists = cells.to_pylist()
        return pa.array([None if items is None else json.dumps(items) for items in lists], pa.string())
    if _is_time(cells.type):
        return cells.cast(pa.string())
    return cells


def texts(values: Any, kind: ColumnType) -> list[str | None]:
    """Write the cells of a column as text, null as None."""
    return as_cells(values, kind).cast(pa.string()).to_pylist()


def from_texts(cells: Any, kind: ColumnType) -> Any:
    """Read the cells of a column, an array or a list of text and None, as values of a type.

    Raises
    ------
    ValueError
        A cell is of another type (`pyarrow.ArrowInvalid` and `json.JSONDecodeError` are such), or the type is unknown.
    """
    texts = cells if isinstance(cells, pa.Array | pa.ChunkedArray) else pa.array(cells, pa.string())
    if isinstance(kind, Mapping):
        categories = from_texts(list(kind["categories"]), kind["type"])
        return pd.Categorical(from_texts(texts, kind["type"]), list(categories), bool(kind["is_ordered"]))
    values = _parsed(texts, arrow_type(kind))
    if _NULLABLE.fullmatch(kind) or kind == _PANDAS_TEXT:
        dtype: Any = pd.api.types.pandas_dtype("string" if kind == _PANDAS_TEXT else kind)
        return pd.Series(dtype.__from_arrow__(values))
    return values.to_pandas()


def arrow_type(name: str) -> pa.DataType:
    """Find the type of a name that `column_type` gave.

    Raises
    ------
    ValueError
        There is no such type.
    """
    if name == _PANDAS_TEXT:
        return pa.string()
    if _NULLABLE.fullmatch(name):
        return pa.type_for_alias(name.lower())
    if name.count("list<") > MOST_LEVELS:
        raise ValueError(f"it is nested more than {MOST_LEVELS} levels deep")
    if found := re.fullmatch(r"list<(.+)>", name):
        return pa.list_(arrow_type(found[1]))
    if found := re.fullmatch(r"timestamp\[(ms|us|ns)(?:, tz=(.+))?\]", name):
        return pa.timestamp(found[1], found[2])
    if kind := (_PLAIN | _TIMES).get(name):
        return kind
    raise ValueError(f"type {name!r} is unknown; there are {', '.join([*_PLAIN, *_TIMES, 'timestamp[us]', 'list<…>'])}")


def type_name(kind: pa.DataType) -> str | None:
    """Name a type of Arrow; None where it has no text of its own."""
    if pa.types.is_list(kind):
        item = kind.value_type
        inner = None if _is_time(item) else type_name(item)
        return inner and f"list<{inner}>"
    return str(kind) if _is_time(kind) or str(kind) in _PLAIN else None


def _is_time(kind: pa.DataType) -> bool:
    return pa.types.is_timestamp(kind) or str(kind) in _TIMES


def _parsed(cells: Any, kind: pa.DataType) -> Any:
    if pa.types.is_null(kind):
        if cells.null_count < len(cells):
            raise ValueError("there are values where all should be null")
        return pa.nulls(len(cells))
    if not pa.types.is_list(kind):
        return cells.cast(kind)
    return pa.array([None if cell is None else list_of(cell) for cell in cells.to_pylist()], kind)


def list_of(cell: str) -> Any:
    """Read a JSON list from a cell; unlike a file of JSON, it may hold NaN.

    Raises
    ------
    ValueError
        It is none, or one that is nested too deeply.
    """
    try:
        read = json.loads(cell)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    check_levels(read)
    return read


def from_list_texts(cells: Any) -> pa.Array | None:
    """Read a column of text whose every cell is a JSON list; None where it is none."""
    kind = list_type(cells.drop_null().unique().to_pylist()) if pa.types.is_string(cells.type) else None
    return None if kind is None else _parsed(cells, arrow_type(kind))


def list_type(cells: list[str]) -> str | None:
    """Name the type of JSON lists; None if they are none after all, or there are none."""
    if not cells or not all(cell.startswith("[") for cell in cells):
        return None
    try:
        return type_name(pa.array([list_of(cell) for cell in cells]).type)
    except (ValueError, pa.ArrowException):
        return None


@dataclass(frozen=True)
class Loss:
    """Something that does not come back as it is.

    Parameters
    ----------
    table
        Where it is.
    column
        Which column; None for the whole table.
    trouble
        What becomes of it.
    is_refused
        Whether the log is not written because of it; if not, the values come back and something else is lost.
    """

    table: str
    column: str | None
    trouble: str
    is_refused: bool

    def __str__(self) -> str:
        return f"{self.table}: {'' if self.column is None else f'column {self.column!r} '}{self.trouble}"


def losses(logs: Logs, form: str) -> list[Loss]:
    """Find out what of a log does not come back from a form.

    Raises
    ------
    ArgumentError
        The form is unknown.
    """
    if form not in (PARQUET, CSV, MINARI):
        raise ArgumentError(f"form {form!r}: it is none of {PARQUET}, {CSV}, {MINARI}; choose one")
    if form == PARQUET:
        return []
    columns = [(table, column) for table, frame in logs.tables.items() for column in frame.columns]
    as_text = (_lost_as_text(table, logs.tables[table], column) for table, column in columns)
    found = [loss for loss in as_text if loss is not None]
    if form == CSV:
        trouble = "has a name that is not one line; rename it"
        found += [Loss(table, column, trouble, True) for table, column in columns if len(column.splitlines()) != 1]
    if form == MINARI and not logs.stages["elapsed_s"].notna().to_numpy().any():
        trouble = "none was completed, so that Minari would have no step; record longer, or write Parquet"
        found.append(Loss("stages", None, trouble, is_refused=True))
    null = missing_in(logs.stages, logs.stage_covariates) if form == MINARI else {}
    remedy = "fill it in, and write that: read_logs(LOGS, missing='median+flag')"
    return found + [
        Loss("stages", name, f"is null in {share_of(num, logs.num_stages)}; {remedy}", is_refused=True)
        for name, num in null.items()
        if pd.api.types.is_numeric_dtype(logs.stages[name].dtype)
    ]


def refuse_lost(logs: Logs, form: str) -> None:
    """Refuse a log of which something cannot be written in a form; all of it is named.

    Raises
    ------
    LogError
        There is such.
    """
    found = [str(loss) for loss in losses(logs, form) if loss.is_refused]
    if found:
        raise LogError("; ".join(found))


def _lost_as_text(table: str, frame: pd.DataFrame, column: str) -> Loss | None:
    try:
        column_type(table, frame, column)
    except LogError as error:
        return Loss(table, column, str(error).partition(f"column {column!r} ")[2], is_refused=True)
    dtype: Any = frame[column].dtype
    if isinstance(dtype, pd.ArrowDtype):
        return Loss(table, column, f"comes back as pandas keeps such values, not as {dtype}", is_refused=False)
    return None
