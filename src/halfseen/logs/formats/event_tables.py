"""Logs from any table of events (one row per event) or of stages (one row per stage), by a mapping file.

A mapping has the same tables as for bags (`halfseen.logs.formats.bags`), and rows become stages as messages do:
``field`` is a column, and ``topic`` a row's text in the column of events. Without a column of events each row is a
stage, and an empty cell carries no value. If trajectories have a column, each of their rows advances their clock,
mapped or not. A trajectory without an ending was cut: "log ended". A clock of numbers may start again where an event
begins a trajectory, as that of a controller does when it is restarted.
"""

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from halfseen.errors import ArgumentError, LogError, warn
from halfseen.logs.columns import shown
from halfseen.logs.formats import event_doubts, table_values
from halfseen.logs.formats.bag_messages import EARLIEST_DATE_NS, JITTER_NS, Event
from halfseen.logs.formats.bags import Trajectory, logs_of, split, usable
from halfseen.logs.formats.empty_cells import filled_down, without_missing
from halfseen.logs.formats.ending_flags import LOG_ENDED, remedy_after_ending, truths, with_ending
from halfseen.logs.formats.later_rewards import OR_LATER, reward_first, warn_of_first_rewards
from halfseen.logs.formats.mapping import NUMBERS
from halfseen.logs.formats.table_cells import Cells, cells_of, check_column, read_cells, refuse_empty
from halfseen.logs.formats.table_mapping import Ending, Entry, EventMapping, read_event_mapping
from halfseen.logs.formats.table_values import Marks, Stamps
from halfseen.logs.formats.wide_tables import one_row_a_stage
from halfseen.logs.logs import Logs
from halfseen.logs.missing import Missing
from halfseen.shapes import Int


def read_event_table(
    source: str | Path | Sequence[Path] | pa.Table,
    mapping: str | Path,
    *,
    place: str = "table",
    missing: Missing = None,
) -> Logs:
    """Read a table of events, or of stages.

    Parameters
    ----------
    source
        A ``.csv``, ``.tsv``, ``.txt`` or ``.parquet`` file, several with the same columns, such as one per day, or an
        Arrow table. Without ``[trajectory]``, each of several files is a trajectory of its name.
    mapping
        File that maps columns.
    place
        Name of an Arrow table, for messages.
    missing
        What replaces null in covariates, as in `Logs`.

    Raises
    ------
    ArgumentError
        The mapping does not fit the table; the message names its file and key.
    LogError
        A file is missing or broken, a cell cannot be read (the message names its line and column), or rows do not form
        stages.
    """
    wanted, file = read_event_mapping(mapping), str(mapping)
    if isinstance(source, pa.Table):
        cells = filled_down(cells_of(place, source), wanted.table.fill_down)
    else:
        cells = _read_files(source, wanted)
    cells, wanted = one_row_a_stage(without_missing(refuse_empty(cells), wanted.table.missing), wanted, file)
    cells, wanted = with_ending(refuse_empty(cells), wanted, file)
    _check_columns(cells, wanted, file)
    event_doubts.warn_of_respelled_events(cells, wanted)
    event_doubts.warn_of_bad_values(cells, wanted)
    cells = _without_repeats(cells, wanted)
    event_doubts.warn_of_repeats(cells, wanted)
    needed = {name: wanted.origin(f"covariates.{name}") for name in wanted.covariates}
    finishing, remedy = wanted.ending.finishing, remedy_after_ending(cells, wanted)
    found, num_stale, late = [], 0, Counter[str]()
    for number, (name, events) in enumerate(_trajectories(cells, wanted, file), start=1):
        late.update(event_doubts.late_covariates(events))
        trajectory = Trajectory(number if name is None else name, needed, finishing, cause=LOG_ENDED, remedy=remedy)
        trajectory.or_later = OR_LATER if wanted.topic is None else ""
        trajectory.follow(events)
        num_stale += wanted.topic is None and event_doubts.is_stale(trajectory, events)
        found.append(trajectory)
    found = usable(cells.file, found)
    event_doubts.warn_of_stale(cells, wanted, num_stale)
    event_doubts.warn_of_late(cells, wanted, late)
    event_doubts.warn_of_codes(cells, wanted, found)
    if wanted.clock.since == "trajectory":
        event_doubts.warn_of_running_clock(cells, wanted.clock, found)
    return logs_of(cells.file, file, found, missing=missing)


