"""Logs as a folder of CSV files, for spreadsheets and other programs.

::

    FOLDER/
      stages.csv     one row a stage
      trajectories.csv      one row a trajectory
      objects.csv    where the stages have objects
      columns.json   the type of each column and, if somebody said, the unit of rewards; may be missing, or name only
                     some of the columns

The files are UTF-8 with commas, and the first row names the columns. An empty cell is null; an empty text stands in
quotes. Lists are JSON (``[0.1, 0.2]``), times ISO 8601. Columns that ``columns.json`` does not name are read by these
rules, in this order:

1. ``stage`` holds whole numbers; ``elapsed_s``, ``reward``, ``probability`` and ``end_s`` hold numbers; ``ending``
   and ``cause`` hold text.
2. A column whose every cell is a whole number holds whole numbers; but names such as ``007`` are text.
3. Every cell a number: numbers. Every cell ``true`` or ``false``: booleans. Every cell a JSON list: lists. Names of
   trajectories, actions and objects are never any of these.
4. Else it holds text; but a column of covariates that begins with a number and goes on with text is refused, since
   that is more often a slip than a name. To keep it as text, say ``"string"`` in ``columns.json``.

What a column is stands in words that fit into JSON. What `losses` does not name comes back equal, to the last type and
bit, from CSV and from whatever else keeps cells as text.
"""

import csv
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import pandas as pd
import pyarrow as pa
import pyarrow.csv as arrow_csv

from halfseen.errors import ArgumentError, LogError, within
from halfseen.logs.columns import OWN_NAMES, converting, refuse_repeated, shown
from halfseen.logs.logs import Logs
from halfseen.logs.missing import Missing, missing_in, share_of
from halfseen.reading import MOST_LEVELS, TABLE, check_levels, json_of, opened_text, read_text, reason_of
from halfseen.writing import placed

ColumnType: TypeAlias = str | Mapping[str, Any]
"""Name of a type, such as ``"double"`` or ``"list<int64>"``; for categories ``{"categories": …, …}``."""

_NUMBERS = [pa.int8(), pa.int16(), pa.int32(), pa.int64(), pa.uint8(), pa.uint16(), pa.uint32(), pa.uint64()]
_PLAIN = {str(kind): kind for kind in [*_NUMBERS, pa.float32(), pa.float64(), pa.bool_(), pa.string(), pa.null()]}
_TIMES = {str(pa.date32()): pa.date32()}
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
    """Read a column of text whose every cell is a JSON list; None where it is none.

    Parameters
    ----------
    cells
        A column of Arrow; null stays null.
    """
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

    Parameters
    ----------
    logs
        What would be written.
    form
        "parquet", "csv" or "minari".

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
    return found + (_null_in_numbers(logs) if form == MINARI else [])


