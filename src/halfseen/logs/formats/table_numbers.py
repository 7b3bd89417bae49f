"""What the cells of a table mean as numbers; what can be read in two ways is refused."""

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from halfseen.logs.formats.table_cells import Cells

WHOLE = re.compile(r"-?(0|[1-9][0-9]{0,17})")
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d{1,3})?")
_FRACTION = {mark: re.compile(rf"[-+]?\d*{re.escape(mark)}\d+([eE][-+]?\d+)?") for mark in ".,"}
_IN_THOUSANDS = {mark: re.compile(rf"[-+]?[1-9]\d{{0,2}}({re.escape(mark)}\d{{3}})+") for mark in ".,"}
_GROUPED = re.compile(r"[-+]?\d{1,3}[.,'\u2019 \u00a0\u202f]\d{3}(?!\d)")
_WITH_UNIT = re.compile(r"([-+\d][\d.,'\u2019 ]*\d|\d) ?([^\W\d]{1,4}|%|°[CF]?)")
_OTHER = {".": ",", ",": "."}
_BETWEEN = {".": r"\.", ",": ",", "'": "['\u2019]", " ": "[ \u00a0\u202f]"}
"""How each mark of thousands may be written."""


class Marks(NamedTuple):
    """Marks of numbers: of a fraction, and between groups of three digits, if there is one."""

    decimal: str = "."
    thousands: str = ""


def marks_of(cells: Cells, names: Sequence[str]) -> Marks:
    """Find the decimal mark of some columns, where nobody says it.

    Raises
    ------
    LogError
        They may be read in two ways.
    """
    decimal, thousands = cells.layout.decimal, cells.layout.thousands or ""
    if decimal is not None or thousands in _OTHER or (cells.layout.separator == "," and not _has_comma(cells, names)):
        return Marks(decimal or _OTHER.get(thousands, "."), thousands)
    found: dict[str, tuple[int, str]] = {}
    num_in_thousands = dict.fromkeys(".,", 0)
    for name in names:
        for row, written in enumerate(cells.columns[name]):
            cell = re.sub(_BETWEEN[thousands], "", written) if thousands else written
            for mark in ".,":
                if _FRACTION[mark].fullmatch(cell):
                    found.setdefault(mark, (row, name))
                    num_in_thousands[mark] += _IN_THOUSANDS[mark].fullmatch(cell) is None
    remedy = 'say table.decimal = "," or "." in the mapping'
    if len(found) == 2:
        row, name = found["."]
        other = cells.place(*found[","])
        cells.refuse(row, name, f"has a point, yet there is a comma in {other}; write numbers alike, or {remedy}")
    for mark, (row, name) in found.items():
        if num_in_thousands[mark] == 0:
            cells.refuse(row, name, f"may be a fraction or a number in thousands, like all others; {remedy}")
    return Marks(next(iter(found), "."), thousands)


def _has_comma(cells: Cells, names: Sequence[str]) -> bool:
    """Whether a cell is a fraction by a comma, and no number in thousands."""
    there = (cell for name in names for cell in cells.columns[name] if "," in cell)
    return any(_FRACTION[","].fullmatch(cell) and not _IN_THOUSANDS[","].fullmatch(cell) for cell in there)


def grouped_by(cell: str) -> str | None:
    """The mark between the thousands of a number, such as 1.234,5 or 1 234; None of others."""
    ways = (Marks(decimal, mark) for mark in _BETWEEN for decimal in ",." if decimal != mark)
    fits = (way for way in ways if plain_number(cell, Marks(way.decimal)) is None)
    return next((way.thousands for way in fits if plain_number(cell, way) is not None), None)


def thousands_mark(cells: Cells) -> str | None:
    """The mark of thousands of the first number that can be read in one way only: 1.234,5, and not 1.234."""
    texts = dict.fromkeys(text for column in cells.columns.values() for text in column if _GROUPED.match(text))
    sure = (text for text in texts if not any(plain_number(text, Marks(mark)) for mark in ",."))
    return next((mark for text in sure if (mark := grouped_by(text)) is not None), None)


def is_numeric(cell: str) -> bool:
    """Whether text is a number of any marks."""
    return grouped_by(cell) is not None or any(plain_number(cell, Marks(mark)) is not None for mark in ",.")


def plain_number(cell: str, marks: Marks) -> str | None:
    """A number as Python writes it; None if it is none of these marks."""
    whole, mark, rest = cell.partition(marks.decimal)
    if marks.thousands:
        between = _BETWEEN[marks.thousands]
        if re.fullmatch(rf"[-+]?[1-9]\d{{0,2}}({between}\d{{3}})+", whole):
            whole = re.sub(between, "", whole)
    text = f"{whole}.{rest}" if mark else whole
    is_number = "." not in whole + rest and _NUMBER.fullmatch(text) is not None
    return text if is_number else None


def number_at(cells: Cells, row: int, column: str, marks: Marks) -> float:
    """Read a cell as a number.

    Raises
    ------
    LogError
        It is no finite number.
    """
    cell = cells.columns[column][row]
    value = float(plain_number(cell, marks) or "nan")
    if not np.isfinite(value):
        mark = grouped_by(cell)
        remedy = f'or say table.thousands = "{mark}" in the mapping' if mark else "or say values, type or table.decimal"
        cells.refuse(row, column, f"is no number of decimal mark {marks.decimal!r}; mend it, {remedy}")
    return value


def refuse_most_numbers(cells: Cells, rows: Sequence[int], column: str) -> None:
    """Refuse cells that are to be text where most of them are numbers, or numbers with the same unit (`LogError`)."""
    there = [row for row in rows if cells.columns[column][row]]
    others = [row for row in there if not is_numeric(cells.columns[column][row])]
    if others and 2 * len(others) < len(there):
        cells.refuse(others[0], column, "is no number, and most of the column are; mend it, or say values or type")
    found = [_WITH_UNIT.fullmatch(cells.columns[column][row]) for row in there]
    units = {match and is_numeric(match[1]) and match[2] for match in found}
    if len(units) == 1 and units.pop() and len({match and match[1] for match in found}) > 1:
        cells.refuse(there[0], column, 'is a number with a unit; export it without, or say type = "text"')
