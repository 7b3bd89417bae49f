"""Logs as a folder of CSV files, for spreadsheets and other programs.

::

    FOLDER/
      stages.csv         one row per stage
      trajectories.csv   one row per trajectory
      objects.csv        if the stages have objects
      columns.json       the type of each column and, if known, the unit of rewards; may be missing, or name only some
                         of the columns

The files are UTF-8 with commas, and the first row names the columns. An empty cell is null; an empty string is quoted.
Lists are JSON (``[0.1, 0.2]``), times ISO 8601. The types of columns that ``columns.json`` does not name follow from
these rules, in this order:

1. ``stage`` holds whole numbers; ``elapsed_s``, ``reward``, ``probability`` and ``end_s`` hold numbers; ``ending``
   and ``cause`` hold text.
2. If every cell is a whole number, the column holds whole numbers; but names such as ``007`` are text.
3. Every cell a number: numbers. Every cell ``true`` or ``false``: booleans. Every cell a JSON list: lists. Names of
   trajectories, actions and objects are never any of these.
4. Otherwise it holds text; but a covariate with text among numbers, which come first or are most of its cells, is
   refused, since that is more often a slip than a name. To keep it as text, give ``"string"`` in ``columns.json``.
"""

import csv
import json
import re
from pathlib import Path
from typing import Any, Literal

import msgspec
import pandas as pd
import pyarrow as pa
import pyarrow.csv as arrow_csv

from halfseen.errors import LogError, warn, within
from halfseen.logs.columns import NUMBERS, OWN_NAMES, converting, refuse_repeated, shown
from halfseen.logs.formats.as_text import CSV, ColumnType, as_cells, column_types, from_texts, list_type, refuse_lost
from halfseen.logs.formats.quotes import check_quotes
from halfseen.logs.logs import Logs
from halfseen.logs.missing import Missing
from halfseen.reading import TABLE, json_of, opened_text, read_text, refused
from halfseen.writing import placed

TYPES_FILE = "columns.json"
FORMAT, VERSION = "halfseen-csv", 2

_KNOWN_TYPES = {"stage": "int64", "ending": "string", "cause": "string"} | dict.fromkeys(NUMBERS, "double")

_WRONG = (ValueError, TypeError, KeyError, AttributeError, pa.ArrowException)
_INTEGER = r"-?(0|[1-9][0-9]{0,17})"
_NUMBER = r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?"
_SHAPES = {"int64": _INTEGER, "double": _NUMBER, "bool": r"true|false"}


