"""Which columns and events of a table carry what, guessed from their names (`guesses.toml`) and cells.

A table may have one row an event, a stage or a trajectory.
"""

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from halfseen.logs.formats.compact_dates import compact_format
from halfseen.logs.formats.durations import is_duration
from halfseen.logs.formats.ending_flags import are_flags
from halfseen.logs.formats.table_cells import ROW, Cells
from halfseen.logs.formats.table_values import ISO, WHOLE, dates_and_times, is_numeric, joined
from halfseen.logs.formats.wide_tables import STAGE, reshaped, staged_columns, stages_of
from halfseen.reading import toml_of

_WORDS = toml_of(Path(__file__).with_name("guesses.toml").read_text(encoding="utf-8"))
LIKE, FLAGS_LIKE, EVENTS_LIKE, WIDE_LIKE, _OTHERS = (
    {key: re.compile("|".join(words), re.IGNORECASE) for key, words in _WORDS[table].items()}
    for table in ("columns", "flags", "events", "wide", "others")
)
"""Patterns of names by key: of columns, of flags, of events, and of columns in tables of one row a trajectory."""
BEGIN_LIKE, END_TIME_LIKE, FINISHED_LIKE = LIKE["clock.begin"], _OTHERS["end_time"], _OTHERS["finished"]
_WORD = "(?:stage|visit|wave|week|day|time|t|v|s)?"
_BY_STAGE = (
    rf"(?P<name>.*?[^\W\d])(?P<between>(?:[_. -]{_WORD}[_. -]?)?)(?P<stage>\d{{1,2}})",
    rf"(?P<before>{_WORD}[_. -]?)(?P<stage>\d{{1,2}})(?P<between>[_. -])(?P<name>.+)",
)
"""Columns by stage, such as ``dose.1``, ``x_t1`` and ``t1_x``."""
_DAYS = ("%d.%m.%Y", "%d/%m/%Y", "%m/%d/%Y", "%Y/%m/%d", "%d-%m-%Y", "%m-%d-%Y", "%d.%m.%y", "%d/%m/%y", "%m/%d/%y")
_DAYS += ("%d-%b-%Y", "%d-%b-%y")
_TIMES = ("%H:%M:%S", "%H:%M:%S.%f", "%H:%M:%S,%f", "%H:%M", "%I:%M:%S %p", "%I:%M:%S.%f %p", "%I:%M %p")
_ROWS_LOOKED_AT, MOST_NUMBERED = 1000, 20
"""Number of first dates that are read; and of numbers that may name actions."""


class Guesses(NamedTuple):
    """The guessed columns of a table."""

    cells: Cells
    """Its rows; one a stage if it has one a trajectory, and a date and a time of day in one column."""
    found: dict[str, str]
    """The column of each key."""
    parts: dict[str, list[str]]
    """The two columns of a date and a time of day, by the name of the one made of them."""
    pattern: str = ""
    """With one row a trajectory, the pattern of columns by stage."""
    staged: tuple[str, ...] = ()
    """Those columns, without their stage."""


def guessed(cells: Cells) -> Guesses:
    """Guess the columns of a table."""
    whole, parts = cells, {}
    for both in dates_and_times(cells):
        whole, name = joined(whole, both)
        parts[name] = both
    used = {name for both in parts.values() for name in both}
    columns = {name: whole.columns[name] for name in (*parts, *cells.columns) if name not in used}
    cells = replace(cells, columns=columns)
    return _of_wide(cells, parts) or Guesses(cells, _columns(cells, {}), parts)


# Tables of one row a trajectory.


