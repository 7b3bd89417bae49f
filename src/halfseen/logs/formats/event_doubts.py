"""Doubts about tables of events and of stages: refused where the log would be wrong, otherwise warned of."""

import json
import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import combinations
from typing import Any, TypeAlias

import numpy as np

from halfseen.errors import LogError, warn
from halfseen.logs.columns import CUT, shown
from halfseen.logs.formats.bag_messages import EARLIEST_DATE_NS, Event
from halfseen.logs.formats.bags import Trajectory
from halfseen.logs.formats.guesses import BEGIN_LIKE
from halfseen.logs.formats.table_cells import ROW, Cells
from halfseen.logs.formats.table_mapping import Clock, EventMapping
from halfseen.logs.formats.table_values import MISSING_TEXTS, NANOSECONDS, NO_CAUSES, ZONED, Stamps
from halfseen.suggestions import folded

_ROUNDED = re.compile(r"-?\d([.,]\d+)?[eE]\+\d+")
_GOOD, _BAD = (re.compile(rf"(?<![a-z]){word}", re.IGNORECASE) for word in ("good", "bad|uncertain"))
_GOOD_CODES, _BAD_CODES = ("192", "216"), ["0", "4", "8", "12", "16", "20", "24", "28", "64", "68", "80", "84", "88"]
"""Qualities of values in OPC UA, as text, and in classic OPC."""
MOST_QUALITIES = 50
LEAST_PAUSE_NS, PAUSE = NANOSECONDS["h"], 1000.0
"""A pause within a trajectory is long from here on [ns], and from this many times the usual time between rows on."""
MOST_OVERLAP = 0.1
"""Largest part of a stage that a rounded time may overlap with the next."""
FEWEST_ON_ONE_CLOCK = 5
"""Number of trajectories that show that a clock runs on across trajectories."""


Groups: TypeAlias = Mapping[Any, list[int]]
"""Rows by the name of their trajectory."""


_IS_CODE = re.compile(r"-?\d+(\.0)?|true|false|yes|no", re.IGNORECASE)


def refuse_copies(tables: Sequence[Cells]) -> None:
    """Refuse a file that has the rows of another, whose trajectories would hold each row twice (`LogError`)."""
    for one, other in combinations(tables, 2):
        if one.columns == other.columns:
            raise LogError(f"{other.file}: its rows are those of {one.file}; leave one of the two files out")


def refuse_rounded(cells: Cells, rows: Sequence[int], column: str) -> None:
    """Refuse names that spreadsheets or types of fractions rounded (`LogError`)."""
    is_rounded = column in cells.rounded
    row = next((row for row in rows if is_rounded or _ROUNDED.fullmatch(cells.columns[column][row])), None)
    if row is not None:
        cells.refuse(row, column, "is a rounded number that may stand for several names; export the column as text")


def refuse_blank(cells: Cells, rows: Sequence[int], column: str, key: str) -> None:
    """Refuse an empty cell where there must be a name (`LogError`)."""
    row = next((row for row in rows if not cells.columns[column][row]), None)
    if row is not None:
        merged = f'set fill_down = ["{column}"] in [table] if it repeats the cell above'
        cells.refuse(row, column, f"is not a valid {key}; give one, leave the row out, or {merged}")


def refuse_one_zone(cells: Cells, clock: Clock) -> None:
    """Refuse ends with a zone beside beginnings without one, or the reverse (`LogError`)."""
    if clock.zone is None and clock.format is None and clock.begins:
        ends = (clock.fields[-1], clock.begins[-1])
        without = [column for column in ends if not ZONED.search(cells.columns[column][0])]
        if len(without) == 1:
            cells.refuse(0, without[0], f"has no zone, but column {({*ends} - {*without}).pop()!r} has; set clock.zone")


