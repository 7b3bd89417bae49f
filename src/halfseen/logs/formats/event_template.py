"""A draft mapping guessed from the names and cells of a table, with each guess marked."""

import json
import re
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import msgspec

from halfseen.errors import LogError
from halfseen.logs.columns import STAGE_COLUMNS, shown
from halfseen.logs.folder import TEXT_FILES, WORKBOOKS
from halfseen.logs.formats import guesses
from halfseen.logs.formats.bag_messages import EARLIEST_DATE_NS
from halfseen.logs.formats.durations import LASTED_SHORT, is_duration
from halfseen.logs.formats.empty_cells import without_missing
from halfseen.logs.formats.guesses import Guesses, are_numbers
from halfseen.logs.formats.table_cells import (
    ROW,
    Cells,
    heading_of,
    kind_of_table,
    read_cells,
    refuse_empty,
)
from halfseen.logs.formats.table_mapping import TextLayout
from halfseen.logs.formats.table_values import (
    MISSING_TEXTS,
    NANOSECONDS,
    TIME_OF_DAY,
    is_numeric,
    marks_of,
    thousands_mark,
)
from halfseen.logs.formats.wide_tables import STAGE

_NO_TOPIC = '# topic = "EVENT"  # no event looks like it; if one carries it, name both'
_UNIT_WORDS = {
    "ms": "milli(s|secs?|seconds?)|(?-i:[a-z]Ms)",
    "us": "micro(s|secs?|seconds?)",
    "ns": "nano(s|secs?|seconds?)",
}
_UNIT_WORDS |= {"s": "secs?|seconds?|sekunden", "min": "mins?|minutes?|minuten", "h": "hrs?|hours?|stunden"}
_UNIT_WORDS |= {"d": "days?|dy|(?<!s)tage?"}
_NO_BEGIN = '# begin = "COLUMN"  # no column looks like it'


def mapping_of(file: str | Path, source: str | Path | None = None) -> str:
    """Draft a mapping for a table, to be checked and completed by its owner; every guess is marked.

    Parameters
    ----------
    file
        The table.
    source
        What the mapping is for: the table, or its folder; None for the table.

    Raises
    ------
    LogError
        The table cannot be read.
    """
    return "\n".join(_template(str(file), str(source or file), guesses.guessed(_read(Path(file))))) + "\n"


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


def _template(file: str, source: str, table: Guesses) -> Iterator[str]:
    """Lines of the mapping."""
    cells, found = table.cells, table.found
    yield f"# What the columns of {file} carry, for: halfseen convert {shlex.quote(source)} --mapping THIS --out LOGS"
    yield "# Each guess is marked: check and fix it, complete what is missing, and leave out what is not recorded."
    yield from (f"# Column {shown(name)} holds {kind}, which is not read." for name, kind in cells.unread.items())
    topics = list(dict.fromkeys(cells.columns[found["topic"]])) if "topic" in found else []
    if table.pattern:
        yield from ("", "# Each row is a trajectory; below, columns by stage are named without their stage.")
        yield f"wide = {_quoted(table.pattern)}  # guess: {', '.join(map(shown, table.staged))} are by stage"
    if topics:
        yield from ("", "# Column of events, one row each; without it each row is a stage.")
        yield f"topic = {_guess(cells, found['topic'])}"
        yield f"# There are {', '.join(map(shown, topics[:20]))}."
    if layout := list(_layout_lines(cells)):
        yield from ("", "[table]", *layout)
    yield from ("", "[clock]", *_clock_lines(table, bool(topics)))
    like = guesses.events_like(topics)
    for key in ("trajectory", "action", "object", "probability", "reward", "ending"):
        topic = [] if key == "trajectory" and key in found else like.get(key, [])
        if key == "ending" and "ending.finished" in found and not topic:
            yield from ("", *_flag_lines(cells, found))
        elif key in found or topic or key in ("trajectory", "action", "reward", "ending"):
            yield from ("", *_entry_lines(cells, key, found, topic))
        if key == "trajectory" and topic:
            found = found | _of_names_alone(cells, found, _rows(cells, found, topic))
    yield from _covariate_lines(cells, found, [one for one in topics if not any(one in each for each in like.values())])


def _layout_lines(cells: Cells) -> Iterator[str]:
    """Lines of the layout of the file."""
    layout = cells.layout
    if layout.separator is not None:
        yield f"separator = {_quoted(layout.separator)}  # guess"
        yield f"encoding = {_quoted(str(layout.encoding))}  # guess: utf-8, cp1252, utf-16, shift_jis, gbk, …"
        try:
            decimal = marks_of(cells, list(cells.columns)).decimal
            yield f'decimal = {_quoted(decimal)}  # guess: decimal mark, "," or "."'
        except LogError:
            yield '# decimal = ","  # the decimal mark, which cannot be guessed: "," or "."'
    if layout.thousands is not None:
        yield f"thousands = {_quoted(layout.thousands)}  # guess: between groups of three digits"
    if layout.missing:
        yield f"missing = [{', '.join(map(_quoted, layout.missing))}]  # guess: texts of empty cells"
    if layout.heading > 1:
        yield f"heading = {layout.heading}  # guess: the line that names the columns"