def _of_wide(cells: Cells, parts: dict[str, list[str]]) -> Guesses | None:
    """Guess the columns by stage; None for other tables, such as those where names of trajectories repeat."""
    if any(_is_name(name) and len(set(texts)) < len(texts) for name, texts in cells.columns.items()):
        return None
    pattern, action = next((way for name in cells.columns if (way := _way(cells, name))), ("", ""))
    if not pattern:
        return None
    staged = staged_columns(cells, stages_of(cells.columns, pattern), action, (), "")
    rows = reshaped(cells, staged, list(staged))
    once = [name for name in cells.columns if name in rows.columns and name not in staged]
    names = [name for name in once if _are_names(cells.columns[name])]
    rewards = (
        name for name in (*staged, *once) if WIDE_LIKE["reward"].search(name) and are_numbers(rows.columns[name])
    )
    found = {
        "action": action,
        "trajectory": min(names, key=lambda name: (name == ROW, not _is_name(name)), default=None),
        "reward": next(rewards, None),
    }
    known = {key: name for key, name in found.items() if name is not None}
    by_stage = replace(rows, columns={name: rows.columns[name] for name in staged})
    times = {key: name for key, name in _columns(by_stage, known).items() if key.startswith("clock")}
    # Only a column by stage is a clock.
    columns = {name: texts for name, texts in rows.columns.items() if name != STAGE or not times}
    rows = replace(rows, columns=columns)
    return Guesses(rows, _columns(rows, {"clock.field": STAGE, **known, **times}), parts, pattern, tuple(staged))


def _way(cells: Cells, column: str) -> tuple[str, str] | None:
    """Pattern and name of the action, if the column is of an action by stage beside others of the same stages."""
    for shape in _BY_STAGE:
        match = re.fullmatch(shape, column, re.IGNORECASE)
        if match is None:
            continue
        name, between = match["name"], match["between"]
        if not (WIDE_LIKE["action"].search(name) or LIKE["action"].search(name)):
            continue
        before = match.groupdict().get("before")
        pattern = f"{{name}}{between}{{stage}}" if before is None else f"{before}{{stage}}{between}{{name}}"
        grouped = stages_of(cells.columns, pattern)
        numbers = sorted(grouped[name])
        num_alike = sum(of.keys() == grouped[name].keys() for of in grouped.values())
        is_gapless = numbers[0] in (0, 1) and numbers[-1] - numbers[0] == len(numbers) - 1
        if len(numbers) > 1 and num_alike > 1 and is_gapless:
            return pattern, name
    return None


def _is_name(name: str) -> bool:
    return any(like["trajectory"].search(name) for like in (LIKE, WIDE_LIKE))


def _are_names(texts: Sequence[str]) -> bool:
    """Whether each row has another text or whole number."""
    are_fit = (text and (WHOLE.fullmatch(text) or not is_numeric(text)) for text in texts)
    return len(set(texts)) == len(texts) and all(are_fit)


# The column of each key.


def _columns(cells: Cells, given: dict[str, str]) -> dict[str, str]:
    """The column of each key for which one matches, besides those given."""
    found = _flags(cells) | _span(cells) | given
    known = {*found} | ({"ending"} if "ending.finished" in found else set())
    known |= {"topic"} if "clock.begin" in found else set()
    for key, like in LIKE.items():
        is_fit = _FITS.get(key, any)
        free = (
            name
            for name, texts in cells.columns.items()
            if name not in found.values() and any(texts) and like.search(name) and is_fit(texts)
        )
        if key not in known and (name := next(free, None)) is not None:
            found[key] = name
    return found | _other_times(cells, found)


def _flags(cells: Cells) -> dict[str, str]:
    """The columns of ending flags; none unless there is a flag for finished."""
    flags = [name for name, texts in cells.columns.items() if are_flags(texts)]
    found = {key: next(filter(like.search, flags), None) for key, like in FLAGS_LIKE.items()}
    return {} if found["ending.finished"] is None else {key: name for key, name in found.items() if name is not None}


