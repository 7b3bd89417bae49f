"""Tables of one row a trajectory, with columns by stage such as ``x_1, a_1, y_1, x_2, a_2, y_2``, as rows of stages.

The stages are those of the action's columns. Columns without a stage are the same in every stage; a reward counts in
the last one, where also the ending stands. A stage whose mapped cells are all empty was not reached.
"""

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import TypeAlias

import msgspec

from halfseen.errors import ArgumentError, LogError, warn
from halfseen.logs.columns import shown
from halfseen.logs.formats.table_cells import Cells
from halfseen.logs.formats.table_mapping import Ending, Entry, EventMapping, Flag

STAGE = "stage"
"""Column of the number of a stage, from 1, unless the table has such a column."""
ROW = "row of the table"
"""Column of the names of trajectories if none is mapped."""
NOTHING = "+0"
"""A reward of 0, in a spelling that `Entry.values` does not replace."""
Stages: TypeAlias = Mapping[str, Mapping[int, str]]
"""Columns by name and number of the stage."""


def stages_of(names: Collection[str], pattern: str) -> dict[str, dict[int, str]]:
    """Group the columns that match a pattern; a unit may follow the stage, as in ``Time 1 [s]``, and is of the name."""
    before, first, between, second, after = re.split(r"(\{name\}|\{stage\})", pattern)
    name = ".+" if between else r".*\D" if first == "{name}" else r"\D.*"
    part = {"{name}": f"(?P<name>{name})", "{stage}": r"(?P<stage>\d{1,4})"}
    whole = re.escape(before) + part[first] + re.escape(between) + part[second] + re.escape(after)
    unit = r"(?P<unit> ?\[[^]]*\]| ?\([^)]*\))?"
    found: dict[str, dict[int, str]] = {}
    for column in names:
        if match := re.fullmatch(whole + unit, column):
            named = match["name"] + (match["unit"] or "")
            other = found.setdefault(named, {}).setdefault(int(match["stage"]), column)
            if other != column:
                raise LogError(f"columns {other!r} and {column!r} are of one stage; rename one of them")
    return found


def one_row_a_stage(cells: Cells, mapping: EventMapping, file: str) -> tuple[Cells, EventMapping]:
    """Reshape a table to one row a stage, and fit the mapping to it; unchanged unless the mapping is of a wide table.

    Raises
    ------
    ArgumentError
        A column by stage is missing, or numbered otherwise than those of the action.
    LogError
        Two rows have one name, or a stage without an action comes before another.
    """
    if mapping.wide is None:
        return cells, mapping
    grouped = stages_of(cells.columns, mapping.wide)
    action = mapping.column("action")
    if len(grouped.get(action, {})) < 2:
        there = ", ".join(map(shown, grouped)) or "none"
        raise ArgumentError(
            f"{file}, action.field: {shown(action)} has no columns of two stages by {mapping.wide!r}; there are {there}"
        )
    used = _used(mapping)
    staged = staged_columns(cells, grouped, action, used, f"{file}, wide")
    for key, name in mapping.clock.columns:
        if name in cells.columns and name not in staged:
            raise ArgumentError(
                f"{file}, {key}: column {name!r} has one time a row; name a column by stage, or {STAGE!r}"
            )
    if mapping.trajectory is None:
        numbers = [str(number) for number in range(1, len(cells.rows) + 1)]
        cells = replace(cells, columns=cells.columns | {ROW: numbers})
        mapping = msgspec.structs.replace(mapping, trajectory=Entry(field=ROW))
    _refuse_repeated(cells, mapping.column("trajectory"))
    free = "" in mapping.action.values
    once = dict.fromkeys(_of_ending(mapping.ending), "") | {mapping.column("reward"): NOTHING}
    return reshaped(cells, staged, used, None if free else action, once), mapping