def write_csv(logs: Logs, folder: str | Path) -> None:
    """Write logs as CSV files, all or nothing; `read_csv` restores them to the last bit.

    Raises
    ------
    ArgumentError
        The path exists already, or cannot be written.
    LogError
        A column holds values without a text form, such as records or bytes, or its name is not one line.
    """
    refuse_lost(logs, CSV)
    types = column_types(logs.tables)
    with placed(Path(folder)) as fresh:
        for name, frame in logs.tables.items():
            cells = {column: as_cells(frame[column], kind) for column, kind in types[name].items()}
            arrow_csv.write_csv(pa.table(cells), fresh / f"{name}.csv")
        manifest: dict[str, Any] = {"format": FORMAT, "version": VERSION, "tables": types}
        manifest |= {} if logs.reward_unit is None else {"reward_unit": logs.reward_unit}
        (fresh / TYPES_FILE).write_text(json.dumps(manifest, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


def read_csv(folder: str | Path, *, missing: Missing = None) -> Logs:
    """Read a folder of CSV files that `write_csv`, a spreadsheet or a script wrote.

    Parameters
    ----------
    folder
        Holds ``stages.csv``, ``trajectories.csv`` and, if the stages have objects, ``objects.csv``.
    missing
        How to fill in null covariates of the stages, as in `Logs`.

    Raises
    ------
    LogError
        A file is missing or broken, a cell has another type than its column (the message names the file, the row,
        counted from 1 with the heading, and the column), or the tables break an invariant.
    """
    folder = Path(folder)
    if (folder / "paths.csv").exists():
        raise LogError(f"{folder / 'paths.csv'}: an older halfseen wrote it; {converting(folder)}")
    manifest = _read_manifest(folder / TYPES_FILE)
    names = ["stages", "trajectories", "objects"] if (folder / "objects.csv").exists() else ["stages", "trajectories"]
    tables = {name: _read_table(folder / f"{name}.csv", manifest.tables.get(name, {})) for name in names}
    with within(folder):
        return Logs(**tables, reward_unit=manifest.reward_unit, missing=missing)


class Manifest(msgspec.Struct):
    """Content of ``columns.json``."""

    format: Literal["halfseen-csv"]
    version: Literal[2]
    tables: dict[str, dict[str, Any]]
    reward_unit: Any = None


def _read_manifest(file: Path) -> Manifest:
    if not file.exists():
        return Manifest(FORMAT, VERSION, {})
    trouble = f"it is not of format {FORMAT!r}, version {VERSION}"
    with refused(file, trouble, "fix it, or remove it to have types guessed"):
        manifest = msgspec.convert(json_of(read_text(file)), Manifest)
    for table, types in manifest.tables.items():
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
            f"{place} is {shown(kind)}, which is not a type ({error}); fix it, or leave the column out"
        ) from error


def _read_table(file: Path, types: dict[str, ColumnType]) -> pd.DataFrame:
    cells = _read_cells(file)
    columns = {name: _column(file, name, cells[name], types.get(name)) for name in cells.column_names}
    return pd.DataFrame(columns)


def _read_cells(file: Path) -> pa.Table:
    """Read every cell as text; only an empty cell without quotes is null."""
    remedy, missing = "fix it, or export it again", "it is missing; logs as CSV need stages.csv and trajectories.csv"
    with refused(file, "it is not a CSV file of one table", remedy, missing):
        with opened_text(file, TABLE) as lines:
            header = next(csv.reader(lines), [])
            lines.seek(0)
            check_quotes(file, lines, on_rows=warn)
        refuse_semicolons(file, header)
        broken = [name for name in header if len(name.splitlines()) > 1]
        if broken:
            raise LogError(f"{file}: the column {broken[0]!r} has a name of two lines; put it on one line")
        if "" in map(str.strip, header):
            trouble = f"column {[*map(str.strip, header)].index('') + 1} has no name"
            raise LogError(f"{file}: {trouble}; name it, or leave it out if it only numbers the rows")
        refuse_repeated(file, header)
        convert = arrow_csv.ConvertOptions(
            column_types=dict.fromkeys(header, pa.string()),
            null_values=[""],
            strings_can_be_null=True,
            quoted_strings_can_be_null=False,
        )
        return read_cells(file, convert)


def read_cells(source: Any, convert: arrow_csv.ConvertOptions) -> pa.Table:
    """Read a CSV table; only an empty cell without quotes is null."""
    # With threads, errors do not name the row.
    lines = arrow_csv.ParseOptions(newlines_in_values=True)
    return arrow_csv.read_csv(source, arrow_csv.ReadOptions(use_threads=False), lines, convert)


def refuse_semicolons(file: Path, header: list[str]) -> None:
    """Refuse a heading whose cells are separated by semicolons (`LogError`)."""
    if len(header) == 1 and ";" in header[0]:
        raise LogError(
            f"{file}: its cells are separated by ';'; export it with commas between cells and points in numbers"
        )


def _column(file: Path, name: str, cells: Any, kind: ColumnType | None) -> Any:
    kind = kind or _KNOWN_TYPES.get(name) or _guessed_type(file, name, cells)
    try:
        return from_texts(cells, kind)
    except _WRONG as error:
        row = _first_wrong(cells, kind)
        raise LogError(
            f"{_place(file, name, row)}: {shown(cells[row].as_py())} is not of type {kind}; fix the cell, or leave "
            "it empty if there is no value"
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
    if name not in OWN_NAMES:
        refuse_text_among_numbers(file, name, cells, f", or set the column to 'string' in {TYPES_FILE}")
    return "string"


def refuse_text_among_numbers(file: Path, name: str, cells: Any, remedy: str = "") -> None:
    """Refuse a column of text that begins with a number, or of which most cells are numbers (`LogError`)."""
    there = cells.drop_null().to_pylist()
    numbers = {cell for cell in set(there) if re.fullmatch(_NUMBER, cell)}
    is_most = 2 * sum(cell in numbers for cell in there) > len(there)
    wrong = next((cell for cell in there if cell not in numbers), None)
    if wrong is not None and (is_most or there[0] in numbers):
        raise LogError(
            f"{_place(file, name, cells.to_pylist().index(wrong))}: {shown(wrong)} is not a number, though "
            f"{'most cells of the column are' if is_most else 'the column begins with one'}; fix the cell, leave it "
            f"empty if there is no value{remedy}"
        )


def _place(file: Path, name: str, row: int) -> str:
    return f"{file}, row {row + 2}, column {name!r}"
