"""Cells of any table as text, with the line of each row.

In order: bytes → text (encoding) → cells (separator, JSON lines), or a sheet or typed columns → the same cells.
`halfseen.logs.formats.table_values` interprets the text.
"""

import csv
import gzip
import io
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from statistics import multimode
from typing import Any, BinaryIO, NoReturn

import msgspec
import numpy as np
import pyarrow as pa

from halfseen.errors import ArgumentError, LogError, did_you_mean, warn
from halfseen.logs.columns import refuse_repeated, shown
from halfseen.logs.folder import JSON_LINES, TEXT_FILES, WORKBOOKS
from halfseen.logs.formats.nested_steps import LAST, has_steps
from halfseen.logs.formats.partitions import partition_of
from halfseen.logs.formats.quotes import check_quotes
from halfseen.logs.formats.step_tables import whole_table
from halfseen.logs.formats.table_mapping import TextLayout
from halfseen.logs.formats.workbooks import rows_of_sheet
from halfseen.logs.parquet import parquet_file
from halfseen.reading import TABLE, check_file, check_unpacked, json_of, opened, reason_of, refused

TYPED_FILES, OTHER_SHEETS = (".parquet",), (".xls", ".xlsb", ".ods")
PACKED = ".gz"
SEPARATORS = (";", ",", "\t", "|")
ROW = "row"
"""Name of a first column that has none."""
ROWS_LOOKED_AT = 50
_BYTES_AT_ONCE = 2**24
_LATIN_IN_UTF_8 = re.compile(rb"\xc3[\x80-\xbf]")
"""A letter with an accent in UTF-8, which in Windows-1252 is Ã and a sign."""


@dataclass(frozen=True)
class Cells:
    """A table of text; an empty cell is an empty string."""

    file: str
    columns: dict[str, list[str]]
    rows: Sequence[int | str]
    """Number of each row in its file, from 1; with several files, preceded by the name of the file."""
    layout: TextLayout
    word: str = "line"
    """Word for a row in messages: line, row if the file has no lines, or file if there are several."""
    unread: Mapping[str, str] = field(default_factory=dict)
    """Types of the columns that have no text form."""
    rounded: frozenset[str] = frozenset()
    """Columns of fractions so large that neighbouring whole numbers became one."""

    def place(self, row: int, column: str | None = None) -> str:
        """Name a row or a cell."""
        return f"{self.file}, {self.word} {self.rows[row]}" + ("" if column is None else f", column {column!r}")

    def refuse(self, row: int, column: str, trouble: str) -> NoReturn:
        """Raise a `LogError` for a cell, with its place and value."""
        raise LogError(f"{self.place(row, column)}: {shown(self.columns[column][row])} {trouble}")


def kind_of_table(file: Path) -> str:
    """The ending of a file's name, before that of packed text."""
    name = file.name.lower()
    unpacked = Path(name.removesuffix(PACKED)).suffix
    return unpacked if unpacked in (*TEXT_FILES, *JSON_LINES) else Path(name).suffix


def is_event_table(file: Path, is_mapped: bool) -> bool:
    """Whether to read a file by a mapping: it is a table, and a mapping is given or it is not a step table."""
    kind = kind_of_table(file)
    if is_mapped or kind not in (".csv", *TYPED_FILES) or file.suffix.lower() == PACKED:
        return kind in (*TEXT_FILES, *JSON_LINES, *TYPED_FILES, *WORKBOOKS, *OTHER_SHEETS)
    try:
        if kind in TYPED_FILES:
            return not has_steps(parquet_file(file).schema_arrow)
        with opened(file, TABLE) as held:
            # Without null bytes UTF-16 looks like ASCII.
            return LAST.encode() not in held.readline(ROWS_LOOKED_AT * 1000).replace(b"\0", b"")
    except (OSError, pa.ArrowException):
        return False


def read_cells(file: Path, layout: TextLayout) -> Cells:
    """Read a text or Parquet file, and the columns after which its folders are named; it may have no rows.

    Raises
    ------
    ArgumentError
        It is another kind of file.
    LogError
        It is missing or broken, a row and the heading differ in their number of cells, or the layout is not found.
    """
    cells = _read(file, layout)
    there = {name: [text] * len(cells.rows) for name, text in partition_of(file).items() if name not in cells.columns}
    return replace(cells, columns=cells.columns | there)