def refuse_unset(cells: Cells, stamps: Stamps, clock: Clock) -> None:
    """Refuse times of the first day of 1970 or before beside dates of this century (`LogError`)."""
    if len(stamps) and stamps.max() >= EARLIEST_DATE_NS and stamps.min() < NANOSECONDS["d"]:
        trouble = (
            "is a date that a clock has before it is set, and others are of this century; fix it, or leave the row out"
        )
        cells.refuse(int(np.argmin(stamps)), clock.fields[-1], trouble)


def refuse_missing_like(cells: Cells, rows: Sequence[int], column: str, known: Collection[str], key: str) -> None:
    """Refuse a text that other programs write for a missing value (`LogError`), unless the mapping names it."""
    texts, causes = cells.columns[column], {text.lower() for text in (*MISSING_TEXTS, *NO_CAUSES) if key == "ending"}
    found = (row for row in rows if texts[row] in MISSING_TEXTS or texts[row].lower() in causes)
    row = next((row for row in found if texts[row] not in known), None)
    if row is not None:
        named = "values, or in finished" if key == "ending" else "values"
        remedy = f"set missing = {json.dumps([texts[row]])} in [table], or name it in {named}"
        trouble = f"may mean that nothing is there: {remedy}"
        cells.refuse(row, column, trouble)


def refuse_respelled(cells: Cells, rows: Sequence[int], column: str, known: Collection[str]) -> None:
    """Refuse a text that differs only in spelling from one that the mapping names (`LogError`)."""
    spellings = {folded(text): text for text in known if text}
    texts = {cells.columns[column][row]: row for row in rows} if spellings else {}
    for text, row in texts.items():
        meant = spellings.get(folded(text))
        if meant is not None and text not in known:
            cells.refuse(
                row, column, f"differs from {shown(meant)} of the mapping only in spelling; name it there, too"
            )


def warn_of_respelled_events(cells: Cells, mapping: EventMapping) -> None:
    """Warn about events that are not mapped, and whose name differs only in spelling from a mapped one."""
    mapped = {topic for entry in mapping.entries.values() for topic in entry.topics}
    spellings = {folded(topic): topic for topic in mapped}
    events = Counter(cells.columns[mapping.topic]) if mapping.topic is not None and mapped else Counter[str]()
    for event, count in events.items():
        meant = spellings.get(folded(event))
        if meant is not None and event not in mapped:
            trouble = f"{count:,} events {shown(event)} are not mapped, and differ from {shown(meant)} only in spelling"
            warn(cells.file, f"{trouble}; name them in the mapping, too, if they are the same")


def warn_of_bad_values(cells: Cells, mapping: EventMapping) -> None:
    """Warn about rows that a column beside the mapped ones calls bad, as the quality of a historian does."""
    mapped = {mapping.column(key) for key in mapping.entries} | {name for _, name in mapping.clock.columns}
    for name in (name for name in cells.columns if name not in mapped | {mapping.topic}):
        counts = Counter(cells.columns[name])
        if len(counts) > MOST_QUALITIES:
            continue
        has_codes = "192" in counts and counts.keys() <= {*_BAD_CODES, *_GOOD_CODES}
        bad = [text for text in counts if _BAD.search(text) or (has_codes and text in _BAD_CODES)]
        if bad and (has_codes or any(map(_GOOD.search, counts))):
            num_bad = sum(counts[text] for text in bad)
            trouble = f"it is {shown(bad[0])} in {num_bad:,} rows, whose values count like any others"
            warn(f"{cells.file}, column {name!r}", f"{trouble}; leave them out if it tells how they were measured")


def warn_of_repeats(cells: Cells, mapping: EventMapping) -> None:
    """Warn about rows that repeat the one above, where no clock tells whether a stage was written twice."""
    columns = [texts for name, texts in cells.columns.items() if name != ROW]
    whole = list(zip(*columns, strict=True)) if mapping.clock.since == "stage" else []
    repeats = [row for row in range(1, len(whole)) if whole[row] == whole[row - 1]]
    if repeats:
        rest = f", as do {len(repeats):,} rows" if len(repeats) > 1 else ""
        trouble = f"it repeats the one above{rest}, and counts as a stage of its own"
        warn(cells.place(repeats[0]), f"{trouble}; if it was written twice, delete it")