def _span(cells: Cells) -> dict[str, str]:
    """The columns with begin and end times of stages; none if one of the two is missing."""
    times = [name for name, texts in cells.columns.items() if _are_times(texts) and not are_flags(texts)]
    begin = next(filter(BEGIN_LIKE.search, times), None)
    filled = {name: list(filter(None, texts)) for name, texts in cells.columns.items() if not are_flags(texts)}
    ends = (name for name, texts in filled.items() if texts and _are_times(texts))  # empty where a stage was cut
    end = next((name for name in ends if name != begin and END_TIME_LIKE.search(name)), None)
    return {} if begin is None or end is None else {"clock.begin": begin, "clock.field": end}


def _other_times(cells: Cells, found: dict[str, str]) -> dict[str, str]:
    """A column of times not found by its name; with one row per stage, also the end if the one found is a beginning."""
    times = (name for name in cells.columns if name not in found.values() and date_formats(cells.columns[name]))
    lasting = (name for name, texts in cells.columns.items() if _OTHERS["duration"].search(name) and _are_times(texts))
    first = found.get("clock.field") or next(times, None) or next(lasting, None)
    is_begin = first is not None and BEGIN_LIKE.search(first) is not None
    if is_begin and not {"topic", "clock.begin"} & set(found) and (end := next(times, None)) is not None:
        return {"clock.begin": str(first), "clock.field": end}
    return {} if first is None else {"clock.field": first}


def are_numbers(texts: Iterable[str]) -> bool:
    """Whether all cells that are not empty are numbers."""
    return all(map(is_numeric, filter(None, texts)))


def _are_times(texts: Sequence[str]) -> bool:
    is_same = len({*texts}) == 1 < len(texts)  # as the date of an export
    return all(map(is_numeric, texts)) or all(map(is_duration, texts)) or bool(not is_same and date_formats(texts))


def _are_words(texts: Sequence[str]) -> bool:
    return not are_numbers(texts)


def _are_whole(texts: Sequence[str]) -> bool:
    return all(map(WHOLE.fullmatch, filter(None, texts)))


_FITS: dict[str, Callable[[Sequence[str]], bool]] = {
    "clock.field": _are_times,
    "clock.begin": _are_times,
    "probability": are_numbers,
    "reward": are_numbers,
    "action": lambda texts: _are_words(texts) or (_are_whole(texts) and len(set(texts)) <= MOST_NUMBERED),
    "topic": _are_words,
    "ending": lambda texts: not date_formats(list(filter(None, texts))) and (_are_words(texts) or _are_whole(texts)),
}
"""What the cells of a key must be, besides the name of the column."""


def date_formats(texts: Sequence[str]) -> list[str]:
    """The date formats that fit all of the first texts; none if they are not dates."""
    some = pd.Series(list(dict.fromkeys(texts))[:_ROWS_LOOKED_AT], dtype=object)
    if some.map(lambda text: ISO.fullmatch(text) is not None).all():
        return ["ISO8601"]
    if (compact := compact_format(some.iloc[0])) is not None:
        return [compact] if {*map(compact_format, some)} == {compact} else []
    if ":" not in some.iloc[0]:
        return []
    days = [f"{day} {time}" for day in _DAYS for time in _TIMES]
    ways = [*days, *(f"{way}%z" for way in days), *_TIMES]

    def fit(ways: list[str], texts: Any) -> list[str]:
        read = {way: pd.to_datetime(texts, format=way, errors="coerce", utc="%z" in way) for way in ways}
        return [way for way, dates in read.items() if dates.notna().all()]

    return fit(fit(ways, some[:1]), some)


def is_known_later(name: str) -> bool:
    """Whether a column is no covariate, because it is known only after the action."""
    return any(like.search(name) for like in (LIKE["ending"], END_TIME_LIKE, _OTHERS["later"]))


def events_like(topics: Sequence[str]) -> dict[str, list[str]]:
    """The events of each key; one of an action's result is no action, and one of its beginning or end no ending."""
    like = {key: list(filter(pattern.search, topics)) for key, pattern in EVENTS_LIKE.items()}
    for key, other in (("action", "reward"), ("trajectory", "action"), ("ending", "action")):
        like[key] = [one for one in like[key] if one not in like[other]] or like[key]
    return like