def _null_in_numbers(logs: Logs) -> list[Loss]:
    remedy = "fill it in, and write that: read_logs(LOGS, missing='median+flag')"
    return [
        Loss("stages", name, f"is null in {share_of(num, logs.num_stages)}; {remedy}", is_refused=True)
        for name, num in missing_in(logs.stages, logs.stage_covariates).items()
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


TYPES_FILE = "columns.json"
FORMAT, VERSION = "halfseen-csv", 2
UNIT = "reward_unit"

_KNOWN_TYPES = {"stage": "int64", "ending": "string", "cause": "string"}
_KNOWN_TYPES |= dict.fromkeys(("elapsed_s", "reward", "probability", "end_s"), "double")

_WRONG = (ValueError, TypeError, KeyError, AttributeError, pa.ArrowException)
_INTEGER = r"-?(0|[1-9][0-9]{0,17})"
_NUMBER = r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?"
_SHAPES = {"int64": _INTEGER, "double": _NUMBER, "bool": r"true|false"}


def write_csv(logs: Logs, folder: str | Path) -> None:
    """Write logs as CSV files, all or nothing; `read_csv` gives them back to the last bit.

    Parameters
    ----------
    logs
        What to write.
    folder
        Where to; nothing may be there yet.

    Raises
    ------
    ArgumentError
        Something is there already, or the folder cannot be written.
    LogError
        A column holds what has no form as text, such as records or bytes, or its name is not one line.
    """
    refuse_lost(logs, CSV)
    types = column_types(logs.tables)
    with placed(Path(folder)) as fresh:
        for name, frame in logs.tables.items():
            cells = {column: as_cells(frame[column], kind) for column, kind in types[name].items()}
            arrow_csv.write_csv(pa.table(cells), fresh / f"{name}.csv")
        manifest: dict[str, Any] = {"format": FORMAT, "version": VERSION, "tables": types}
        if logs.reward_unit is not None:
            manifest[UNIT] = logs.reward_unit
        (fresh / TYPES_FILE).write_text(json.dumps(manifest, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


def read_csv(folder: str | Path, *, missing: Missing = None) -> Logs:
    """Read a folder of CSV files that `write_csv`, a spreadsheet or a script wrote.

    Parameters
    ----------
    folder
        Holds ``stages.csv``, ``trajectories.csv`` and, where the stages have objects, ``objects.csv``.
    missing
        What stands for covariates of the stages that are null, as `Logs` takes it.

    Raises
    ------
    LogError
        A file is missing or broken, a cell is of another type than its column (the file, the row, counted from 1
        with the heading, and the column are named), or the tables break an invariant.
    """
    folder = Path(folder)
    if (folder / "paths.csv").exists():
        raise LogError(f"{folder / 'paths.csv'}: an older halfseen wrote it; {converting(folder)}")
    manifest = _read_manifest(folder / TYPES_FILE)
    types: dict[str, dict[str, ColumnType]] = manifest.get("tables", {})
    names = ["stages", "trajectories", "objects"] if (folder / "objects.csv").exists() else ["stages", "trajectories"]
    tables = {name: _read_table(folder / f"{name}.csv", types.get(name, {})) for name in names}
    with within(folder):
        return Logs(**tables, reward_unit=manifest.get(UNIT), missing=missing)


def _read_manifest(file: Path) -> dict[str, Any]:
    if not file.exists():
        return {}
    try:
        manifest = json_of(read_text(file))
    except (OSError, ValueError) as error:
        raise LogError(
            f"{file}: it cannot be read ({reason_of(error)}); mend it, or remove it and let types be guessed"
        ) from error
    if not isinstance(manifest, dict) or (manifest.get("format"), manifest.get("version")) != (FORMAT, VERSION):
        raise LogError(f"{file}: it is not of format {FORMAT!r}, version {VERSION}; remove it and let types be guessed")
    tables = manifest.get("tables")
    if not isinstance(tables, dict) or not all(isinstance(types, dict) for types in tables.values()):
        raise LogError(f"{file}: tables does not name the columns of each table; remove it and let types be guessed")
    for table, types in tables.items():
        for column, kind in types.items():
            _check_type(f"{file}: tables.{table}.{column}", kind)
    return manifest


def _check_type(place: str, kind: Any) -> None:
    try:
        if not isinstance(kind, str | dict):
            raise TypeError("it is neither text nor a table of categories")
        from_texts([], kind)
    except _WRONG as error:
        raise LogError(
            f"{place} is {shown(kind)}, which is no type ({error}); mend it, or leave the column out"
        ) from error


def _read_table(file: Path, types: dict[str, ColumnType]) -> pd.DataFrame:
    cells = _read_cells(file)
    columns = {name: _column(file, name, cells[name], types.get(name)) for name in cells.column_names}
    return pd.DataFrame(columns)


def _read_cells(file: Path) -> pa.Table:
    """Read every cell as text; only an empty cell without quotes is null."""
    try:
        with opened_text(file, TABLE) as lines:
            header = next(csv.reader(lines), [])
        if len(header) == 1 and ";" in header[0]:
            raise LogError(f"{file}: its cells are separated by ';'; export it with commas, and points in numbers")
        broken = [name for name in header if len(name.splitlines()) > 1]
        if broken:
            raise LogError(f"{file}: the column {broken[0]!r} has a name of two lines; give it one")
        refuse_repeated(file, header)
        return arrow_csv.read_csv(
            file,
            read_options=arrow_csv.ReadOptions(use_threads=False),  # with threads, errors do not tell the row
            parse_options=arrow_csv.ParseOptions(newlines_in_values=True),
            convert_options=arrow_csv.ConvertOptions(
                column_types=dict.fromkeys(header, pa.string()),
                null_values=[""],
                strings_can_be_null=True,
                quoted_strings_can_be_null=False,
            ),
        )
    except FileNotFoundError as error:
        raise LogError(f"{file}: it is missing; logs as CSV need stages.csv and trajectories.csv") from error
    except (OSError, UnicodeDecodeError, csv.Error, pa.ArrowException) as error:
        raise LogError(
            f"{file}: it is no CSV file of one table ({reason_of(error)}); mend or export it again"
        ) from error


def _column(file: Path, name: str, cells: Any, kind: ColumnType | None) -> Any:
    kind = kind or _KNOWN_TYPES.get(name) or _guessed_type(file, name, cells)
    try:
        return from_texts(cells, kind)
    except _WRONG as error:
        row = _first_wrong(cells, kind)
        raise LogError(
            f"{_place(file, name, row)}: {shown(cells[row].as_py())} is no {kind}; mend the cell, or leave it empty if "
            "there is no value"
        ) from error


def _first_wrong(cells: Any, kind: ColumnType) -> int:
    for row in range(len(cells)):
        try:
            from_texts(cells[row : row + 1], kind)
        except _WRONG:
            return row
    return 0


def _guessed_type(file: Path, name: str, cells: Any) -> ColumnType:
    there = cells.drop_null()
    if len(there) == 0:
        return "null"
    different = there.unique().to_pylist()
    for kind, shape in _SHAPES.items():
        if all(re.fullmatch(shape, cell) for cell in different) and (kind == "int64" or name not in OWN_NAMES):
            return kind
    if all(cell.startswith("[") for cell in different):
        return list_type(different) or "string"
    if name not in OWN_NAMES and re.fullmatch(_NUMBER, different[0]):
        wrong = next(cell for cell in different if not re.fullmatch(_NUMBER, cell))
        raise LogError(
            f"{_place(file, name, cells.to_pylist().index(wrong))}: {shown(wrong)} is no number, though the column "
            f"begins with one; mend the cell, leave it empty if there is no value, or say 'string' for the column in "
            f"{TYPES_FILE}"
        )
    return "string"


def _place(file: Path, name: str, row: int) -> str:
    return f"{file}, row {row + 2}, column {name!r}"
