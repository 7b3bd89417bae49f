"""A draft mapping guessed from the names and cells of a table, with each guess marked."""

import json
import re
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import msgspec
import pandas as pd

from halfseen.errors import LogError
from halfseen.logs.columns import STAGE_COLUMNS, shown
from halfseen.logs.formats.column_words import (
    BEGIN_LIKE,
    END_TIME_LIKE,
    EVENTS_LIKE,
    FINISHED_LIKE,
    FLAGS_LIKE,
    KNOWN_LATER,
    LIKE,
)
from halfseen.logs.formats.ending_flags import are_flags
from halfseen.logs.formats.event_doubts import MISSING_TEXTS
from halfseen.logs.formats.layout_lines import layout_lines, quoted
from halfseen.logs.formats.table_cells import (
    ROW,
    TEXT_FILES,
    WORKBOOKS,
    Cells,
    heading_of,
    kind_of_table,
    read_cells,
    refuse_empty,
    without_missing,
)
from halfseen.logs.formats.table_mapping import TextLayout
from halfseen.logs.formats.table_values import (
    ISO,
    TIME_OF_DAY,
    dates_and_times,
    is_numeric,
    joined,
    thousands_mark,
)
from halfseen.logs.formats.wide_guess import Wide, guessed_wide
from halfseen.logs.formats.wide_tables import STAGE

_DAYS = ("%d.%m.%Y", "%d/%m/%Y", "%m/%d/%Y", "%Y/%m/%d", "%d-%m-%Y", "%m-%d-%Y", "%d.%m.%y", "%d/%m/%y", "%m/%d/%y")
_DAYS += ("%d-%b-%Y", "%d-%b-%y")
_TIMES = ("%H:%M:%S", "%H:%M:%S.%f", "%H:%M:%S,%f", "%H:%M", "%I:%M:%S %p", "%I:%M:%S.%f %p", "%I:%M %p")
_ROWS_LOOKED_AT = 1000


def mapping_of(file: str | Path) -> str:
    """Draft a mapping for a table, to be checked and completed by its owner; every guess is marked.

    Raises
    ------
    LogError
        The table cannot be read.
    """
    cells = _read(Path(file))
    parts: dict[str, list[str]] = {}
    whole = cells
    for both in dates_and_times(cells):
        whole, name = joined(whole, both)
        parts[name] = both
    used = {name for both in parts.values() for name in both}
    columns = {name: whole.columns[name] for name in (*parts, *cells.columns) if name not in used}
    cells = replace(cells, columns=columns)
    wide = guessed_wide(cells)
    cells, found = (cells, _guessed(cells, {})) if wide is None else _guessed_of(wide)
    return "\n".join(_template(cells, str(file), found, parts, wide)) + "\n"


def _guessed_of(wide: Wide) -> tuple[Cells, dict[str, str]]:
    """The rows of stages of a wide table, and the columns of their keys; only a column by stage is a clock."""
    by_stage = replace(wide.cells, columns={name: wide.cells.columns[name] for name in wide.staged if name != STAGE})
    times = {key: name for key, name in _guessed(by_stage, wide.found).items() if key.startswith("clock")}
    kept = wide.cells.columns.keys() - ({STAGE} if times else set())
    cells = replace(wide.cells, columns={name: texts for name, texts in wide.cells.columns.items() if name in kept})
    return cells, _guessed(cells, {"clock.field": STAGE, **wide.found, **times})


def _read(file: Path) -> Cells:
    """Read a table whose heading may be below other lines; find its thousands separator and texts of missing values."""
    try:
        cells = refuse_empty(read_cells(file, TextLayout()))
    except LogError:
        heading = heading_of(file) if kind_of_table(file) in (*TEXT_FILES, *WORKBOOKS) else 1
        if heading == 1:
            raise
        cells = refuse_empty(read_cells(file, TextLayout(heading=heading)))
    texts = {text for column in cells.columns.values() for text in column}
    layout = {"thousands": thousands_mark(cells), "missing": [text for text in MISSING_TEXTS if text in texts]}
    cells = replace(cells, layout=msgspec.structs.replace(cells.layout, **layout))
    return without_missing(cells, cells.layout.missing)


