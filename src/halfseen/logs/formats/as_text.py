"""Columns as text, with JSON names for their types; and the parts of a log that do not survive a format.

Everything that `losses` does not name comes back equal, in type and to the last bit, from CSV and other formats that
store cells as text.
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
# Nullable types as pandas names them; pandas' own text type gets a name that no Arrow type has.
_NULLABLE = re.compile(r"U?Int(8|16|32|64)|Float(32|64)|boolean")
_PANDAS_TEXT = "String"
PARQUET, CSV, MINARI = "parquet", "csv", "minari"


def column_type(table: str, frame: pd.DataFrame, column: str) -> ColumnType:
    """Name the type of a column of checked logs.

    Raises
    ------
    LogError
        The type of the column cannot be written as text.
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
            f"{table}: column {column!r} holds {pa.array(values, from_pandas=True).type}, which cannot be written as "
            "text; drop it, or convert it to numbers, text, times or lists of these"
        )
    return kind


def column_types(tables: Mapping[str, pd.DataFrame]) -> dict[str, dict[str, ColumnType]]:
    """Name the types of all columns of the tables of checked logs."""
    return {name: {column: column_type(name, table, column) for column in table} for name, table in tables.items()}


def as_cells(values: Any, kind: ColumnType) -> pa.Array:
    """Convert a column for writing: lists to JSON, times to ISO 8601, the rest unchanged."""
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
        A cell has another type (also as `pyarrow.ArrowInvalid` or `json.JSONDecodeError`), or the type is unknown.
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
    """The Arrow type for a name from `column_type`.

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
    raise ValueError(
        f"type {name!r} is unknown; choose among {', '.join([*_PLAIN, *_TIMES, 'timestamp[us]', 'list<…>'])}"
    )


def type_name(kind: pa.DataType) -> str | None:
    """Name of an Arrow type; None if it cannot be written as text."""
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
    """Read a JSON list from a cell; unlike a JSON file, it may hold NaN.

    Raises
    ------
    ValueError
        The cell is not a JSON list, or is nested too deeply.
    """
    try:
        read = json.loads(cell)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    check_levels(read)
    return read


def from_list_texts(cells: Any) -> pa.Array | None:
    """Read a text column in which every cell is a JSON list; None for other columns."""
    kind = list_type(cells.drop_null().unique().to_pylist()) if pa.types.is_string(cells.type) else None
    return None if kind is None else _parsed(cells, arrow_type(kind))


def list_type(cells: list[str]) -> str | None:
    """Name of the type of JSON lists; None if a cell is not such a list, or there are no cells."""
    if not cells or not all(cell.startswith("[") for cell in cells):
        return None
    try:
        return type_name(pa.array([list_of(cell) for cell in cells]).type)
    except (ValueError, pa.ArrowException):
        return None


@dataclass(frozen=True)
class Loss:
    """Part of a log that does not come back unchanged.

    Parameters
    ----------
    table
        Name of the table.
    column
        Name of the column; None for the whole table.
    trouble
        What is lost.
    is_refused
        Whether the log is refused because of it; if not, the values come back and something else is lost.
    """

    table: str
    column: str | None
    trouble: str
    is_refused: bool

    def __str__(self) -> str:
        return f"{self.table}: {'' if self.column is None else f'column {self.column!r} '}{self.trouble}"


def losses(logs: Logs, form: str) -> list[Loss]:
    """Find the parts of a log that do not survive a format.

    Raises
    ------
    ArgumentError
        The format is unknown.
    """
    if form not in (PARQUET, CSV, MINARI):
        raise ArgumentError(f"form {form!r}: choose among {PARQUET}, {CSV}, {MINARI}")
    if form == PARQUET:
        return []
    columns = [(table, column) for table, frame in logs.tables.items() for column in frame.columns]
    as_text = (_lost_as_text(table, logs.tables[table], column) for table, column in columns)
    found = [loss for loss in as_text if loss is not None]
    if form == CSV:
        trouble = "has a name that is not one line; rename it"
        found += [Loss(table, column, trouble, True) for table, column in columns if len(column.splitlines()) != 1]
    if form == MINARI and not logs.stages["elapsed_s"].notna().to_numpy().any():
        trouble = "no stage was completed, so Minari would have no step; record longer, or write Parquet"
        found.append(Loss("stages", None, trouble, is_refused=True))
    null = missing_in(logs.stages, logs.stage_covariates) if form == MINARI else {}
    remedy = "fill it in, and write that: read_logs(LOGS, missing='median+flag')"
    return found + [
        Loss("stages", name, f"is null in {share_of(num, logs.num_stages)}; {remedy}", is_refused=True)
        for name, num in null.items()
        if pd.api.types.is_numeric_dtype(logs.stages[name].dtype)
    ]


def refuse_lost(logs: Logs, form: str) -> None:
    """Refuse a log that cannot be written completely in a format; the message names every such part.

    Raises
    ------
    LogError
        Part of the log cannot be written.
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
        return Loss(table, column, f"is read back as pandas stores such values, not as {dtype}", is_refused=False)
    return None