def _read_files(source: str | Path | Sequence[Path], mapping: EventMapping) -> Cells:
    """Read one file, or several and concatenate their rows."""
    if isinstance(source, str | Path):
        return filled_down(read_cells(Path(source), mapping.table), mapping.table.fill_down)
    folder = os.path.commonpath([file.parent for file in source])
    tables = [read_cells(file, mapping.table) for file in source if not file.is_file() or file.stat().st_size]
    tables = [filled_down(each, mapping.table.fill_down) for each in tables if len(each.rows)]
    if empty := sorted({*map(str, source)} - {each.file for each in tables}):
        warn(empty[0], f"{len(empty)} of {len(source)} files have no rows, and are skipped; this is the first")
    if not tables:
        raise LogError(f"{folder}: all its tables are empty; give at least one with rows")
    first, *others = tables
    event_doubts.refuse_copies(tables if mapping.trajectory is not None else ())
    for each in others:
        differing = sorted(each.columns.keys() ^ first.columns.keys())
        if differing or each.layout.separator != first.layout.separator:
            is_other_kind = None in (each.layout.separator, first.layout.separator)
            written = "another kind of file" if is_other_kind else "another separator"
            names = ", ".join(map(shown, differing)) or written
            raise LogError(
                f"{each.file}: its columns differ from those of {first.file} ({names}); convert each separately"
            )
    columns = {name: [text for each in tables for text in each.columns[name]] for name in first.columns}
    are_alone = len({Path(each.file).name for each in tables}) == len(tables)
    names = [Path(each.file).name if are_alone else each.file for each in tables]
    places = [f"{name}, {each.word} {row}" for name, each in zip(names, tables, strict=True) for row in each.rows]
    unread = {name: kind for each in tables for name, kind in each.unread.items()}
    return Cells(folder, columns, places, first.layout, "file", unread)


def _check_columns(cells: Cells, mapping: EventMapping, file: str) -> None:
    """Refuse missing columns and events that no row has, except those of endings, which may be missing."""
    topic = [] if mapping.topic is None else [("topic", mapping.topic)]
    for key, name in mapping.clock.columns + topic + [(f"{key}.field", mapping.column(key)) for key in mapping.entries]:
        check_column(cells, name, f"{file}, {key}")
    there = set(cells.columns[mapping.topic]) if mapping.topic is not None else set()
    for key, entry in mapping.entries.items():
        if not entry.topics or there & set(entry.topics):
            continue
        trouble = f"no event of {cells.file} is {' or '.join(map(shown, entry.topics))}"
        if key != "ending":
            raise ArgumentError(f"{file}, {key}.topic: {trouble}; there are {', '.join(sorted(there)[:20])}")
        warn(f"{file}, ending.topic", f"{trouble}, so that every trajectory counts as cut by {LOG_ENDED!r}")


def _without_repeats(cells: Cells, mapping: EventMapping) -> Cells:
    """Drop events that repeat the row before, time included, as written by programs that send twice.

    And rows with a date that another file has, too, as exports of days overlap.
    """
    whole = list(zip(*cells.columns.values(), strict=True))
    repeats = [row for row in range(1, len(whole)) if mapping.topic is not None and whole[row] == whole[row - 1]]
    of_which = "the one before it"
    if cells.word == "file" and mapping.trajectory is not None and mapping.clock.has_dates:
        files = [str(row).rpartition(", ")[0] for row in cells.rows]
        first = dict(zip(reversed(whole), reversed(files), strict=True))
        again = [row for row, file in enumerate(files) if first[whole[row]] != file]
        repeats, of_which = sorted({*repeats, *again}), "one of another file" if again else of_which
    if not repeats:
        return cells
    warn(cells.place(repeats[0]), f"it repeats {of_which}; such rows are skipped: {len(repeats)}")
    kept = sorted({*range(len(whole))} - {*repeats})
    columns = {name: [texts[row] for row in kept] for name, texts in cells.columns.items()}
    return replace(cells, columns=columns, rows=[cells.rows[row] for row in kept])