def _guessed(cells: Cells, given: dict[str, str]) -> dict[str, str]:
    """The column of each key for which one matches, besides those given."""
    found = _flags(cells) | _span(cells) | given
    known = {*found} | ({"ending"} if "ending.finished" in found else set())
    known |= {"topic"} if "clock.begin" in found else set()
    for key, like in LIKE.items():
        if key in known:
            continue
        for name, texts in cells.columns.items():
            there = [text for text in texts if text]
            if name in found.values() or not there or not re.search(like, name, re.IGNORECASE):
                continue
            are_numbers = all(map(is_numeric, there))
            are_times = len(there) == len(texts) and _are_times(texts)
            is_fit = {
                "probability": are_numbers,
                "reward": are_numbers,
                "action": not are_numbers,
                "topic": not are_numbers,
                "ending": not _date_formats(there),
            }
            if are_times if key.startswith("clock") else is_fit.get(key, True):
                found[key] = name
                break
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
    end = next((name for name in times if name != begin and END_TIME_LIKE.search(name)), None)
    return {} if begin is None or end is None else {"clock.begin": begin, "clock.field": end}


def _are_times(texts: Sequence[str]) -> bool:
    return all(map(is_numeric, texts)) or bool(_date_formats(texts))


def _other_times(cells: Cells, found: dict[str, str]) -> dict[str, str]:
    """A column of times not found by its name; with one row per stage, also the end if the one found is a beginning."""
    times = (name for name in cells.columns if name not in found.values() and _date_formats(cells.columns[name]))
    first = found.get("clock.field") or next(times, None)
    is_begin = first is not None and BEGIN_LIKE.search(first) is not None
    if is_begin and not {"topic", "clock.begin"} & set(found) and (end := next(times, None)) is not None:
        return {"clock.begin": str(first), "clock.field": end}
    return {} if first is None else {"clock.field": first}


def _template(
    cells: Cells, file: str, found: dict[str, str], parts: dict[str, list[str]], wide: Wide | None
) -> Iterator[str]:
    """Lines of the mapping."""
    yield f"# What the columns of {file} carry, for: halfseen convert {shlex.quote(file)} --mapping THIS --out LOGS"
    yield "# Each guess is marked: check and fix it, complete what is missing, and leave out what is not recorded."
    yield from (f"# Column {shown(name)} holds {kind}, which is not read." for name, kind in cells.unread.items())
    topics = list(dict.fromkeys(cells.columns[found["topic"]])) if "topic" in found else []
    if wide is not None:
        yield from ("", "# Each row is a trajectory; below, columns by stage are named without their stage.")
        yield f"wide = {quoted(wide.pattern)}  # guess: {', '.join(map(shown, wide.staged[1:]))} are by stage"
    if topics:
        yield from ("", "# Column of events, one row each; without it each row is a stage.")
        yield f"topic = {_guess(cells, found['topic'])}"
        yield f"# There are {', '.join(map(shown, topics[:20]))}."
    if layout := list(layout_lines(cells)):
        yield from ("", "[table]", *layout)
    yield from ("", "[clock]", *_clock_lines(cells, found, bool(topics), parts))
    like = _events_like(topics)
    for key in ("trajectory", "action", "object", "probability", "reward", "ending"):
        topic = [] if key == "trajectory" and key in found else like.get(key, [])
        if key == "ending" and "ending.finished" in found and not topic:
            yield from ("", *_flag_lines(cells, found))
        elif key in found or topic or key in ("action", "reward", "ending"):
            yield from ("", *_entry_lines(cells, key, found, topic))
    yield from _covariate_lines(cells, found, [one for one in topics if not any(one in each for each in like.values())])