def _read(file: Path, layout: TextLayout) -> Cells:
    refuse_workbook(file)
    kind = kind_of_table(file)
    if kind in TYPED_FILES:
        with whole_table(file):
            table = parquet_file(file).read()
        return cells_of(str(file), table)
    if kind in WORKBOOKS:
        with whole_table(file):
            cells = rows_of_sheet(file, layout.sheet)
        there = {number: row for number, row in cells.items() if number >= layout.heading}
        return _headed(file, list(there.values()), list(there), msgspec.structs.replace(layout, decimal="."), "row")
    if kind not in (*TEXT_FILES, *JSON_LINES):
        kinds = ", ".join((*TEXT_FILES, *JSON_LINES, *TYPED_FILES, *WORKBOOKS))
        raise ArgumentError(f"{file}: a mapping of columns reads {kinds}; export one")
    text, encoding = _text(file, layout.encoding)
    if kind in JSON_LINES:
        return _of_json(file, text)
    return _split(file, text, msgspec.structs.replace(layout, encoding=encoding))


def _text(file: Path, encoding: str | None) -> tuple[str, str]:
    """The text of a file, unpacked if need be, and its encoding."""
    with whole_table(file), opened(file, TABLE) as held:
        content = _unpacked(held, check_file(file, TABLE)) if file.suffix.lower() == PACKED else held.read()
    return _decoded(file, content, encoding)


def _unpacked(held: BinaryIO, num_bytes: int) -> bytes:
    content = bytearray()
    with gzip.GzipFile(fileobj=held) as packed:
        while part := packed.read(_BYTES_AT_ONCE):
            content += part
            check_unpacked(num_bytes, len(content))
    return bytes(content)


def _of_json(file: Path, text: str) -> Cells:
    """Read one JSON object a line; a name that an object lacks is an empty cell, and lists and objects are not read."""
    rows: dict[int, dict[str, Any]] = {}
    for number, line in enumerate(text.split("\n"), start=1):
        if not line.strip():
            continue
        with refused(f"{file}, line {number}", "it is not JSON", "write one JSON object a line"):
            row = json_of(line)
        if not isinstance(row, dict):
            raise LogError(f"{file}, line {number}: it is not a JSON object; write one a line")
        rows[number] = row
    names = list(dict.fromkeys(name for row in rows.values() for name in row))
    unread = {name: "lists or objects" for row in rows.values() for name in row if isinstance(row[name], list | dict)}
    read = [name for name in names if name not in unread]
    columns = {name: [_text_of(row.get(name)) for row in rows.values()] for name in read}
    return _checked(Cells(str(file), columns, list(rows), TextLayout(decimal="."), unread=unread), names)


def _text_of(value: Any) -> str:
    """A JSON value as a cell."""
    return "" if value is None else value.strip() if isinstance(value, str) else json.dumps(value)


def refuse_workbook(file: Path) -> None:
    """Refuse spreadsheet files other than those of `WORKBOOKS` (`ArgumentError`)."""
    if file.suffix.lower() in OTHER_SHEETS:
        raise ArgumentError(f"{file}: such workbooks are not read; save it as .xlsx, or the sheet as CSV UTF-8")


def cells_of(place: str, table: pa.Table) -> Cells:
    """Convert the columns of an Arrow table to text: times as ISO 8601, null as an empty string.

    Columns without a text form are passed over; durations are, too, since their text does not tell their unit.

    Raises
    ------
    LogError
        A name is empty or repeated.
    """
    columns, unread, rounded = {}, {}, set()
    for name, column in zip(table.column_names, table.columns, strict=True):
        try:
            columns[name] = _texts_of(column)
        except (pa.ArrowException, ValueError, NotImplementedError):
            unread[name] = str(column.type)
            continue
        if _warn_of_rounded(f"{place}, column {name!r}", column):
            rounded.add(name)
    rows, layout = range(1, table.num_rows + 1), TextLayout(decimal=".")
    return _checked(Cells(place, columns, rows, layout, "row", unread, frozenset(rounded)), table.column_names)


