"""Parsing the cells of a table as numbers and times; ambiguous cells are refused."""

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from decimal import Decimal
from typing import Any, NamedTuple, TypeAlias
from zoneinfo import ZoneInfo

import numpy as np
import pandas as pd

from halfseen.errors import ArgumentError, warn
from halfseen.logs.columns import first_true, shown
from halfseen.logs.formats.compact_dates import are_times_of_day, compact_format
from halfseen.logs.formats.durations import LASTED, LASTED_SHORT, are_durations, durations_ns
from halfseen.logs.formats.table_cells import Cells
from halfseen.logs.formats.table_mapping import Clock
from halfseen.reading import reason_of
from halfseen.shapes import Int

WHOLE = re.compile(r"-?(0|[1-9][0-9]{0,17})")
_WHOLE_AS_FRACTION = re.compile(rf"({WHOLE.pattern})([.,]0+)?")
_OF_FEW_DIGITS = re.compile(r"\d([.,]\d{1,6})?[eE]\+?(0?[7-9]|[1-9]\d)")
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d{1,3})?")
_FRACTION = {mark: re.compile(rf"[-+]?\d*{re.escape(mark)}\d+([eE][-+]?\d+)?") for mark in ".,"}
_IN_THOUSANDS = {mark: re.compile(rf"[-+]?[1-9]\d{{0,2}}({re.escape(mark)}\d{{3}})+") for mark in ".,"}
_GROUPED = re.compile(r"[-+]?\d{1,3}[.,'\u2019 \u00a0\u202f]\d{3}(?!\d)")
MISSING_TEXTS = ("NA", "N/A", "n/a", "#N/A", "#NV", "NaN", "nan", "NULL", "null", "<NA>", "NaT", "\\N", "(null)")
MISSING_TEXTS += ("#VALUE!", "#WERT!", "#DIV/0!", "#REF!", "#BEZUG!", "#NAME?", "#NUM!", "#ZAHL!", "#NULL!", ".")
MISSING_TEXTS += ("<null>", "[NULL]", "#N/A N/A")
"""Texts that R, pandas, databases, spreadsheets, Stata and SAS write for a missing value or an error."""
NO_CAUSES = ("None", "none", "nil", "undefined", "n.a.", "-", "--", "---", "?")
"""Texts that may be names, but no causes of a cut."""
_MISSING_LIKE = {text.lower() for text in (*MISSING_TEXTS, *NO_CAUSES, "NV")}
_WITH_UNIT = re.compile(r"([-+\d][\d.,'\u2019 ]*\d|\d) ?([^\W\d]{1,4}|%|°[CF]?)")
_OTHER = {".": ",", ",": "."}
_BETWEEN = {".": r"\.", ",": ",", "'": "['\u2019]", " ": "[ \u00a0\u202f]"}
"""Spellings of each thousands separator, as patterns."""


class Marks(NamedTuple):
    """Decimal mark of numbers, and thousands separator, if any."""

    decimal: str = "."
    thousands: str = ""