def warn_of_rows_apart(cells: Cells, groups: Groups, stamps: Stamps, mapping: EventMapping) -> None:
    """Warn about trajectories whose rows stand apart, in the table or in time: their names may have been used again."""
    if mapping.topic is not None and mapping.clock.since is None:
        is_named = mapping.trajectory is not None and not mapping.has_begins
        apart, how = _apart_in_time(groups, stamps) if is_named else [], "have long pauses"
    else:
        order = np.sort(np.concatenate([np.asarray(rows, dtype=np.int64) for rows in groups.values()]))
        places = {name: np.searchsorted(order, rows) for name, rows in groups.items()}
        breaks = {name: np.flatnonzero(np.abs(np.diff(at)) > 1) for name, at in places.items()}
        apart, how = [(groups[name][at[0] + 1], name) for name, at in breaks.items() if len(at)], "are not adjacent"
    if apart:
        row, name = apart[0]
        warn(
            cells.place(row),
            f"rows of trajectory {shown(name)} {how}, as in {len(apart):,} of {len(groups):,} trajectories, and each "
            "counts as one: if names were reused, convert each part separately, and join the logs",
        )


def _apart_in_time(groups: Groups, stamps: Stamps) -> list[tuple[int, Any]]:
    """The first row after a long pause of each trajectory with one, in which others go on; and its name."""
    ordered = {name: np.asarray(rows)[np.argsort(stamps[rows], kind="stable")] for name, rows in groups.items()}
    steps = {name: np.diff(stamps[rows]) for name, rows in ordered.items()}
    usual = float(np.median(np.concatenate([*steps.values(), np.zeros(1)])))
    found, times = [], np.sort(stamps)
    for name, rows in ordered.items():
        at = int(steps[name].argmax()) if len(rows) > 1 else -1
        if at >= 0 and steps[name][at] > max(LEAST_PAUSE_NS, PAUSE * usual):
            before, after = stamps[rows[at]], stamps[rows[at + 1]]
            if np.searchsorted(times, after) > np.searchsorted(times, before, side="right"):
                found.append((int(rows[at + 1]), name))
    return found


def warn_of_reordered(cells: Cells, groups: Groups, stamps: Stamps, mapping: EventMapping) -> None:
    """Warn about rows above which a later time stands; refuse them between stages that have numbers (`LogError`)."""
    if mapping.takes_order:
        return
    late = [rows[k + 1] for rows in groups.values() for k in np.flatnonzero(np.diff(stamps[rows]) < 0).tolist()]
    if late and mapping.wide is not None:
        trouble = 'is before that of the stage before; fix it, or set since = "stage" if it counts from there'
        cells.refuse(late[0], mapping.clock.fields[-1], trouble)
    if late:
        rest = f", as in {len(late):,} rows" if len(late) > 1 else ""
        early = f"the time is before that of the row above{rest}"
        warn(cells.place(late[0]), f"{early}; rows are sorted by time")


def warn_of_overlaps(cells: Cells, groups: Groups, begins: Stamps, stamps: Stamps) -> None:
    """Warn about stages that begin long before the one above ends, given the begin and the end of each row."""
    early: list[int] = []
    for rows in groups.values():
        order = np.asarray(rows)[np.argsort(stamps[rows], kind="stable")]
        lasted, overlap = (stamps - begins)[order[:-1]], stamps[order[:-1]] - begins[order[1:]]
        # Where all rows have the same beginning, it is that of the trajectory.
        early += order[1:][(overlap > MOST_OVERLAP * lasted) & (begins[order[1:]] > begins[order[0]])].tolist()
    if early:
        warn(
            cells.place(early[0]),
            f"the stage begins before the one above ends, as in {len(early):,} of {len(stamps):,} rows, and counts as "
            "begun after it; if two went on at once, give each a trajectory of its own",
        )