def _events_like(topics: list[str]) -> dict[str, list[str]]:
    """The events of each key; one of an action's result is no action, and one of its beginning or end no ending."""
    like = {key: [one for one in topics if re.search(words, one, re.IGNORECASE)] for key, words in EVENTS_LIKE.items()}
    for key, other in (("action", "reward"), ("trajectory", "action"), ("ending", "action")):
        like[key] = [one for one in like[key] if one not in like[other]] or like[key]
    return like


def _clock_lines(cells: Cells, found: dict[str, str], has_topic: bool, parts: dict[str, list[str]]) -> Iterator[str]:
    """Lines of the clock."""
    if "clock.field" not in found:
        yield f'# field = "COLUMN"  # no column looks like times; there are {_names(cells)}'
        return
    name = found["clock.field"]
    yield f"field = {_guessed_time(cells, name, parts)}"
    formats = _date_formats(cells.columns[name])
    if not formats:
        yield f'unit = "{_unit(name, cells.columns[name])}"  # guess: s, ms, us, ns, min, h or d'
        begin = found.get("clock.begin")
        since = 'since = "trajectory"  # guess: numbers count from there, or from the "stage"'
        yield ("# " if has_topic else "") + since if begin is None else f"begin = {_guessed_time(cells, begin, parts)}"
        return
    if len(formats) > 1:
        yield "# The order of day and month cannot be guessed; choose one:"
    yield from (
        f"{'# ' if len(formats) > 1 else ''}format = {quoted(one)}  # guess" for one in formats if one != "ISO8601"
    )
    if all(map(TIME_OF_DAY.fullmatch, cells.columns[name])):
        yield "# They have no date: the next day begins where they fall back past midnight."
        return
    yield '# zone = "Europe/Berlin"  # of times without one, so that the nights on which clocks change are right'
    if not has_topic:
        yield "# Column of the time at which a stage began."
        begin = found.get("clock.begin")
        yield (
            '# begin = "COLUMN"  # no column looks like it'
            if begin is None
            else f"begin = {_guessed_time(cells, begin, parts)}"
        )


def _unit(name: str, texts: Sequence[str]) -> str:
    """The unit of a column's name; or of dates as a spreadsheet counts them since 1900, or others since 1970."""
    unit = re.search(r"(?<![a-z])(ms|us|ns|min|s|h|d)(?:ays?)?\W*$", name)
    are_days = all(re.fullmatch(r"[2-7]\d{4}[.,]\d+", text) for text in texts)
    lengths = {len(re.split("[.,]", text)[0]) for text in texts}
    return unit[1] if unit else "d" if are_days else {13: "ms", 16: "us", 19: "ns"}.get(min(lengths), "s")


def _guessed_time(cells: Cells, name: str, parts: dict[str, list[str]]) -> str:
    """The guessed columns of a time."""
    return _guess(cells, name).replace(quoted(name), json.dumps(parts.get(name, name), ensure_ascii=False), 1)


def _entry_lines(cells: Cells, key: str, found: dict[str, str], topic: list[str]) -> Iterator[str]:
    """Lines of one table of the mapping."""
    rows = _rows(cells, found, topic)
    column = _filled(cells, found, key, rows) if topic else found.get(key)
    if column is None and not topic:
        yield from (f"# [{key}]", f'# field = "COLUMN"  # no column looks like it; there are {_names(cells)}')
        if key == "ending" and "topic" not in found:
            yield '# finished = "rewarded"  # if every trajectory finished whose last stage has a reward'
        return
    yield f"[{key}]"
    if topic:
        yield f"topic = [{', '.join(map(quoted, topic))}]  # guess: these events carry it"
    if column is not None:
        yield f"field = {_guess(cells, column, rows)}"
    texts = topic if column is None else list(dict.fromkeys(cells.columns[column][row] for row in rows))
    if key == "ending":
        ends = [text for text in texts if FINISHED_LIKE.search(text)] or [text for text in texts if not text]
        yield f'finished = [{", ".join(map(quoted, ends))}]  # guess: endings that are not cuts, "" for an empty cell'
    elif key == "action" or (key == "reward" and not all(map(is_numeric, filter(None, texts)))):
        names = list(map(quoted, filter(None, texts)))[: 1 if key == "action" else 20]
        pairs = ", ".join(f"{name} = {name if key == 'action' else '1.0'}" for name in names)
        meaning = "its action, if that has another name" if key == "action" else "what each earns"
        yield f"# values = {{{pairs}}}  # {meaning}"


