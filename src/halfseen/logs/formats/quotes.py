"""Quotes of CSV that open a cell and were not meant to: readers take the rows below into that cell without a word."""

import re
from collections.abc import Callable, Iterable, Iterator
from typing import NoReturn

from halfseen.errors import LogError

FEWEST_SEPARATORS = 2
"""In a heading, from which on lines of one cell that hold as many look like rows; prose holds a comma a line."""


def refuse(place: str, trouble: str) -> NoReturn:
    """Refuse a table for a quote in it (`LogError`)."""
    raise LogError(f"{place}: {trouble}")


def check_quotes(
    file: object,
    lines: Iterable[str],
    separator: str = ",",
    *,
    first: int = 1,
    is_spaced: bool = False,
    on_rows: Callable[[str, str], object] = refuse,
) -> None:
    """Refuse a quote that nothing closes, and tell of a quoted cell whose lines look like rows.

    Parameters
    ----------
    file
        Where the lines are from, for messages.
    lines
        Of the table, from its heading on.
    separator
        What separates cells.
    first
        Number of the first line in the file.
    is_spaced
        Whether a quote may open a cell behind spaces.
    on_rows
        Is given the place and the trouble where lines of one cell look like rows.

    Raises
    ------
    LogError
        A quote is never closed.
    """
    usual = None
    for begin, record in _records(lines, separator, first, is_spaced):
        if not record:
            refuse(f"{file}, line {begin}", "a quote opens a cell here, and none closes it; delete it, or close it")
        counts = [line.count(separator) for line in record]
        usual = counts[0] if usual is None else usual
        if len(record) > 1 and usual >= FEWEST_SEPARATORS and min(counts) >= usual:
            on_rows(
                f"{file}, line {begin}",
                f"a quote opens a cell here that ends in line {begin + len(record) - 1}, and each line of it looks "
                "like a row; delete the quote, or the line breaks of that cell",
            )


def _records(lines: Iterable[str], separator: str, first: int, is_spaced: bool) -> Iterator[tuple[int, list[str]]]:
    """Give the number of the first line of each record, and its lines; none where the record is never closed."""
    before = f"(?:^|(?<={re.escape(separator)}))" + (" *" if is_spaced else "")
    quoted = re.compile(before + '"[^"]*(?:""[^"]*)*("?)')
    record: list[str] = []
    begin = first
    for number, line in enumerate(lines, start=first):
        begin = begin if record else number
        # Within a cell that is open, a line goes on as if a quote stood before it.
        is_open = _is_open(quoted, '"' + line if record else line)
        record.append(line)
        if not is_open:
            yield begin, record
            record = []
    if record:
        yield begin, []


def _is_open(quoted: re.Pattern[str], line: str) -> bool:
    """Whether the last quoted cell of a line goes on in the next."""
    closings = quoted.findall(line) if '"' in line else []
    return bool(closings) and not closings[-1]
