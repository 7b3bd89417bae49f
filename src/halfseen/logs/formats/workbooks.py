"""The cells of a sheet in an Excel workbook (.xlsx, .xlsm) as text: dates as ISO 8601, numbers as Python writes them.

Formulas have their last value. Durations are days, or text if their format is that of times of day.
"""

import re
import warnings
import zipfile
from collections.abc import Iterator
from datetime import date, datetime, time, timedelta
from pathlib import Path
from typing import Any

from halfseen.errors import ArgumentError, warn
from halfseen.installation import extra
from halfseen.logs.columns import shown
from halfseen.reading import TABLE, check_unpacked, opened

MOST_CELLS = 5 * 10**7
"""Most cells of a sheet, empty ones before others included."""
LAST_YEAR_OF_DURATIONS = 1904
"""Dates until this year are durations of more than a day, in a format such as hh:mm:ss."""
_BYTES_AT_ONCE = 2**20
_UNCOMPUTED = re.compile(
    rb"""(?x)<(?:\w+:)?c (?=\s [^>]*? \br="([A-Z]+[0-9]+)") (?:(?!\st="str") [^>])* >
    <(?:\w+:)?f (?: [^>]*/> | [^>]*>[^<]*</(?:\w+:)?f> )
    (?: <(?:\w+:)?v\s?/> | <(?:\w+:)?v></(?:\w+:)?v> )? </(?:\w+:)?c>"""
)
"""A cell with a formula and without a value; an empty text is a value. Names of XML may have a prefix."""
_END_OF_CELL = re.compile(rb"</(?:\w+:)?c>")
LONGEST_WHOLE = 10**15
"""Excel rounds numbers of more digits, so that they are no names."""


def rows_of_sheet(file: Path, sheet: str | None) -> dict[int, list[str]]:
    """Read the rows of a sheet that have a cell, by their number from 1.

    Parameters
    ----------
    sheet
        Its name; None for the first, with a warning if there are several.

    Raises
    ------
    ArgumentError
        There is no such sheet, or openpyxl is not installed.
    """
    openpyxl: Any = extra("openpyxl", "excel")
    with opened(file, TABLE) as held, warnings.catch_warnings():
        # It warns of styles, filters and extensions, which are not read.
        warnings.filterwarnings("ignore", module="openpyxl")
        with zipfile.ZipFile(held) as archive:
            check_unpacked(file.stat().st_size, sum(member.file_size for member in archive.infolist()))
            _warn_of_uncomputed(file, archive)
        held.seek(0)
        book = openpyxl.load_workbook(held, read_only=True, data_only=True)
        names = ", ".join(shown(each.title) for each in book.worksheets)
        found = next((each for each in book.worksheets if sheet in (None, each.title)), None)
        if found is None:
            raise ArgumentError(f"{file}, table.sheet: there is no sheet {sheet!r}; there are {names or 'none'}")
        if sheet is None and len(book.worksheets) > 1:
            warn(file, f"of its sheets {names}, the first is read; set table.sheet for another")
        # The size that a file states may be wrong.
        found.reset_dimensions()
        return dict(_rows(found, book.epoch))


def _warn_of_uncomputed(file: Path, archive: zipfile.ZipFile) -> None:
    """Warn about formulas without a value, as programs write them that do not compute."""
    found: list[bytes] = []
    for name in (each for each in archive.namelist() if each.startswith("xl/worksheets/sheet")):
        with archive.open(name) as part:
            rest = b""
            while content := part.read(_BYTES_AT_ONCE):
                content = rest + content
                end = max((cell.end() for cell in _END_OF_CELL.finditer(content)), default=0)
                found += _UNCOMPUTED.findall(content, 0, end)
                rest = content[end:]
    if found:
        trouble = f"formulas without a value count as empty, that of {found[0].decode()} first of {len(found):,}"
        warn(file, f"{trouble}; open the file in a spreadsheet program and save it")


def _rows(sheet: Any, epoch: datetime) -> Iterator[tuple[int, list[str]]]:
    num_cells = 0
    for number, row in enumerate(sheet.iter_rows(values_only=True), start=1):
        num_cells += len(row)
        if num_cells > MOST_CELLS:
            raise ValueError(f"a sheet of more than {MOST_CELLS:,} cells; export it as CSV")
        cells = [_text(value, epoch) for value in row]
        if any(cells):
            yield number, cells


def _text(value: Any, epoch: datetime) -> str:
    """The value of a cell as text; the number 0 is the date `epoch`."""
    match value:
        case None:
            return ""
        case bool():
            return str(value).lower()
        case int() | float():
            return _number(float(value))
        case timedelta():
            return _number(value / timedelta(days=1))
        case datetime() if value.year <= LAST_YEAR_OF_DURATIONS:
            days = int(extra("openpyxl.utils.datetime", "excel").to_excel(value, epoch))
            return f"{days} days {_text(value.time(), epoch)}"
        case datetime() if value.time() == time():
            return value.date().isoformat()
        case datetime() | time():
            return value.isoformat(timespec="milliseconds" if value.microsecond else "seconds")
        case date():
            return value.isoformat()
        case _:
            return str(value).strip()


def _number(number: float) -> str:
    """A number as text: whole ones without a point, and with an exponent if Excel may have rounded them."""
    if abs(number) >= LONGEST_WHOLE:
        return f"{number:.15e}"
    return str(int(number)) if number == int(number) else repr(number)