def _texts_of(column: Any) -> list[str]:
    values = column.combine_chunks()
    values = values.dictionary_decode() if pa.types.is_dictionary(column.type) else values
    if pa.types.is_duration(values.type):
        raise NotImplementedError("a duration as text would lose its unit")
    return [(cell or "").strip() for cell in values.cast(pa.string()).to_pylist()]


def _warn_of_rounded(where: str, column: Any) -> bool:
    """Warn about fractions so large that their type rounds them to every other whole number, or coarser."""
    if not (pa.types.is_float32(column.type) or pa.types.is_float64(column.type)):
        return False
    sizes = np.abs(column.to_numpy())
    most = np.max(sizes, initial=0.0, where=np.isfinite(sizes))
    if np.spacing(most) <= 1:
        return False
    trouble = f"it holds {sizes.dtype}, which rounds {most:.9g} to multiples of {np.spacing(most):g}"
    warn(where, f"{trouble}; export it in a wider type, or as whole numbers or text")
    return True


def _decoded(file: Path, content: bytes, encoding: str | None) -> tuple[str, str]:
    """Decode text; without a given encoding, by its byte order mark, else as UTF-8, else as Windows-1252."""
    if content.startswith((b"\x1f\x8b", b"\x28\xb5\x2f\xfd")):
        raise LogError(f"{file}: it is compressed, which its name does not say; unpack it, or add .gz if gzip did that")
    is_wide = content[:2] in (b"\xff\xfe", b"\xfe\xff")
    found = ["utf-16"] if is_wide else ["utf-8-sig"] if content[:3] == b"\xef\xbb\xbf" else ["utf-8", "cp1252"]
    names = found if encoding is None else ["utf-8-sig" if encoding == "utf-8" else encoding]
    for name in names:
        try:
            return content.decode(name), name
        except UnicodeDecodeError as error:
            trouble = f"line {content[: error.start].count(10) + 1}: bytes {content[error.start : error.end]!r}"
            if name == "utf-8" and encoding is None and _LATIN_IN_UTF_8.search(content):
                remedy = "fix them, or set table.encoding"
                raise LogError(f"{file}, {trouble} are not UTF-8, though other bytes are; {remedy}") from error
    raise LogError(f"{file}, {trouble} are not {encoding or names[-1]}; set table.encoding, or export it as UTF-8")


def _split(file: Path, text: str, layout: TextLayout) -> Cells:
    """Split text into cells."""
    if (at := text.find("\0")) >= 0:
        row, remedy = text.count("\n", 0, at) + 1, "else set table.encoding, such as 'utf-16', or export it as UTF-8"
        raise LogError(f"{file}, line {row}: it holds null characters; delete them if power was lost there; {remedy}")
    lines = io.StringIO(text, newline="")
    for _ in range(layout.heading - 1):
        lines.readline()
    start, number = lines.tell(), layout.heading - 1
    if named := re.fullmatch(r"sep=(.)\s*", lines.readline(), re.IGNORECASE):  # as spreadsheets write it
        start, number = lines.tell(), number + 1
    separator = layout.separator or (named[1] if named else _separator(file, text[start:]))
    lines.seek(start)
    check_quotes(file, lines, separator, first=number + 1, is_spaced=True)
    lines.seek(start)
    reader = csv.reader(lines, delimiter=separator, skipinitialspace=True)
    kept: list[list[str]] = []
    rows: list[int] = []
    at = number + 1
    try:
        for cells in reader:
            if any(map(str.strip, cells)):
                kept.append([cell.strip() for cell in cells])
                rows.append(at)
            at = number + reader.line_num + 1
    except csv.Error as error:
        raise LogError(f"{file}, line {at}: it is not CSV ({reason_of(error)}); fix the line") from error
    return _headed(file, kept, rows, msgspec.structs.replace(layout, separator=separator))


