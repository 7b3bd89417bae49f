"""Whether a table has one row a trajectory, guessed from the names of its columns."""

import re
from collections.abc import Sequence
from typing import NamedTuple

from halfseen.logs.formats.column_words import LIKE, WIDE_LIKE
from halfseen.logs.formats.table_cells import ROW, Cells
from halfseen.logs.formats.table_values import WHOLE, is_numeric
from halfseen.logs.formats.wide_tables import STAGE, reshaped, staged_columns, stages_of

_WORD = "(?:stage|visit|wave|week|day|time|t|v|s)?"
_BY_STAGE = (
    rf"(?P<name>.*?[^\W\d])(?P<between>(?:[_. -]{_WORD}[_. -]?)?)(?P<stage>\d{{1,2}})",
    rf"(?P<before>{_WORD}[_. -]?)(?P<stage>\d{{1,2}})(?P<between>[_. -])(?P<name>.+)",
)
"""Columns by stage, such as ``dose.1``, ``x_t1`` and ``t1_x``."""


class Wide(NamedTuple):
    """A table that has one row a trajectory."""

    pattern: str
    """Pattern of its columns by stage."""
    cells: Cells
    """Its rows as rows of stages."""
    staged: list[str]
    """Columns of `cells` that differ between stages."""
    found: dict[str, str]
    """The columns of the action and, if there are any, of names and of the reward."""


def guessed_wide(cells: Cells) -> Wide | None:
    """Guess the columns by stage; None for other tables, such as those where names of trajectories repeat."""
    for name, texts in cells.columns.items():
        if _is_name(name) and len(set(texts)) < len(texts):
            return None
    pattern, action = next((way for name in cells.columns if (way := _way(cells, name))), ("", ""))
    if not pattern:
        return None
    staged = staged_columns(cells, stages_of(cells.columns, pattern), action, (), "")
    rows = reshaped(cells, staged, list(staged))
    once = [name for name in cells.columns if name in rows.columns and name not in staged]
    names = [name for name in once if _are_names(cells.columns[name])]
    name = next(iter(sorted(names, key=lambda name: (name == ROW, not _is_name(name)))), None)
    reward = next((name for name in (*staged, *once) if _is(name, "reward") and _are_numbers(rows.columns[name])), None)
    found = {"action": action, "trajectory": name, "reward": reward}
    known = {key: name for key, name in found.items() if name is not None}
    return Wide(pattern, rows, [STAGE, *staged], known)


def _way(cells: Cells, column: str) -> tuple[str, str] | None:
    """Pattern and name of the action, if the column is of an action by stage beside others of the same stages."""
    for shape in _BY_STAGE:
        match = re.fullmatch(shape, column, re.IGNORECASE)
        if match is None:
            continue
        name, between = match["name"], match["between"]
        if not (_is(name, "action") or re.search(LIKE["action"], name, re.IGNORECASE)):
            continue
        before = match.groupdict().get("before")
        pattern = f"{{name}}{between}{{stage}}" if before is None else f"{before}{{stage}}{between}{{name}}"
        grouped = stages_of(cells.columns, pattern)
        numbers = sorted(grouped[name])
        num_alike = sum(of.keys() == grouped[name].keys() for of in grouped.values())
        if (
            len(numbers) > 1
            and num_alike > 1
            and numbers in (list(range(len(numbers))), list(range(1, len(numbers) + 1)))
        ):
            return pattern, name
    return None


def _is(name: str, key: str) -> bool:
    return re.fullmatch(WIDE_LIKE[key], name, re.IGNORECASE) is not None


def _is_name(name: str) -> bool:
    return re.search(WIDE_LIKE["trajectory"], name, re.IGNORECASE) is not None


def _are_numbers(texts: Sequence[str]) -> bool:
    return all(map(is_numeric, filter(None, texts)))


def _are_names(texts: Sequence[str]) -> bool:
    """Whether each row has another text or whole number."""
    are_fit = (text and (WHOLE.fullmatch(text) or not is_numeric(text)) for text in texts)
    return len(set(texts)) == len(texts) and all(are_fit)