def late_covariates(events: list[Event]) -> Iterator[str]:
    """Keys of covariates with the time of an action that come after it in the file."""
    begun_ns: int | None = None
    for event in events:
        if event.key in ("action", "reward", "ending"):
            begun_ns = event.stamp_ns if event.key == "action" else None
        elif event.key.startswith("covariates.") and event.stamp_ns == begun_ns:
            yield event.key


def warn_of_late(cells: Cells, mapping: EventMapping, late: Counter[str]) -> None:
    """Warn about covariates whose value before was taken, as counted by `late_covariates`."""
    if late:
        names = ", ".join(mapping.origin(key) for key in late)
        warn(
            cells.file,
            f"{late.total():,} values of {names} have the time of an action, but come after it in the file: the "
            "earlier value was used; write them before the action if they were known by then",
        )


def is_stale(trajectory: Trajectory, events: Sequence[Event]) -> bool:
    """Whether nothing was seen between the last reward and the cut, so that the covariates before stand there, too."""
    if trajectory.ending != CUT or not trajectory.stages or trajectory.stages[-1]["action"] is not None:
        return False
    last = max((k for k, event in enumerate(events) if event.key == "reward"), default=0)
    return not any(event.key.startswith("covariates.") for event in events[last:])


def warn_of_stale(cells: Cells, mapping: EventMapping, num_stale: int) -> None:
    """Warn about trajectories, counted by `is_stale`, in which a stage begins that no row tells of."""
    if num_stale and mapping.covariates:
        which = "trajectory was" if num_stale == 1 else "trajectories were"
        warn(
            cells.file,
            f"{num_stale:,} {which} cut after a reward, and no row says what was seen then: the covariates of the row "
            "before stand for it; add a row with what was seen, without an action, or leave that reward empty",
        )


def warn_of_running_clock(cells: Cells, clock: Clock, found: list[Trajectory]) -> None:
    """Warn about one clock for all trajectories if times should count from the beginning of each."""
    several = sorted((each for each in found if len(each.stages) > 1), key=lambda each: each.end_s)
    if any(map(_run_on, (several, found))):
        begin = next(filter(BEGIN_LIKE.search, cells.columns), "COLUMN")
        warn(
            f"{cells.file}, column {clock.fields[-1]!r}",
            "times continue from one trajectory to the next and do not count from each beginning; replace "
            f'since = "trajectory" by begin = "{begin}", the column of the time at which a stage began, '
            "with that of its end as field",
        )


def _run_on(found: Sequence[Trajectory]) -> bool:
    """Whether enough trajectories follow one another: the first stage of each ends after the one before it."""
    first_s = [each.end_s if each.stages[0]["elapsed_s"] is None else each.stages[0]["elapsed_s"] for each in found]
    follow = all(end_s > before.end_s for before, end_s in zip(found, first_s[1:], strict=False))
    return len(found) >= FEWEST_ON_ONE_CLOCK and follow


def warn_of_codes(cells: Cells, mapping: EventMapping, found: Sequence[Trajectory]) -> None:
    """Warn if all trajectories are cut, by numbers or truth values: they may be the codes of a status."""
    causes = {str(each.cause) for each in found}
    if causes and all(_IS_CODE.fullmatch(cause) for cause in causes):
        column, codes = mapping.column("ending"), ", ".join(sorted(causes)[:3])
        trouble = f"column {column!r} has no finished trajectory, and cuts by {codes}"
        warn(cells.file, f"{trouble}; if these are codes of a status, name those that mean finished in ending.finished")


def warn_of_early(cells: Cells, events: list[Event], kept: Collection[str]) -> None:
    """Warn about values before the first beginning of a trajectory, but for those that stay known."""
    begin = next((k for k, event in enumerate(events) if event.key == "trajectory"), 0)
    if num_early := sum(event.key not in kept for event in events[:begin]):
        warn(cells.file, f"{num_early} values come before the first beginning of a trajectory; they are left out")