def _flag_lines(cells: Cells, found: dict[str, str]) -> Iterator[str]:
    """Lines of an ending given by flags."""
    yield "[ending]"
    for key in FLAGS_LIKE:
        if key in found:
            name, guess = _guess(cells, found[key]).split("  # ", 1)
            yield f"{key.removeprefix('ending.')} = {{field = {name}}}  # {guess}"


def _covariate_lines(cells: Cells, found: dict[str, str], topics: list[str]) -> Iterator[str]:
    """Lines of the remaining columns as covariates."""
    free = [name for name in cells.columns if name not in (*found.values(), ROW)]
    for name in [] if "topic" in found else free:
        lines = f"[covariates.{_key(name)}]", f"field = {_guess(cells, name)}"
        if KNOWN_LATER.search(name):
            yield from ("", "# Its name suggests a value known only after the action; such a value is not a covariate.")
            yield from (f"# {line}" for line in lines)
        else:
            yield from ("", *lines)
    for topic in topics:
        rows = _rows(cells, found, [topic])
        column = _filled(cells, found, "covariates", rows)
        if column is not None:
            yield from ("", f"[covariates.{_key(topic)}]", f"topic = {quoted(topic)}  # guess: this event carries it")
            yield f"field = {_guess(cells, column, rows)}"


def _rows(cells: Cells, found: dict[str, str], topic: list[str]) -> list[int]:
    """Rows of the given events, or all rows."""
    return [row for row in range(len(cells.rows)) if not topic or cells.columns[found["topic"]][row] in topic]


def _filled(cells: Cells, found: dict[str, str], key: str, rows: list[int]) -> str | None:
    """A column that is filled in all given rows: the one found for the key, or else the first."""
    others = {found.get(other) for other in ("topic", "clock.field", "trajectory") if other != key}
    others |= {name for name, texts in cells.columns.items() if len(texts) > 1 and len(set(texts)) == 1}
    ways = [name for name in cells.columns if name not in others and all(cells.columns[name][row] for row in rows)]
    numeric = [name for name in ways if all(is_numeric(cells.columns[name][row]) for row in rows)]
    texts = [name for name in ways if name not in numeric]
    ways = {"reward": numeric, "action": texts}.get(key) or ways
    return found[key] if found.get(key) in ways else next(iter(ways), None)


def _guess(cells: Cells, name: str, rows: Sequence[int] | None = None) -> str:
    texts = cells.columns[name] if rows is None else [cells.columns[name][row] for row in rows]
    return f"{quoted(name)}  # guess: such as {' and '.join(map(shown, list(filter(None, dict.fromkeys(texts)))[:2]))}"


def _names(cells: Cells) -> str:
    return ", ".join(map(shown, cells.columns))


def _key(name: str) -> str:
    named = f"{name}_before" if name in STAGE_COLUMNS else name
    return named if re.fullmatch(r"[A-Za-z0-9_-]+", named) else quoted(named)


def _date_formats(texts: Sequence[str]) -> list[str]:
    """The date formats that fit all of the first texts; none if they are not dates."""
    some = pd.Series(list(dict.fromkeys(texts))[:_ROWS_LOOKED_AT], dtype=object)
    if some.map(lambda text: ISO.fullmatch(text) is not None).all():
        return ["ISO8601"]
    if ":" not in some.iloc[0]:
        return []
    days = [f"{day} {time}" for day in _DAYS for time in _TIMES]
    ways = [*days, *(f"{way}%z" for way in days), *_TIMES]
    likely = [
        way for way in ways if pd.notna(pd.to_datetime(some.iloc[0], format=way, errors="coerce", utc="%z" in way))
    ]
    return [way for way in likely if pd.to_datetime(some, format=way, errors="coerce", utc="%z" in way).notna().all()]