def _headed(
    file: Path, kept: Sequence[list[str]], rows: Sequence[int], layout: TextLayout, word: str = "line"
) -> Cells:
    """Make a table of rows, of which the first has the names of the columns."""
    names = _trimmed(kept[0], 1) if kept else []
    if len(names) > 1 and not names[0] and ROW not in names:  # the index of pandas or R
        names[0] = ROW
    for row, cells in zip(rows[1:], kept[1:], strict=True):
        if len(_trimmed(cells, len(names))) > len(names) or (word == "line" and len(cells) < len(names)):
            between = f" between {layout.separator!r}" if layout.separator else ""
            raise LogError(
                f"{file}, {word} {row}: it has {len(cells)} cells{between}, and the heading has {len(names)}; fix or "
                "delete it, or set table.separator, table.sheet or table.heading"
            )
    columns = {name: [cells[k] if k < len(cells) else "" for cells in kept[1:]] for k, name in enumerate(names)}
    return _checked(Cells(str(file), columns, rows[1:], layout, word), names)


def _trimmed(cells: list[str], least: int) -> list[str]:
    """Drop trailing empty cells, but keep at least `least` cells."""
    last = max((k for k, cell in enumerate(cells) if cell), default=-1)
    return cells[: max(last + 1, least)]


def _checked(cells: Cells, names: list[str]) -> Cells:
    refuse_repeated(cells.file, names)
    if "" in names:
        raise LogError(f"{cells.file}: column {names.index('') + 1} has no name; give it one, or set table.heading")
    first = next(iter(cells.columns), "")
    for row, text in enumerate(cells.columns.get(first, [])):
        if text == first and all(texts[row] == name for name, texts in cells.columns.items()):
            raise LogError(
                f"{cells.place(row)}: the heading stands here, too, as where another table was put below; delete it"
            )
    return cells


def refuse_empty(cells: Cells) -> Cells:
    """Refuse a table without rows (`LogError`)."""
    if not len(cells.rows):
        raise LogError(f"{cells.file}: there are no rows below the heading; give a table with at least one")
    return cells


def _separator(file: Path, text: str) -> str:
    """Find the separator: prefer one that gives all first rows equally many cells, then the one that gives most."""
    sample = "".join(islice(io.StringIO(text, newline=""), ROWS_LOOKED_AT))
    found: dict[str, tuple[bool, int]] = {}
    for separator in SEPARATORS:
        try:
            sizes = [len(row) for row in csv.reader(io.StringIO(sample, newline=""), delimiter=separator) if any(row)]
        except csv.Error:
            continue
        found |= {separator: (len(set(sizes)) == 1, sizes[0])} if sizes and sizes[0] > 1 else {}
    if not found:
        raise LogError(f"{file}: its heading has none of the separators {SEPARATORS}; set table.separator or heading")
    return max(found, key=lambda separator: found[separator])


def heading_of(file: Path) -> int:
    """Line of the probable heading: the first with as many cells as most of the first lines, or one fewer."""
    if kind_of_table(file) in WORKBOOKS:
        with whole_table(file):
            ways = [{number: len(row) for number, row in islice(rows_of_sheet(file, None).items(), ROWS_LOOKED_AT)}]
    else:
        texts = _text(file, None)[0].splitlines()[:ROWS_LOOKED_AT]
        lines = [(number, line) for number, line in enumerate(texts, start=1) if not line.startswith("#")]
        ways = [{number: line.count(separator) for number, line in lines} for separator in SEPARATORS]
    found: dict[int, int] = {}
    for sizes in ways:
        usual = max(multimode(sizes.values()), default=0)
        if usual:
            found[usual] = next(number for number, size in sizes.items() if size >= max(1, usual - 1))
    return found[max(found)] if found else 1


def check_column(cells: Cells, name: str, asked_by: str) -> None:
    """Refuse the name of a missing column (`ArgumentError`); `asked_by` is the place in the mapping that names it."""
    if name in cells.unread:
        kind = cells.unread[name]
        raise ArgumentError(f"{asked_by}: column {name!r} of {cells.file} holds {kind}; convert it to numbers or text")
    if name not in cells.columns:
        there = ", ".join(map(repr, list(cells.columns)[:20]))
        ending = did_you_mean(name, cells.columns) or "; name one of them"
        raise ArgumentError(f"{asked_by}: there is no column {name!r} in {cells.file}; there are {there}{ending}")
