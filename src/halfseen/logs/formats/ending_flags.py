"""Truth values as text; endings by rewards, or as flags in the row of the action, such as ``terminated`` of Gymnasium.

The flags of a row become one text: "finished", the cause of a cut, or empty. If both are true, the trajectory
finished. A true flag before the last row is refused, like any ending that comes too early.
"""

from collections.abc import Sequence
from dataclasses import replace

import msgspec

from halfseen.logs.columns import FINISHED
from halfseen.logs.formats.table_cells import Cells, check_column
from halfseen.logs.formats.table_mapping import Ending, EventMapping, Flag

LOG_ENDED = "log ended"
"""Cause of the cut of a trajectory without an ending."""
_TRUE = ("true", "t", "1", "1.0", "yes", "y", "wahr", "ja", "vrai", "oui", "verdadero", "sí", "vero", "sì")
_FALSE = ("false", "f", "0", "0.0", "no", "n", "falsch", "nein", "faux", "non", "falso", "")
"""Truth values, also as German, French, Spanish and Italian programs write them."""


BY, BY_REWARD = "ending by ", "ending by reward"
"""Names of columns of endings that flags or rewards tell: how they begin, and the latter."""


def are_flags(texts: list[str]) -> bool:
    """Whether all cells are true, false or empty, and at least one is false."""
    found = {text.lower() for text in texts}
    return found <= {*_TRUE, *_FALSE} and bool(found & {*_FALSE} - {""})


def truths(texts: Sequence[str]) -> list[bool | None] | None:
    """Texts as truth values, an empty one as None; None unless all others are true or false."""
    meant = {"true": True, "false": False, "": None}
    lowered = [text.lower() for text in texts]
    return [meant[text] for text in lowered] if any(texts) and all(text in meant for text in lowered) else None


def with_ending(cells: Cells, mapping: EventMapping, file: str) -> tuple[Cells, EventMapping]:
    """Merge the flags of an ending into one text column, to which the mapping then refers.

    Raises
    ------
    ArgumentError
        There is no such column.
    LogError
        A cell is neither true nor false; an empty one is false.
    """
    ending = mapping.ending
    if isinstance(ending.finished, list):
        return cells, mapping
    if not isinstance(ending.finished, Flag):
        rewards = cells.columns.get(mapping.column("reward"), [])
        return _with_texts(cells, mapping, ["" if text else LOG_ENDED for text in rewards], BY_REWARD, "")
    is_finished = _read(cells, ending.finished, f"{file}, ending.finished.field")
    cause = "" if ending.cut is None else ending.cut.field
    is_cut = [False] * len(is_finished) if ending.cut is None else _read(cells, ending.cut, f"{file}, ending.cut.field")
    texts = [FINISHED if done else cause if cut else "" for done, cut in zip(is_finished, is_cut, strict=True)]
    name = f"{BY}{' or '.join(filter(None, [ending.finished.field, cause]))}"
    return _with_texts(cells, mapping, texts, name, FINISHED)


def _with_texts(
    cells: Cells, mapping: EventMapping, texts: list[str], name: str, finished: str
) -> tuple[Cells, EventMapping]:
    """Add a column of endings, and map it."""
    by_text = Ending(field=name, finished=[finished], values=mapping.ending.values)
    return replace(cells, columns=cells.columns | {name: texts}), msgspec.structs.replace(mapping, ending=by_text)


def _read(cells: Cells, flag: Flag, asked_by: str) -> list[bool]:
    check_column(cells, flag.field, asked_by)
    texts = [text.lower() for text in cells.columns[flag.field]]
    wrong = next((row for row, text in enumerate(texts) if text not in (*_TRUE, *_FALSE)), None)
    if wrong is not None:
        cells.refuse(wrong, flag.field, "is neither true nor false (1 or 0, yes or no); fix it, or name another column")
    return [text in _TRUE for text in texts]


def remedy_after_ending(cells: Cells, mapping: EventMapping) -> str:
    """Remedy for rows that come after an ending."""
    column = mapping.column("ending")
    if not mapping.ending.topics and are_flags(cells.columns[column]):
        return f'column {column!r} is true or false, so set finished = {{field = "{column}"}} in [ending]'
    if mapping.trajectory is None:
        return "map [trajectory], the column of its name or the event that begins it, if there are several"
    if mapping.clock.since == "stage":
        last = "the oldest row must be first, since times count from each stage; sort the rows"
    else:
        last = "the ending must be last by the clock; fix the times"
    if mapping.topic is None and column == BY_REWARD:
        last += ", give every row but the last a reward"
    elif mapping.topic is None:
        named = f"flags {column.removeprefix(BY)}" if column.startswith(BY) else f"column {column!r}"
        last += f", leave {named} empty in all rows but the last"
    return f"{last}, or have {mapping.origin('trajectory')} distinguish the trajectories"