def _trajectories(cells: Cells, mapping: EventMapping, file: str) -> Iterator[tuple[Any, list[Event]]]:
    """Name and events of each trajectory."""
    marks = table_values.marks_of(cells, _columns_of_numbers(mapping))
    stamps, begins = _times(cells, mapping, marks, file)
    values_of = _values(cells, mapping, marks)
    has_begins, since, finishing = mapping.has_begins, mapping.clock.since, mapping.ending.finishing
    ending_texts = cells.columns[mapping.column("ending")]
    groups = _groups(cells, mapping, values_of, stamps)
    event_doubts.warn_of_rows_apart(cells, groups, stamps, mapping)
    event_doubts.warn_of_reordered(cells, groups, stamps, mapping)
    if begins is not None:
        event_doubts.warn_of_overlaps(cells, groups, begins, stamps)
    early: list[int] = []
    for name, unordered in groups.items():
        rows, times = _in_order(unordered, stamps, mapping)
        events = [] if begins is None or has_begins else [Event(int(begins[rows[0]]), "begin", None)]
        for row, time in zip(rows, times.tolist(), strict=True):
            place = f"{cells.place(row)}: "
            # An empty ending counts only in the last row: nothing ended the trajectory.
            is_blank = not mapping.ending.topics and not ending_texts[row] and row != rows[-1]
            here = [pair for pair in values_of[row] if not (is_blank and pair[0] == "ending")]
            if mapping.is_rewarded_later:
                here = reward_first(here, finishing)
                if row == rows[0] and here[:1] and here[0][0] == "reward":
                    early += [row] if here.pop(0)[1] else []
            events += [Event(time, key, value, place) for key, value in here]
            events += [] if has_begins else [Event(time, "row", None, place)]
        if not has_begins:
            yield name, events
            continue
        event_doubts.warn_of_early(cells, events, mapping.kept)
        for begun, following in split(Path(cells.file), [events], mapping.column("trajectory"), file, mapping.kept):
            yield begun, following if since is None else [Event(0, "begin", None), *following]
    warn_of_first_rewards(cells, early)


def _columns_of_numbers(mapping: EventMapping) -> list[str]:
    keys = [key for key, one in mapping.entries.items() if key in NUMBERS or ("." in key and one.type != "text")]
    times = [name for _, name in mapping.clock.columns] if mapping.clock.unit is not None else []
    return list(dict.fromkeys([mapping.column(key) for key in keys] + times))


def _times(cells: Cells, mapping: EventMapping, marks: Marks, file: str) -> tuple[Stamps, Stamps | None]:
    """Times of the rows and, if known, of the beginnings of their stages [ns]."""
    clock = mapping.clock
    event_doubts.refuse_one_zone(cells, clock)
    try:
        stamps = table_values.stamps_ns(cells, clock.fields, clock, marks)
        begins = table_values.stamps_ns(cells, clock.begins, clock, marks) if clock.begins else None
    except ArgumentError as error:
        raise ArgumentError(f"{file}, {error}") from error
    begins = begins if clock.since is None else np.zeros_like(stamps)
    event_doubts.refuse_unset(cells, stamps, clock)
    if begins is not None and (begins > stamps).any():
        cells.refuse(int(np.argmax(begins > stamps)), clock.fields[-1], "is before its beginning; fix one of them")
    return stamps, begins


def _values(cells: Cells, mapping: EventMapping, marks: Marks) -> list[list[tuple[str, Any]]]:
    """Keys of the mapping and values in each row, in the order in which they apply."""
    values_of: list[list[tuple[str, Any]]] = [[] for _ in cells.rows]
    for key, entry in mapping.entries.items():
        if key == "trajectory" and not mapping.has_begins:
            continue
        column = mapping.column(key)
        rows = _rows_that_tell(cells, mapping, key)
        is_numbered = key == "trajectory" and entry.field is None
        values = [None] * len(rows) if is_numbered else _read(cells, key, entry, column, rows, marks)
        for row, value in zip(rows, values, strict=True):
            values_of[row].append((key, value))
    return values_of


def _rows_that_tell(cells: Cells, mapping: EventMapping, key: str) -> list[int]:
    """Rows that carry a value."""
    entry, texts = mapping.entries[key], cells.columns[mapping.column(key)]
    if mapping.topic is not None and entry.topics:
        topics, wanted = cells.columns[mapping.topic], set(entry.topics)
        return [row for row, topic in enumerate(topics) if topic in wanted]
    is_needed = mapping.topic is None and "." in key
    is_needed |= "" in entry.values or (key == "ending" and "" in mapping.ending.finishing)
    return [row for row, text in enumerate(texts) if text or is_needed]


