"""Stray quotes in CSV that open a cell: readers silently absorb the following rows into that cell.

And quotes escaped by a backslash, as Spark and MySQL write them: other readers end the cell there. And headings within
it, where files were put one below the other: readers take them for rows.
"""

import re
from collections.abc import Callable, Iterable, Iterator
from typing import NoReturn

from halfseen.errors import LogError

_BYTE_ORDER_MARK = "\ufeff"
FEWEST_SEPARATORS = 2
"""Least number of separators in a heading for lines of one cell with as many to look like rows; a line of prose may
have one comma."""


def refuse(place: str, trouble: str) -> NoReturn:
    """Refuse a table with a stray quote (`LogError`)."""
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
    """Refuse an unclosed or escaped quote and a second heading, and report a quoted cell whose lines look like rows.

    Parameters
    ----------
    file
        Source of the lines, for messages.
    lines
        Lines of the table, from its heading on.
    separator
        Separator between cells.
    first
        Number of the first line in the file.
    is_spaced
        Whether a quote may open a cell after spaces.
    on_rows
        Called with the place and the trouble if lines of one cell look like rows.

    Raises
    ------
    LogError
        A quote is never closed, or is escaped by a backslash, or another file begins below the first line.
    """
    usual = heading = None
    cell = f"(?:^|(?<={re.escape(separator)}))" + (" *" if is_spaced else "") + '"[^"]*(?:""[^"]*)*'
    escaped = re.compile(rf'{cell}(?<=\\)"[^{re.escape(separator)}\s"]')
    for begin, record in _records(lines, re.compile(f'{cell}("?)'), first):
        if not record:
            refuse(f"{file}, line {begin}", "a quote opens a cell here and is not closed; delete it, or close it")
        if '\\"' in (text := "".join(record)) and escaped.search(text):
            refuse(f"{file}, line {begin}", 'a quote within a cell is escaped by a backslash; export it doubled, as ""')
        start = record[0].rstrip()
        heading = start.removeprefix(_BYTE_ORDER_MARK) if heading is None else heading
        if begin > first and start and (start.startswith(_BYTE_ORDER_MARK) or start == heading):
            what = "the heading stands" if start.removeprefix(_BYTE_ORDER_MARK) == heading else "a byte order mark is"
            refuse(f"{file}, line {begin}", f"{what} here, too, as where another file was put below; delete it")
        counts = [line.count(separator) for line in record]
        usual = counts[0] if usual is None else usual
        if len(record) > 1 and usual >= FEWEST_SEPARATORS and min(counts) >= usual:
            on_rows(
                f"{file}, line {begin}",
                f"a quote opens a cell here that ends in line {begin + len(record) - 1}, and each line of it looks "
                "like a row; delete the quote, or the line breaks of that cell",
            )


def _records(lines: Iterable[str], quoted: re.Pattern[str], first: int) -> Iterator[tuple[int, list[str]]]:
    """The number of the first line of each record, and its lines; no lines if the record is never closed."""
    record: list[str] = []
    begin = first
    for number, line in enumerate(lines, start=first):
        begin = begin if record else number
        # Within an open cell, parse a line as if a quote came before it.
        is_open = _is_open(quoted, '"' + line if record else line)
        record.append(line)
        if not is_open:
            yield begin, record
            record = []
    if record:
        yield begin, []


def _is_open(quoted: re.Pattern[str], line: str) -> bool:
    """Whether the last quoted cell of a line continues in the next line."""
    closings = quoted.findall(line) if '"' in line else []
    return bool(closings) and not closings[-1]