def marks_of(cells: Cells, names: Sequence[str]) -> Marks:
    """The marks of numbers in some columns; the decimal mark is detected if not given.

    Raises
    ------
    LogError
        The columns are ambiguous.
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
    remedy = 'set table.decimal = "," or "." in the mapping'
    if len(found) == 2:
        row, name = found["."]
        other = cells.place(*found[","])
        cells.refuse(row, name, f"has a point, but {other} has a comma; write all numbers alike, or {remedy}")
    for mark, (row, name) in found.items():
        if num_in_thousands[mark] == 0:
            cells.refuse(row, name, f"may be a fraction or a number in thousands, like all others; {remedy}")
    return Marks(next(iter(found), "."), thousands)


def _has_comma(cells: Cells, names: Sequence[str]) -> bool:
    """Whether a cell has a decimal comma rather than a thousands separator."""
    there = (cell for name in names for cell in cells.columns[name] if "," in cell)
    return any(_FRACTION[","].fullmatch(cell) and not _IN_THOUSANDS[","].fullmatch(cell) for cell in there)


def grouped_by(cell: str) -> str | None:
    """The thousands separator of a number, such as 1.234,5 or 1 234; None without one."""
    ways = (Marks(decimal, mark) for mark in _BETWEEN for decimal in ",." if decimal != mark)
    fits = (way for way in ways if plain_number(cell, Marks(way.decimal)) is None)
    return next((way.thousands for way in fits if plain_number(cell, way) is not None), None)


def thousands_mark(cells: Cells) -> str | None:
    """The thousands separator of the first unambiguous number: 1.234,5, and not 1.234."""
    texts = dict.fromkeys(text for column in cells.columns.values() for text in column if _GROUPED.match(text))
    sure = (text for text in texts if not any(plain_number(text, Marks(mark)) for mark in ",."))
    return next((mark for text in sure if (mark := grouped_by(text)) is not None), None)


def is_numeric(cell: str) -> bool:
    """Whether text is a number with any marks."""
    return grouped_by(cell) is not None or any(plain_number(cell, Marks(mark)) is not None for mark in ",.")


def plain_number(cell: str, marks: Marks) -> str | None:
    """A number as Python writes it; None if the cell is not a number with these marks."""
    whole, mark, rest = cell.replace("\u2212", "-").partition(marks.decimal)
    if marks.thousands:
        between = _BETWEEN[marks.thousands]
        if re.fullmatch(rf"[-+]?[1-9]\d{{0,2}}({between}\d{{3}})+", whole):
            whole = re.sub(between, "", whole)
    text = f"{whole}.{rest}" if mark else whole
    is_number = "." not in whole + rest and _NUMBER.fullmatch(text) is not None
    return text if is_number else None


def whole_numbers(names: Sequence[str]) -> list[int] | None:
    """Names as whole numbers, also where fractions of 0 were added to them; None unless all are."""
    found = [_WHOLE_AS_FRACTION.fullmatch(name) for name in names]
    return [int(each[1]) for each in found if each] if all(found) else None


def number_at(cells: Cells, row: int, column: str, marks: Marks) -> float:
    """Read a cell as a number.

    Raises
    ------
    LogError
        The cell is not a finite number.
    """
    cell = cells.columns[column][row]
    value = float(plain_number(cell, marks) or "nan")
    if not np.isfinite(value):
        mark = grouped_by(cell)
        others = "set values, type or table.decimal" if cells.layout.separator else "set values or type"
        remedy = f'set table.thousands = "{mark}" in the mapping' if mark else others
        remedy = _remedy_if_missing(cell) or remedy
        cells.refuse(row, column, f"is not a number with decimal mark {marks.decimal!r}; fix it, or {remedy}")
    if re.fullmatch(r"[-+]?\d+", cell) and int(value) != int(cell):
        cells.refuse(row, column, 'is a whole number that no float holds; if it is a name, set type = "text"')
    return value


def _remedy_if_missing(cell: str) -> str:
    """The remedy for a text that looks like a missing value; empty for any other."""
    is_missing = cell.lower() in _MISSING_LIKE
    return f'if it is missing, leave it empty, or set missing = ["{cell}"] in [table]' if is_missing else ""


def refuse_most_numbers(cells: Cells, rows: Sequence[int], column: str) -> None:
    """Refuse text cells if most of them are numbers, or numbers with the same unit (`LogError`)."""
    there = [row for row in rows if cells.columns[column][row]]
    others = [row for row in there if not is_numeric(cells.columns[column][row])]
    if others and 2 * len(others) < len(there):
        remedy = _remedy_if_missing(cells.columns[column][others[0]]) or "say values or type"
        cells.refuse(others[0], column, f"is not a number, but most of the column are; fix it, or {remedy}")
    found = [_WITH_UNIT.fullmatch(cells.columns[column][row]) for row in there]
    units = {match and is_numeric(match[1]) and match[2] for match in found}
    if len(units) == 1 and units.pop() and len({match and match[1] for match in found}) > 1:
        cells.refuse(there[0], column, 'is a number with a unit; export it without, or set type = "text"')


NANOSECONDS = {"ns": 1, "us": 10**3, "ms": 10**6, "s": 10**9, "min": 60 * 10**9, "h": 3600 * 10**9, "d": 86400 * 10**9}
ISO = re.compile(r"\d{4}-\d\d-\d\d([T ]\d\d:\d\d(:\d\d([.,]\d{1,9})?)?)?( ?(Z|[+-]\d\d(:?\d\d)?))?")
ZONED = re.compile(r":.*(Z|[+-]\d\d(?::?\d\d)?)$")
_HOUR_NS = 3600 * 10**9
_DAY_ALONE = re.compile(r"\d{1,4}[-./]\d{1,2}[-./]\d{1,4}")
TIME_OF_DAY = re.compile(r"\d{1,2}:\d\d(:\d\d([.,]\d{1,9})?)?( ?[AaPp][Mm])?")
_HAS_DAY = re.compile(r"(?<!%)(%%)*%[djcxs]")
_HAS_YEAR = re.compile(r"(?<!%)(%%)*%[YyGcxs]")
_HALF_A_YEAR_NS = 183 * 24 * _HOUR_NS
Stamps: TypeAlias = Int[np.ndarray, " rows"]
"""Times [ns]."""


def stamps_ns(cells: Cells, columns: Sequence[str], clock: Clock, marks: Marks) -> Stamps:
    """Read the times of all rows [ns]: dates since 1970, numbers from their own origin.

    Cells of several columns are joined by a space.

    Raises
    ------
    ArgumentError
        The format or the zone is invalid.
    LogError
        A cell is not a time, or is ambiguous.
    """
    cells, column = joined(cells, columns)
    texts = cells.columns[column]
    if (clock.unit or clock.since) is not None and are_durations(cells, column, clock.unit):
        return durations_ns(cells, column, clock.unit)
    if clock.unit is not None:
        return _counted(cells, column, NANOSECONDS[clock.unit], marks)
    written = pd.Series(texts, dtype=object)
    if clock.format is None:
        _refuse_not_iso(cells, column)
        written = written.str.replace(",", ".", regex=False).str.replace(r" (?=Z|[+-])", "", regex=True)
        is_zoned = written.str.contains(ZONED.pattern.replace("(Z", "(?:Z"), regex=True).to_numpy(dtype=bool)
    else:
        is_zoned = np.full(len(texts), "%z" in clock.format)
    if is_zoned.any() and not is_zoned.all():
        cells.refuse(int(np.argmin(is_zoned)), column, "has no zone, but others have; write all times alike")
    is_of_day = clock.format is not None and not _HAS_DAY.search(clock.format)
    if is_of_day and (is_zoned.any() or clock.zone is not None or clock.begin is not None):
        raise ArgumentError("clock: the format has no day, which zone and begin need; name the column of dates, too")
    message = _doubt(cells, column, is_of_day) if is_of_day or not (is_zoned.any() or clock.zone) else ""
    if message:
        warn(f"{cells.file}, column {column!r}", message)
    has_no_year = not is_of_day and clock.format is not None and not _HAS_YEAR.search(clock.format)
    stamps = _dates(cells, column, written, clock, bool(is_zoned.all()), "1900 " if has_no_year else "")
    if has_no_year:
        _refuse_new_year(cells, column, stamps)
    return _over_midnight(cells, column, stamps) if is_of_day else stamps


def _refuse_new_year(cells: Cells, column: str, stamps: Stamps) -> None:
    """Refuse dates without a year on both sides of a new year (`LogError`)."""
    if (row := first_true(np.abs(np.diff(stamps)) > _HALF_A_YEAR_NS)) is not None:
        trouble = f"comes after {shown(cells.columns[column][row])}, but clock.format has no year"
        cells.refuse(row + 1, column, f"{trouble}; export times with their year")


def joined(cells: Cells, columns: Sequence[str]) -> tuple[Cells, str]:
    """Join the cells of several columns by a space.

    Returns
    -------
    tuple
        A table with one more column, and the name of that column; for one column the table unchanged.

    Raises
    ------
    LogError
        A cell is empty.
    """
    if len(columns) == 1:
        return cells, columns[0]
    for name in columns:
        if "" in cells.columns[name]:
            cells.refuse(cells.columns[name].index(""), name, "is not part of a time; every row needs one")
    name, parts = " ".join(columns), (cells.columns[name] for name in columns)
    joined = {name: [" ".join(texts) for texts in zip(*parts, strict=True)]}
    return replace(cells, columns=cells.columns | joined), name


def _doubt(cells: Cells, column: str, is_of_day: bool) -> str:
    """Possible fault of times without a zone, or without a date."""
    wrong = "an hour is wrong where clocks were changed"
    if not is_of_day:
        return f"times have no zone, so {wrong}; set clock.zone, such as 'Europe/Berlin' or 'UTC'"
    dates = _column_of(cells, _DAY_ALONE)
    remedy = "" if dates is None else f"; if column {dates!r} has their dates, name both: {_both(dates, column)}"
    return f"times have no date, so those that fall back past midnight count as the next day's, and {wrong}{remedy}"


def _both(dates: str, times: str) -> str:
    return f"clock.field = {json.dumps([dates, times], ensure_ascii=False)}"


def _column_of(cells: Cells, like: re.Pattern[str]) -> str | None:
    """The first column in which all cells match a pattern."""
    return next((name for name, texts in cells.columns.items() if all(map(like.fullmatch, texts))), None)


def dates_and_times(cells: Cells) -> list[list[str]]:
    """Pairs of the column of dates with each column of times of day."""
    dates = _column_of(cells, _DAY_ALONE)
    times = [name for name, texts in cells.columns.items() if all(map(TIME_OF_DAY.fullmatch, texts))]
    return [] if dates is None else [[dates, name] for name in times]


def _over_midnight(cells: Cells, column: str, times: Stamps) -> Stamps:
    """Times of day unwrapped over midnight: each is less than 18 h after the one before, or at most 1 h before it."""
    steps, day = np.diff(times), 24 * _HOUR_NS
    near = steps - day * np.rint(steps / day).astype(np.int64)
    forth = -1 if np.sign(near).sum() < 0 else 1  # the newest may come first
    steps = (forth * steps + _HOUR_NS) % day - _HOUR_NS
    if (row := first_true(steps > 18 * _HOUR_NS)) is not None:
        trouble = f"comes after {shown(cells.columns[column][row])}, and no date tells the days apart"
        cells.refuse(row + 1, column, f"{trouble}; name the column of dates in clock.field, too")
    return times[:1].sum() + forth * np.concatenate([np.zeros(1, np.int64), np.cumsum(steps)])


def _refuse_not_iso(cells: Cells, column: str) -> None:
    texts = cells.columns[column]
    row = next((row for row, cell in enumerate(texts) if not ISO.fullmatch(cell)), None)
    if row is None:
        times = _column_of(cells, TIME_OF_DAY) if all(map(_DAY_ALONE.fullmatch, texts)) else None
        if times is not None:
            cells.refuse(0, column, f"has no time of day, and column {times!r} has; name both: {_both(column, times)}")
        return
    cell = texts[row]
    if not cell:
        cells.refuse(row, column, "is not a time; every row needs one, a cut stage the time of the cut")
    if (form := compact_format(cell)) is not None:
        cells.refuse(row, column, f'is a date without separators; set clock.format = "{form}"')
    if is_numeric(cell):
        cells.refuse(row, column, "is a number; set clock.unit: s, ms, us, ns, min, h or d")
    if TIME_OF_DAY.fullmatch(cell):
        dates = _column_of(cells, _DAY_ALONE)
        way = "" if dates is None else f"{_both(dates, column)} and "
        cells.refuse(
            row, column, f'has no date; set {way}clock.format, such as "{"" if dates is None else "%d.%m.%Y "}%H:%M:%S"'
        )
    way = '"%d/%m/%Y %H:%M:%S" or "%m/%d/%Y %H:%M:%S"' if "/" in cell else '"%d.%m.%Y %H:%M:%S"'
    cells.refuse(row, column, f"is not an ISO time, and day and month may be swapped; set clock.format, such as {way}")


def _dates(cells: Cells, column: str, written: Any, clock: Clock, is_zoned: bool, year: str) -> Stamps:
    wanted = "ISO8601" if clock.format is None else clock.format
    way = f"%Y {wanted}" if year else wanted  # Python 3.15 reads no day without a year
    try:
        dates = pd.DatetimeIndex(pd.to_datetime(year + written, format=way, utc=is_zoned, errors="coerce"))
        known = dates.notna()
        if not is_zoned and clock.zone is not None:
            dates = dates.tz_localize(ZoneInfo(clock.zone), ambiguous="NaT", nonexistent="NaT")
    except (ValueError, LookupError, OSError, TypeError) as error:
        trouble = f"dates of column {column!r} cannot be read with it ({reason_of(error)}); fix it"
        raise ArgumentError(f"clock.format or clock.zone: {trouble}") from error
    if (row := first_true(~known)) is not None:
        cells.refuse(row, column, f"is not a time in format {wanted}; fix it, or clock.format")
    if (row := first_true(dates.isna())) is not None:
        where = f"in {clock.zone}, where clocks were changed"
        cells.refuse(row, column, f"occurred twice or never {where}; export times with their offset, or in UTC")
    return dates.as_unit("ns").asi8


def _counted(cells: Cells, column: str, factor: int, marks: Marks) -> Stamps:
    rounded = next((cell for cell in cells.columns[column] if _OF_FEW_DIGITS.fullmatch(cell)), None)
    if rounded is not None:
        warn(f"{cells.file}, column {column!r}", f"times such as {rounded!r} are rounded; export them with all digits")
    if factor == NANOSECONDS["s"] and are_times_of_day(cells.columns[column]):
        trouble = (
            'look like hours, minutes and seconds, as no minute or second is above 59; if so, set format = "%H%M%S"'
        )
        warn(f"{cells.file}, column {column!r}", f"times such as {cells.columns[column][0]!r} {trouble}")
    stamps = np.zeros(len(cells.rows), dtype=np.int64)
    for row, cell in enumerate(cells.columns[column]):
        if (number := plain_number(cell, marks)) is None:
            mark = grouped_by(cell)
            remedy = f'set table.thousands = "{mark}" in the mapping' if mark else "every row needs its time"
            remedy = "it counts by itself; leave clock.unit out" if LASTED.fullmatch(cell) else remedy
            remedy = 'set clock.unit = "min" or "h", that of its first part' if LASTED_SHORT.fullmatch(cell) else remedy
            cells.refuse(row, column, f"is not a number with decimal mark {marks.decimal!r}; {remedy}")
        stamp = round(Decimal(number) * factor)
        if abs(stamp) >= 2**62:
            cells.refuse(row, column, "does not fit in 64 bits of ns; fix it, or clock.unit")
        stamps[row] = stamp
    return stamps