def _read(cells: Cells, key: str, entry: Entry, column: str, rows: Sequence[int], marks: Marks) -> list[Any]:
    """Read the cells of one column: numbers, or names, as whole numbers if all are; a covariate may be null."""
    texts, known, is_covariate = cells.columns[column], entry.values, "." in key
    named = [*known, *(entry.finishing if isinstance(entry, Ending) else ())]
    event_doubts.refuse_respelled(cells, rows, column, named)
    first = next((known.get(texts[row], texts[row]) for row in rows if texts[row]), "")
    has_text = any(
        isinstance(value, str) and table_values.plain_number(value, marks) is None for value in known.values()
    )
    has_text |= isinstance(first, str) and not table_values.is_numeric(first)
    if key in NUMBERS or (is_covariate and (entry.type or ("text" if has_text else "number")) == "number"):
        return [
            float(known[text])
            if (text := texts[row]) in known
            else float("nan")
            if not text and is_covariate
            else table_values.number_at(cells, row, column, marks)
            for row in rows
        ]
    if key != "ending" and not is_covariate and "" not in known:
        event_doubts.refuse_blank(cells, rows, column, key)
    if is_covariate and entry.type is None:
        table_values.refuse_most_numbers(cells, [row for row in rows if texts[row] not in known], column)
    event_doubts.refuse_missing_like(cells, rows, column, named, key)
    if is_covariate and entry.type is None and not known:
        return truths([texts[row] for row in rows]) or [texts[row] or None for row in rows]
    if is_covariate:
        return [str(known[text]) if (text := texts[row]) in known else text or None for row in rows]
    names = [str(known.get(texts[row], texts[row])) for row in rows]
    if key == "ending":
        return names
    event_doubts.refuse_rounded(cells, rows, column)
    return table_values.whole_numbers(names) or names


def _groups(
    cells: Cells, mapping: EventMapping, values_of: list[list[tuple[str, Any]]], stamps: Stamps
) -> dict[Any, list[int]]:
    """Rows by the name of their trajectory; by the run of their clock if events begin trajectories."""
    steps = np.diff(stamps)
    is_newest_first = mapping.clock.since is None and bool((steps <= 0).all() and (steps < 0).any())
    order = range(len(stamps))[:: -1 if is_newest_first else 1]
    is_date = mapping.clock.unit is None or bool((stamps >= EARLIEST_DATE_NS).any())
    if mapping.has_begins and mapping.clock.since is None and not is_date:
        runs = _runs(list(order), stamps, values_of)
        for first, *_ in runs[1:2]:
            trouble = f"the clock restarts where a trajectory begins, {len(runs) - 1:,} times in all"
            warn(cells.place(first), f"{trouble}; rows below count as later")
        return dict(enumerate(runs))
    if mapping.has_begins or (mapping.trajectory is None and cells.word != "file"):
        return {None: list(order)}
    if mapping.trajectory is None:
        return {name: list(rows) for name, rows in groupby(order, lambda row: str(cells.rows[row]).rpartition(", ")[0])}
    column = mapping.column("trajectory")
    texts = cells.columns[column]
    rows = [row for row in order if texts[row] or values_of[row]]
    groups: dict[Any, list[int]] = {}
    for row, name in zip(rows, _read(cells, "trajectory", mapping.trajectory, column, rows, Marks()), strict=True):
        groups.setdefault(name, []).append(row)
    return _oldest_first(groups, stamps) if mapping.clock.since is None else groups


def _oldest_first(groups: dict[Any, list[int]], stamps: Stamps) -> dict[Any, list[int]]:
    """Turn all groups around if each has its newest row first."""
    steps = np.concatenate([np.diff(stamps[rows]) for rows in groups.values()])
    return {name: rows[::-1] for name, rows in groups.items()} if (steps <= 0).all() and (steps < 0).any() else groups


def _runs(rows: list[int], stamps: Stamps, values_of: list[list[tuple[str, Any]]]) -> list[list[int]]:
    """Split rows where the clock falls back, and stays back until a trajectory begins, as where a controller starts."""
    runs, highest = [rows[:1]], int(stamps[rows[0]])
    for k in range(1, len(rows)):
        time_ns, limit_ns = int(stamps[rows[k]]), highest - JITTER_NS
        if time_ns < limit_ns and _begins_below(k, limit_ns, rows, stamps, values_of):
            runs.append([])
            highest = time_ns
        runs[-1].append(rows[k])
        highest = max(highest, time_ns)
    return runs


def _begins_below(
    k: int, limit_ns: int, rows: list[int], stamps: Stamps, values_of: list[list[tuple[str, Any]]]
) -> bool:
    """Whether a trajectory begins from row k on, before anything else is done and the clock reaches a limit [ns]."""
    for at in range(k, len(rows)):
        keys = {key for key, _ in values_of[rows[at]]}
        if stamps[rows[at]] >= limit_ns or keys & {"trajectory", "action", "reward", "ending"}:
            return "trajectory" in keys and bool(stamps[rows[at]] < limit_ns)
    return False


def _in_order(rows: list[int], stamps: Stamps, mapping: EventMapping) -> tuple[list[int], Int[np.ndarray, " some"]]:
    """Sort rows by their clock, stable for equal times; with these times [ns]."""
    since, times = mapping.clock.since, stamps[rows]
    if since == "stage":
        return rows, np.cumsum(times)
    order = np.argsort(times, kind="stable") if since is None or not mapping.has_begins else np.arange(len(rows))
    return [rows[k] for k in order.tolist()], times[order]