def _clock_lines(table: Guesses, has_topic: bool) -> Iterator[str]:
    """Lines of the clock."""
    cells, found = table.cells, table.found
    if "clock.field" not in found:
        yield f'# field = "COLUMN"  # no column looks like times; there are {_names(cells)}'
        return

    def time(key: str) -> str:
        """The guessed columns of a time."""
        name = found[key]
        written = json.dumps(table.parts.get(name, name), ensure_ascii=False)
        return f"{key.removeprefix('clock.')} = {_guess(cells, name).replace(_quoted(name), written, 1)}"

    texts = list(filter(None, cells.columns[found["clock.field"]]))
    yield time("clock.field")
    formats = guesses.date_formats(texts)
    begin = time("clock.begin") if "clock.begin" in found else None
    are_lasting = not has_topic and begin is None and all(map(is_duration, texts)) and not _runs_on(table, texts)
    if not formats or are_lasting:
        yield from _count_lines(table, texts, begin, has_topic)
        return
    if len(formats) > 1:
        yield "# The order of day and month cannot be guessed; choose one:"
    mark = "# " if len(formats) > 1 else ""
    yield from (f"{mark}format = {_quoted(one)}  # guess" for one in formats if one != "ISO8601")
    if all(map(TIME_OF_DAY.fullmatch, texts)):
        yield "# They have no date: the next day begins where they fall back past midnight."
        return
    yield '# zone = "Europe/Berlin"  # of times without one, so that the nights on which clocks change are right'
    if not has_topic:
        yield "# Column of the time at which a stage began."
        yield begin or _NO_BEGIN


def _count_lines(table: Guesses, texts: Sequence[str], begin: str | None, has_topic: bool) -> Iterator[str]:
    """Lines of a clock of numbers, or of hours, minutes and seconds since a beginning."""
    if any(map(LASTED_SHORT.fullmatch, texts)):
        yield 'unit = "min"  # guess: of minutes and seconds, as in 1:30; "h" of hours and minutes'
    elif not all(map(is_duration, texts)):
        unit = _unit(table.found["clock.field"], texts)
        yield f'unit = "{unit}"  # guess: s, ms, us, ns, min, h or d'
        earliest = min((parts[0] for parts in map(_parts, texts) if parts), default=0.0)
        if begin is None and not has_topic and earliest * NANOSECONDS[unit] >= EARLIEST_DATE_NS:
            yield _NO_BEGIN
            return
    if begin is not None:
        yield begin
        return
    since, other = ("stage", "trajectory") if _restarts(table, texts) else ("trajectory", "stage")
    hint = f'since = "{since}"  # guess: numbers count from there, or from the "{other}"'
    yield ("# " if has_topic else "") + hint


def _runs_on(table: Guesses, texts: Sequence[str]) -> bool:
    """Whether hours, minutes and seconds seldom fall back from row to row, as those of a clock on the wall."""
    names = table.cells.columns[table.found["trajectory"]] if "trajectory" in table.found else []
    num_falls = sum(after < before for before, after in pairwise(map(_parts, texts)))
    return 2 * num_falls < len(set(names)) - 1 or not num_falls


def _restarts(table: Guesses, texts: Sequence[str]) -> bool:
    """Whether times rise and fall, or stay, within trajectories: each counts from the beginning of its stage."""
    if "trajectory" not in table.found or table.pattern:
        return False
    rows = zip(table.cells.columns[table.found["trajectory"]], map(_parts, texts), strict=True)
    steps = [(before, after) for (one, before), (other, after) in pairwise(rows) if one == other]
    return any(after <= before for before, after in steps) and any(after >= before for before, after in steps)


def _parts(text: str) -> list[float]:
    """The numbers in a time."""
    return [float(part) for part in re.findall(r"\d+(?:\.\d+)?(?:[eE]-?\d+)?", text.replace(",", "."))]


def _unit(name: str, texts: Sequence[str]) -> str:
    """The unit of a column's name; or of dates as a spreadsheet counts them since 1900, or others since 1970."""
    unit = re.search(r"(?<![A-Za-z])(ms|us|ns|min|s|h|d)\W*$", name)
    word = next((unit for unit, like in _UNIT_WORDS.items() if re.search(rf"({like})\W*$", name, re.IGNORECASE)), None)
    are_days = all(re.fullmatch(r"[2-7]\d{4}[.,]\d+", text) for text in texts) or _are_seconds_in_days(texts)
    lengths = {len(re.split("[.,]", text)[0]) for text in texts}
    by_size = "d" if are_days else {13: "ms", 16: "us", 19: "ns"}.get(min(lengths), "s")
    return unit[1] if unit else word or by_size


def _are_seconds_in_days(texts: Sequence[str]) -> bool:
    """Whether all numbers are fractions of days, of whole seconds, as a workbook holds durations."""
    numbers = [parts[0] for parts in map(_parts, texts) if parts]
    are_long = any(re.search(r"[.,]\d{8}|[eE]-", text) for text in texts)
    return are_long and all(abs(number * 86400.0 - round(number * 86400.0)) < 1e-3 for number in numbers)


