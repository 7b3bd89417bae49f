"""The cells of a sheet in an Excel workbook (.xlsx, .xlsm) as text: dates as ISO 8601, numbers as Python writes them.

A workbook is a zip archive of XML (ECMA-376): ``xl/workbook.xml`` names its sheets, ``xl/sharedStrings.xml`` holds
texts, and ``xl/styles.xml`` tells dates, which are days since 1900 or 1904, from numbers. Formulas have their last
value.
"""

import re
import zipfile
from collections.abc import Iterator, Mapping
from datetime import datetime, timedelta
from pathlib import Path, PurePosixPath
from typing import Any
from xml.etree import ElementTree

from halfseen.errors import ArgumentError, warn
from halfseen.logs.columns import shown
from halfseen.reading import TABLE, check_unpacked, opened

_TIMES = {*range(18, 22), 45, 47}
_DATES = {*range(14, 23), *range(27, 37), 45, 47, *range(50, 59)}
"""Numbers of built-in formats of times of day, and of these and dates; 46 is a duration."""
_NO_FORMAT = re.compile(r'"[^"]*"|\\.|_.|\*.|\[(?!h+\]|m+\]|s+\])[^\]]*\]', re.IGNORECASE)
"""Parts of a format that are text, padding, colours or conditions."""
_REFERENCE = re.compile(r"([A-Z]{1,3})\d+")
MOST_CELLS = 5 * 10**7
"""Most cells of a sheet, empty ones before others included."""
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
        There is no such sheet.
    """
    with opened(file, TABLE) as held, zipfile.ZipFile(held) as archive:
        check_unpacked(file.stat().st_size, sum(member.file_size for member in archive.infolist()))
        book = _parsed(archive, "xl/workbook.xml")
        targets = {_of(each, "Id"): _of(each, "Target") for each in _parsed(archive, "xl/_rels/workbook.xml.rels")}
        parts = {_of(each, "name"): targets[_of(each, "id")] for each in _all(book, "sheet")}
        name = next(iter(parts)) if sheet is None else sheet
        if name not in parts:
            raise ArgumentError(f"{file}, table.sheet: there is no sheet {name!r}; there are {_names(parts)}")
        if sheet is None and len(parts) > 1:
            warn(file, f"of its sheets {_names(parts)}, the first is read; set table.sheet for another")
        texts = [_text(each) for each in _all(_parsed(archive, "xl/sharedStrings.xml"), "si")]
        formats = _formats(_parsed(archive, "xl/styles.xml"))
        is_1904 = any(_of(each, "date1904") in ("1", "true") for each in _all(book, "workbookPr"))
        begin = datetime(1904, 1, 1) if is_1904 else datetime(1899, 12, 30)
        with archive.open(str(PurePosixPath("/xl", parts[name]))[1:]) as part:
            return dict(_rows(part, texts, formats, begin))


def _rows(part: Any, texts: list[str], formats: list[str], begin: datetime) -> Iterator[tuple[int, list[str]]]:
    number = num_cells = 0
    for _, element in ElementTree.iterparse(part):
        if not element.tag.endswith("}row"):
            continue
        number = int(_of(element, "r") or number + 1)
        cells: list[str] = []
        for cell in _all(element, "c"):
            column = _column(_of(cell, "r")) or len(cells) + 1
            cells += [""] * (column - len(cells))
            cells[column - 1] = _cell(cell, texts, formats, begin)
        num_cells += len(cells)
        if num_cells > MOST_CELLS:
            raise ValueError(f"a sheet of more than {MOST_CELLS:,} cells; export it as CSV")
        if any(cells):
            yield number, cells
        element.clear()


def _cell(cell: Any, texts: list[str], formats: list[str], begin: datetime) -> str:
    """The value of a cell as text."""
    kind, value = _of(cell, "t") or "n", next((each.text or "" for each in _all(cell, "v")), "")
    if kind == "inlineStr":
        return _text(cell).strip()
    if kind == "s":
        return texts[int(value)].strip() if value else ""
    if kind == "b":
        return {"1": "true", "0": "false"}.get(value, value)
    if kind != "n" or not value:
        return value.strip()
    style = int(_of(cell, "s") or 0)
    number = float(value)
    return _dated(number, formats[style], begin) if style < len(formats) and formats[style] else _number(number)


def _number(number: float) -> str:
    """A number as text: whole ones without a point, and with an exponent if Excel may have rounded them."""
    if abs(number) >= LONGEST_WHOLE:
        return f"{number:.15e}"
    return str(int(number)) if number == int(number) else repr(number)


def _dated(days: float, kind: str, begin: datetime) -> str:
    """A date, a date with a time, or a time of day, to the millisecond, as Excel keeps them."""
    at = begin + timedelta(milliseconds=round(days * 86_400_000))
    of_day = at.strftime("%H:%M:%S") + (f".{at.microsecond // 1000:03d}" if at.microsecond else "")
    if kind == "time" and 0 <= days < 1:
        return of_day
    return f"{at:%Y-%m-%d}" if kind == "date" and days == int(days) else f"{at:%Y-%m-%d}T{of_day}"


def _formats(styles: Any) -> list[str]:
    """What each style makes of a number: a "date", a "time" of day, or "" for a number."""
    own = {int(_of(each, "numFmtId")): _of(each, "formatCode") for each in _all(styles, "numFmt")}
    cells = next(_all(styles, "cellXfs"), ())
    return [_kind(number, own.get(number)) for number in (int(_of(each, "numFmtId") or 0) for each in cells)]


def _kind(number: int, code: str | None) -> str:
    if code is None:
        is_time = number in _TIMES
        return "" if number not in _DATES else "time" if is_time else "date"
    bare = _NO_FORMAT.sub("", code.split(";")[0]).lower()
    if "[" in bare or not re.search("[ymdhs]", bare) or re.search("[0#?]", re.sub(r"[.,]0+", "", bare)):
        return ""
    return "date" if re.search("[yd]", bare) else "time"


def _parsed(archive: zipfile.ZipFile, name: str) -> Any:
    """The root of a part; an empty one if the archive lacks it."""
    try:
        return ElementTree.fromstring(archive.read(name))
    except KeyError:
        return ElementTree.Element("empty")


def _all(element: Any, name: str) -> Iterator[Any]:
    """Elements below one, by their name without its namespace."""
    return (each for each in element.iter() if each.tag.rpartition("}")[2] == name)


def _of(element: Any, name: str) -> str:
    """An attribute, by its name without its namespace; empty without one."""
    return next((value for key, value in element.attrib.items() if key.rpartition("}")[2] == name), "")


def _text(element: Any) -> str:
    """The text of a string, without how it is pronounced."""
    spoken = {id(each) for run in _all(element, "rPh") for each in run.iter()}
    return "".join(each.text or "" for each in _all(element, "t") if id(each) not in spoken)


def _column(reference: str) -> int:
    """The number of a column, from 1; 0 without a reference."""
    match = _REFERENCE.fullmatch(reference)
    number = 0
    for letter in match[1] if match else "":
        number = 26 * number + ord(letter) - 64
    return number


def _names(parts: Mapping[str, str]) -> str:
    return ", ".join(map(shown, parts))