def reshaped(
    cells: Cells,
    staged: Stages,
    used: Collection[str],
    action: str | None = None,
    once: Mapping[str, str] = MappingProxyType({}),
) -> Cells:
    """Reshape a table to one row a stage.

    Parameters
    ----------
    staged
        Columns by stage; all have the same stages, of which some may be missing.
    used
        Names among them that tell whether a stage was reached.
    action
        Name that every stage before another must have; None to not check.
    once
        Columns without a stage that are read in the last stage alone, and what stands for them before.
    """
    numbers = sorted({number for of in staged.values() for number in of})
    blank = [""] * len(cells.rows)
    by_stage = {
        name: [cells.columns.get(of.get(number, ""), blank) for number in numbers] for name, of in staged.items()
    }
    last = [_last(row, by_stage, used) for row in range(len(cells.rows))]
    if action is not None:
        _check_actions(cells, last, by_stage[action], [staged[action][number] for number in numbers])
    if unreached := [row for row, at in enumerate(last) if at < 0]:
        warn(cells.place(unreached[0]), f"no stage of it has a value; such rows are left out: {len(unreached):,}")
    places = [(row, k) for row, at in enumerate(last) for k in range(at + 1)]
    of_stages = {name: name for of in staged.values() for name in of.values()}
    columns = {
        name: [once.get(name, texts[row]) if k < last[row] else texts[row] for row, k in places]
        for name, texts in cells.columns.items()
        if name not in of_stages
    }
    columns = {STAGE: [str(k + 1) for _, k in places]} | columns
    columns |= {name: [texts[k][row] for row, k in places] for name, texts in by_stage.items()}
    return replace(cells, columns=columns, rows=[f"{cells.rows[row]}, stage {k + 1}" for row, k in places])


def staged_columns(
    cells: Cells, grouped: Stages, action: str, used: Collection[str], where: str
) -> dict[str, dict[int, str]]:
    """Columns of the action's stages; a name with fewer than two of them has no stages."""
    numbers = sorted(grouped[action])
    if numbers[-1] - numbers[0] >= len(numbers):
        raise ArgumentError(f"{where}: {shown(action)} has the stages {numbers}, not all between; fix their names")
    staged: dict[str, dict[int, str]] = {}
    for name, of in grouped.items():
        of_stages = {number: of[number] for number in numbers if number in of}
        if len(of_stages) < 2:
            continue
        staged[name] = of_stages
        if name not in used:
            continue
        if name in cells.columns:
            raise ArgumentError(f"{where}: column {name!r} stands beside {of_stages[min(of_stages)]!r}; rename it")
        if min(of) < numbers[0]:
            raise ArgumentError(
                f"{where}: {of[min(of)]!r} is of a stage before {grouped[action][numbers[0]]!r}, the first action; "
                "rename the columns so that an action and what was seen before it have one number"
            )
        if max(of) > numbers[-1]:
            warn(cells.file, f"column {of[max(of)]!r} comes after the last action; it is not read")
    return staged


def _used(mapping: EventMapping) -> set[str]:
    """All columns that a mapping names, except that of the trajectory."""
    named = {entry.field for key, entry in mapping.entries.items() if key != "trajectory" and entry.field is not None}
    return named | {name for _, name in mapping.clock.columns} | {*_of_ending(mapping.ending)}


def _of_ending(ending: Ending) -> list[str]:
    """The columns of an ending."""
    flags = [flag.field for flag in (ending.finished, ending.cut) if isinstance(flag, Flag)]
    return flags if ending.field is None else [ending.field, *flags]


def _refuse_repeated(cells: Cells, column: str) -> None:
    texts = cells.columns.get(column, [])
    first = {text: row for row, text in reversed(list(enumerate(texts)))}
    again = next((row for row, text in enumerate(texts) if text and first[text] != row), None)
    if again is not None:
        line = cells.place(first[texts[again]])
        cells.refuse(again, column, f"is also in {line}, but each row is a trajectory; give each a name of its own")


def _last(row: int, by_stage: Mapping[str, Sequence[Sequence[str]]], used: Collection[str]) -> int:
    """The last stage of a row in which a used name has a value, from 0; -1 without one."""
    reached = (k for name in used if name in by_stage for k, texts in enumerate(by_stage[name]) if texts[row])
    return max(reached, default=-1)


def _check_actions(cells: Cells, last: Sequence[int], actions: Sequence[Sequence[str]], columns: Sequence[str]) -> None:
    for row, at in enumerate(last):
        for k in range(at):
            if not actions[k][row]:
                trouble = f"is no action, but {columns[k + 1]!r} or others of its stage have values"
                cells.refuse(row, columns[k], f"{trouble}; leave stages that were not reached empty")