def _entry_lines(cells: Cells, key: str, found: dict[str, str], topic: list[str]) -> Iterator[str]:
    """Lines of one table of the mapping."""
    rows = _rows(cells, found, topic)
    column = _filled(cells, found, key, rows) if topic else found.get(key)
    if column is None and not topic:
        hint = f"there are {_names(cells)}" + (
            "; without it, each file is one trajectory" if key == "trajectory" else ""
        )
        yield from (
            f"# [{key}]",
            *[_NO_TOPIC] * ("topic" in found),
            f'# field = "COLUMN"  # no column looks like it; {hint}',
        )
        if key == "ending" and "topic" not in found:
            yield '# finished = "rewarded"  # if every trajectory finished whose last stage has a reward'
        return
    yield f"[{key}]"
    if not topic and "topic" in found and key != "trajectory":
        yield _NO_TOPIC
    if topic:
        yield f"topic = [{', '.join(map(_quoted, topic))}]  # guess: these events carry it"
    if column is not None:
        yield f"field = {_guess(cells, column, rows)}"
    texts = topic if column is None else list(dict.fromkeys(cells.columns[column][row] for row in rows))
    if key == "ending":
        ends = list(filter(guesses.FINISHED_LIKE.search, texts)) or _blank_ends(cells, found, texts)
        yield f'finished = [{", ".join(map(_quoted, ends))}]  # guess: endings that are not cuts, "" for an empty cell'
    elif key == "action" or (key == "reward" and not are_numbers(texts)):
        names = list(map(_quoted, filter(None, texts)))[: 1 if key == "action" else 20]
        pairs = ", ".join(f"{name} = {name if key == 'action' else '1.0'}" for name in names)
        meaning = "its action, if that has another name" if key == "action" else "what each earns"
        yield f"# values = {{{pairs}}}  # {meaning}"
    if key == "reward" and not {"topic", "clock.begin"} & {*found}:
        yield '# row = "next"  # if each row has the reward of the action in the row before'


def _blank_ends(cells: Cells, found: dict[str, str], texts: list[str]) -> list[str]:
    """An empty text, unless each trajectory has another in its last row."""
    names, ends = (cells.columns.get(found.get(key, ""), []) for key in ("trajectory", "ending"))
    is_known = bool(names and ends) and all(dict(zip(names, ends, strict=True)).values())
    return [] if is_known else [text for text in texts if not text]


def _flag_lines(cells: Cells, found: dict[str, str]) -> Iterator[str]:
    """Lines of an ending given by flags."""
    yield "[ending]"
    for key in filter(found.get, guesses.FLAGS_LIKE):
        name, guess = _guess(cells, found[key]).split("  # ", 1)
        yield f"{key.removeprefix('ending.')} = {{field = {name}}}  # {guess}"


def _covariate_lines(cells: Cells, found: dict[str, str], topics: list[str]) -> Iterator[str]:
    """Lines of the remaining columns as covariates."""
    free = [name for name, texts in cells.columns.items() if name not in (*found.values(), ROW) and any(texts)]
    is_timed = found.get("clock.field") != STAGE
    for name in [] if "topic" in found else free:
        lines = f"[covariates.{_key(name)}]", f"field = {_guess(cells, name)}"
        if guesses.is_known_later(name) or not (is_timed or guesses.LIKE["clock.field"].search(name) is None):
            yield from ("", "# Its name suggests a value known only after the action; such a value is not a covariate.")
            yield from (f"# {line}" for line in lines)
        else:
            yield from ("", *lines)
    for topic in topics:
        rows = _rows(cells, found, [topic])
        column = _filled(cells, found, "covariates", rows)
        if column is not None:
            yield from ("", f"[covariates.{_key(topic)}]", f"topic = {_quoted(topic)}  # guess: this event carries it")
            yield f"field = {_guess(cells, column, rows)}"


def _rows(cells: Cells, found: dict[str, str], topic: list[str]) -> list[int]:
    """Rows of the given events, or all rows."""
    return [row for row in range(len(cells.rows)) if not topic or cells.columns[found["topic"]][row] in topic]


def _of_names_alone(cells: Cells, found: dict[str, str], rows: list[int]) -> dict[str, str]:
    """The column of the trajectory's name, if all rows have one of those in the given rows, where one begins."""
    column = _filled(cells, found, "trajectory", rows)
    texts = [] if column is None else cells.columns[column]
    return {"trajectory": column} if column is not None and {*texts} <= {texts[row] for row in rows} else {}


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
    return f"{_quoted(name)}  # guess: such as {' and '.join(map(shown, list(filter(None, dict.fromkeys(texts)))[:2]))}"


def _names(cells: Cells) -> str:
    return ", ".join(map(shown, cells.columns))


def _key(name: str) -> str:
    named = f"{name}_before" if name in STAGE_COLUMNS else name
    return named if re.fullmatch(r"[A-Za-z0-9_-]+", named) else _quoted(named)


def _quoted(text: str) -> str:
    """A text as TOML writes it."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
