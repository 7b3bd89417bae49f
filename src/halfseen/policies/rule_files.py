"""Rules of thumb in files: each row asks for conditions and names an action, and the first that matches wins.

As CSV, an empty cell asks nothing::

    stage,weight_kg,shine,action
    > 2,,,hand over
    ,> 1.5,,parallel
    ,,> 0.5,suction
    ,,,soft

As TOML the same is::

    [[rule]]
    when = { stage = "> 2" }
    action = "hand over"

    [[rule]]
    action = "soft"

A condition is a value, or ``<``, ``<=``, ``>``, ``>=``, ``=`` or ``!=`` and a value; several are joined by ``and``. The
last row asks nothing, so every state matches one.
"""

import csv
from collections.abc import Callable, Hashable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from halfseen.errors import ArgumentError, did_you_mean
from halfseen.policies.rule_table import ACTION, COMPARISONS, STAGE, Condition, RuleRow, RuleTable
from halfseen.reading import opened_text, read_text, reason_of, toml_of


class Rows(NamedTuple):
    """Rows of a CSV file."""

    rows: tuple[RuleRow, ...]
    also: tuple[str, ...]
    """Cells of one more column, if one was asked for."""


def read_rule_table(path: str | Path, horizon: int, names: Sequence[Hashable] = ()) -> RuleTable:
    """Read a rule from a CSV or TOML file.

    Parameters
    ----------
    path
        The file; its ending says which of the two it is.
    horizon
        Number T of stages.
    names
        Actions as the log has them: an action that is written like one of these is that one, number or not.

    Raises
    ------
    ArgumentError
        The file cannot be read, or is no rule; file and row are named.
    """
    path, known = Path(path), {str(name): name for name in names}
    if path.suffix.lower() not in _READERS:
        raise ArgumentError(f"{path}: a rule is a file that ends in {' or '.join(_READERS)}")
    try:
        entries = enumerate(_READERS[path.suffix.lower()](path), start=1)
        return RuleTable(tuple(_row(k, asked, action, known) for k, (asked, action) in entries), horizon)
    except ArgumentError as error:
        raise ArgumentError(f"{path}: {error}") from error
    except (OSError, ValueError, csv.Error) as error:
        raise ArgumentError(f"{path}: it cannot be read as a rule ({reason_of(error)}); mend it there") from error


def csv_rows(path: Path, also: str) -> Rows:
    """Read conditions and actions, and one more column that every row fills in; the last row may have conditions."""
    each = _csv_entries(path, also)
    cells = [dict(asked) for asked, _ in each]
    more = tuple(one.pop(also, "") for one in cells)
    named = zip(cells, (action for _, action in each), strict=True)
    return Rows(tuple(_row(k, asked, action, {}) for k, (asked, action) in enumerate(named, start=1)), more)


def named_in(kind: str, name: Any, known: Sequence[Any]) -> str:
    """Say that something is not among those that are known."""
    there = list(map(str, known))
    return f"there is no {kind} {name}; there are {', '.join(there)}{did_you_mean(str(name), there)}"


def _csv_entries(path: Path, also: str | None = None) -> list[tuple[Mapping[str, Any], Any]]:
    with opened_text(path) as file:
        reader = csv.reader(file, skipinitialspace=True)
        head, *rows = [[cell.strip() for cell in row] for row in reader if any(cell.strip() for cell in row)] or [[]]
    lacking = next((name for name in (ACTION, also) if name is not None and name not in head), None)
    if lacking is not None or len(set(head)) < len(head) or "" in head:
        wanted = lacking or ACTION
        raise ArgumentError(f"its first line is {','.join(head)!r}; name each column once, one of them {wanted!r}")
    for number, row in enumerate(rows, start=1):
        if len(row) != len(head):
            raise ArgumentError(f"row {number} has {len(row)} cells, and the first line {len(head)}")
    cells = [dict(zip(head, row, strict=True)) for row in rows]
    return [({name: text for name, text in row.items() if text and name != ACTION}, row[ACTION]) for row in cells]


def _toml_entries(path: Path) -> list[tuple[Mapping[str, Any], Any]]:
    read = toml_of(read_text(path))
    rules: Any = read.get("rule")
    if set(read) != {"rule"} or not isinstance(rules, list) or not all(isinstance(rule, dict) for rule in rules):
        raise ArgumentError(f"it holds {', '.join(read) or 'nothing'}; give [[rule]] entries and nothing else")
    for number, rule in enumerate(rules, start=1):
        others = sorted(set(rule) - {"when", ACTION})
        if others or not isinstance(rule.get("when", {}), dict):
            what = f"an unknown key {others[0]!r}" if others else "a 'when' that is no table"
            raise ArgumentError(f"row {number} has {what}; give when = {{ column = condition }} and action")
    return [(rule.get("when", {}), rule.get(ACTION, "")) for rule in rules]


_READERS: dict[str, Callable[[Path], list[tuple[Mapping[str, Any], Any]]]] = {
    ".csv": _csv_entries,
    ".toml": _toml_entries,
}


def _row(number: int, asked: Mapping[str, Any], action: Any, known: Mapping[str, Hashable]) -> RuleRow:
    if not isinstance(action, str | int) or action == "":
        raise ArgumentError(f"row {number}: action is {action!r}; name one")
    conditions = [
        _condition(number, str(column), part) for column, text in asked.items() for part in str(text).split(" and ")
    ]
    return RuleRow(tuple(conditions), known.get(str(action), action))


def _condition(number: int, column: str, text: str) -> Condition:
    stripped = text.strip()
    sign = next((sign for sign in COMPARISONS if stripped.startswith(sign)), "")
    written = stripped.removeprefix(sign).strip()
    value = _number_or_text(written)
    is_text = isinstance(value, str)
    if not written or (is_text and (sign not in ("", "=", "!=") or column == STAGE or written[0] in "<>=!")):
        raise ArgumentError(
            f"row {number}: {column} is {text.strip()!r}, which is no condition; give a value, or one of "
            f"{' '.join(COMPARISONS)} and a number"
        )
    return Condition(column, sign or "=", value)


def _number_or_text(written: str) -> float | str:
    try:
        value = float(written)
    except ValueError:
        return written
    return value if np.isfinite(value) else written
