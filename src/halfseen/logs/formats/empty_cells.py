"""Empty cells: texts that mean a missing value, and merged cells, of which only the first has a value."""

from collections.abc import Collection, Sequence
from dataclasses import replace
from itertools import accumulate

from halfseen.logs.formats.table_cells import Cells, check_column


def without_missing(cells: Cells, missing: Collection[str]) -> Cells:
    """Empty the cells whose text means a missing value."""
    if not missing:
        return cells
    columns = {name: ["" if text in missing else text for text in texts] for name, texts in cells.columns.items()}
    return replace(cells, columns=columns)


def filled_down(cells: Cells, names: Sequence[str]) -> Cells:
    """Fill empty cells of some columns with the cell above.

    Raises
    ------
    ArgumentError
        There is no such column.
    LogError
        The first cell of a column is empty.
    """
    filled = {}
    for name in names:
        check_column(cells, name, "table.fill_down")
        filled[name] = list(accumulate(cells.columns[name], lambda above, text: text or above))
        if "" in filled[name]:
            cells.refuse(0, name, "has no cell above it to repeat; fix it, or leave it out of table.fill_down")
    return replace(cells, columns=cells.columns | filled)
