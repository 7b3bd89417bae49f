"""Lines of a mapping that tell the layout of a file."""

import json
from collections.abc import Iterator

from halfseen.errors import LogError
from halfseen.logs.formats.table_cells import Cells
from halfseen.logs.formats.table_values import marks_of


def layout_lines(cells: Cells) -> Iterator[str]:
    """Lines of the layout of the file."""
    layout = cells.layout
    if layout.separator is not None:
        yield f"separator = {quoted(layout.separator)}  # guess"
        yield f"encoding = {quoted(str(layout.encoding))}  # guess: utf-8, cp1252, utf-16, shift_jis, gbk, …"
        yield _decimal_line(cells)
    if layout.thousands is not None:
        yield f"thousands = {quoted(layout.thousands)}  # guess: between groups of three digits"
    if layout.missing:
        yield f"missing = [{', '.join(map(quoted, layout.missing))}]  # guess: texts of empty cells"
    if layout.heading > 1:
        yield f"heading = {layout.heading}  # guess: the line that names the columns"


def _decimal_line(cells: Cells) -> str:
    try:
        return f'decimal = {quoted(marks_of(cells, list(cells.columns)).decimal)}  # guess: decimal mark, "," or "."'
    except LogError:
        return '# decimal = ","  # the decimal mark, which cannot be guessed: "," or "."'


def quoted(text: str) -> str:
    """A text as TOML writes it."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
