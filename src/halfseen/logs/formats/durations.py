"""Durations as text: 1:02:03.5, 1 days 00:02:03 as pandas writes them, and 2:03 in minutes or hours."""

import re

import numpy as np

from halfseen.logs.formats.table_cells import Cells
from halfseen.shapes import Int

LASTED = re.compile(r"(?:(\d{1,4}) days? ?)?(\d{1,4}):([0-5]\d):([0-5]\d)(?:[.,](\d{1,9}))?")
LASTED_SHORT = re.compile(r"(\d{1,5}):([0-5]\d)(?:[.,]\d{1,9})?")
"""Minutes and seconds, or hours and minutes: only a unit tells which."""


def is_duration(text: str) -> bool:
    """Whether a text may be a duration."""
    return (LASTED.fullmatch(text) or LASTED_SHORT.fullmatch(text)) is not None


def are_durations(cells: Cells, column: str, unit: str | None) -> bool:
    """Whether a column counts by itself, or in a unit that its first part has."""
    return unit is None or (unit in ("min", "h") and any(":" in cell for cell in cells.columns[column]))


def durations_ns(cells: Cells, column: str, unit: str | None) -> Int[np.ndarray, " rows"]:
    """Read a column of durations [ns].

    Parameters
    ----------
    unit
        Unit of the first part of durations of two parts, min or h.

    Raises
    ------
    LogError
        A cell is no duration.
    """
    stamps = np.zeros(len(cells.rows), dtype=np.int64)
    for row, cell in enumerate(cells.columns[column]):
        if (match := LASTED.fullmatch(_in_three_parts(cell, unit))) is None:
            trouble = "counts since a beginning; set clock.unit: s, ms, us, ns, min, h or d"
            if unit is not None:
                trouble = "has no colon or is no duration, but others are; write all times alike"
            elif LASTED_SHORT.fullmatch(cell):
                trouble = 'has two parts; set clock.unit = "min" for minutes and seconds, or "h" for hours and minutes'
            cells.refuse(row, column, trouble)
        *parts, fraction = match.groups("0")
        stamps[row] = int(np.dot([86400, 3600, 60, 1], [*map(int, parts)])) * 10**9 + int(fraction.ljust(9, "0"))
    return stamps


def _in_three_parts(cell: str, unit: str | None) -> str:
    """Write a duration of two parts as hours, minutes and seconds; others stay."""
    short = LASTED_SHORT.fullmatch(cell)
    if short is None or unit is None:
        return cell
    if unit == "h":
        return f"{cell}:00"
    hours, minutes = divmod(int(short[1]), 60)
    return f"{hours}:{minutes:02}:{cell.partition(':')[2]}"
