"""Mapping files (TOML) that assign the columns of a table to the parts of a log."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from halfseen.logs.columns import FINISHED, shown
from halfseen.logs.formats.mapping import NUMBERS, Given, Parts, mapping_in, refuse_mapping
from halfseen.reading import read_text, toml_of


class TextLayout(msgspec.Struct, **Given):
    """Layout of a table in a text file; None means to detect it."""

    separator: Annotated[str, msgspec.Meta(min_length=1, max_length=1)] | None = None
    decimal: Literal[",", "."] | None = None
    thousands: Literal[".", ",", "'", " "] | None = None
    """Thousands separator: point, comma, apostrophe or space."""
    encoding: str | None = None
    """Any of Python's, such as ``cp1252``, ``utf-16`` or ``shift_jis``."""
    heading: Annotated[int, msgspec.Meta(ge=1)] = 1
    """Line that names the columns, from 1."""
    sheet: str | None = None
    """Sheet of a workbook; by default the first."""
    query: str | None = None
    """For a database, the SELECT whose rows are read."""
    missing: list[str] = []
    """Texts that mean an empty cell, such as ``NA``."""
    fill_down: list[str] = []
    """Columns whose empty cells repeat the cell above, as below merged cells."""


class Clock(msgspec.Struct, **Given):
    """Columns of times, and their notation."""

    field: str | Annotated[list[str], msgspec.Meta(min_length=1)]
    """Column of a row's time; or the columns of its date and time of day, joined by a space."""
    format: str | None = None
    """Format of times that are not ISO 8601, as in Python: ``%d.%m.%Y %H:%M:%S``. Without a day they are times of day,
    and the next day begins where they fall back past midnight."""
    zone: str | None = None
    """Time zone of dates without one, such as ``Europe/Berlin``."""
    unit: Literal["s", "ms", "us", "ns", "min", "h", "d"] | None = None
    """Unit of numeric times; ``d`` also for dates that a spreadsheet wrote as days since 1900."""
    since: Literal["trajectory", "stage"] | None = None
    """Origin of numeric times: the beginning of the trajectory or of the stage; None for a clock of their own."""
    begin: str | list[str] | None = None
    """With one row per stage, column of the time at which the stage began; or two columns, as in `field`."""

    @property
    def fields(self) -> list[str]:
        """The columns of a row's time."""
        return [self.field] if isinstance(self.field, str) else self.field

    @property
    def begins(self) -> list[str]:
        """The columns of a stage's begin time."""
        return [self.begin] if isinstance(self.begin, str) else self.begin or []

    @property
    def has_dates(self) -> bool:
        """Whether times are dates, so that none comes twice."""
        return self.unit is None and self.since is None and (self.format is None or "%d" in self.format)

    @property
    def columns(self) -> list[tuple[str, str]]:
        """All columns of times, each with the key that names it."""
        return [("clock.field", name) for name in self.fields] + [("clock.begin", name) for name in self.begins]


class Entry(msgspec.Struct, **Given):
    """Source of a value in a table."""

    field: str | None = None
    """Its column; by default that of the events."""
    topic: str | list[str] | None = None
    """Events that carry it; None for any row with a non-empty cell."""
    values: dict[str, str | int | float] = {}
    """Replacements for texts; other text is kept."""
    type: Literal["number", "text"] | None = None
    """Type of a covariate; None to detect it."""
    keeps: bool = False
    """Whether a covariate keeps its value from before the event that began the trajectory."""
    row: Literal["next"] | None = None
    """"next" for a reward that stands in the row after its action; None for the row of the action."""

    @property
    def topics(self) -> list[str]:
        """The events that carry the value."""
        return [self.topic] if isinstance(self.topic, str) else list(self.topic or [])


class Flag(msgspec.Struct, **Given):
    """A column of true and false."""

    field: str


class Ending(Entry, **Given):
    """Source of an ending: text, or flags in the row of the action."""

    finished: list[str] | Flag | Literal["rewarded"] = msgspec.field(default_factory=lambda: [FINISHED])
    """Texts that mean finished, not a cause of a cut; the flag of a trajectory's own end; or "rewarded" if trajectories
    finished whose last row has a reward."""
    cut: Flag | None = None
    """Flag of a cut, whose cause is the name of the column; only if `finished` is a flag, too."""

    @property
    def finishing(self) -> list[str]:
        """Texts that mean finished; empty if there are none."""
        return self.finished if isinstance(self.finished, list) else []

    @property
    def is_derived(self) -> bool:
        """Whether flags or rewards tell the ending, not texts."""
        return not isinstance(self.finished, list)


class EventMapping(Parts[Entry], kw_only=True, **Given):
    """Mapping of the columns of a table; made by `read_event_mapping`.

    Parameters
    ----------
    clock
        Times of the rows.
    action, reward, ending
        Required entries.
    topic
        Column of events; None if each row is a stage.
    wide
        With one row a trajectory, the pattern of columns by stage, such as ``{name}_{stage}`` for ``x_1, x_2``.
    trajectory
        Column of its name, or the event that begins it; None if each file is one trajectory.
    object, probability, covariates
        Optional entries.
    table
        Layout of the file.
    """

    clock: Clock
    ending: Ending
    topic: str | None = None
    wide: str | None = None
    table: TextLayout = TextLayout()

    def column(self, key: str) -> str:
        """The column of a mapped entry."""
        return str(self.entries[key].field or self.topic)

    def origin(self, key: str) -> str:
        """Source of a value for messages: its events, or its column."""
        topics = self.entries[key].topics
        return " or ".join(map(shown, topics)) if topics else f"column {self.column(key)!r}"

    @property
    def takes_order(self) -> bool:
        """Whether the order of rows tells the order of stages, not a clock."""
        return self.clock.since == "stage" or (self.clock.since is not None and self.has_begins)

    @property
    def is_rewarded_later(self) -> bool:
        """Whether each row has the reward of the action in the row before."""
        return self.reward.row is not None

    @property
    def has_begins(self) -> bool:
        """Whether an event begins a trajectory."""
        return self.trajectory is not None and bool(self.trajectory.topics)


def read_event_mapping(file: str | Path) -> EventMapping:
    """Read the mapping file (TOML) of a table; `halfseen.logs.formats.mapping_of` makes one from a table.

    Raises
    ------
    ArgumentError
        As `read_mapping`.
    """
    mapping = mapping_in(file, EventMapping, "`halfseen convert TABLE --mapping-template` prints one")
    refuse_mapping(file, mapping, _troubles_of_table(mapping))
    return mapping


def is_event_mapping(file: str | Path) -> bool:
    """Whether a file is the mapping of a table: only such a mapping has a [clock] table."""
    try:
        return isinstance(toml_of(read_text(Path(file))).get("clock"), dict)
    except (OSError, ValueError):
        return False


# fmt: off
def _troubles_of_table(mapping: EventMapping) -> Iterator[tuple[str, str]]:
    """Inconsistencies in the mapping of a table, by key."""
    clock, layout, ending = mapping.clock, mapping.table, mapping.ending
    wide, topic = mapping.wide, mapping.topic
    parts = {each[-1] for each in re.findall("%.", clock.format or "")}
    for is_wrong, key, trouble in (
        (wide is not None and any(wide.count(each) != 1 for each in ("{name}", "{stage}")), "wide",
         f'{wide!r} does not hold {{name}} and {{stage}}, each once; write one like "{{name}}_{{stage}}"'),
        (wide is not None and topic is not None, "wide",
         "it is for one row a trajectory, and topic for one row an event; leave one out"),
        (layout.thousands is not None and layout.thousands == layout.decimal, "table.thousands",
         "it is also the decimal mark; fix one of the two"),
        (layout.encoding is not None and not _is_encoding(layout.encoding), "table.encoding",
         f"{layout.encoding!r} is unknown; use one of Python's, such as 'cp1252' or 'gbk'"),
        (clock.unit is not None and max(len(clock.fields), len(clock.begins)) > 1, "clock.field",
         "several columns are for a date and a time of day, but times with a unit need only one; name it"),
        (clock.format is not None and (clock.unit or clock.since), "clock.format",
         "dates have a format, and numbers a unit; leave one of the two out"),
        ("p" in parts and "I" not in parts, "clock.format",
         "%p has no effect with %H, so 01:00 PM is read as 01:00; use %I instead of %H"),
        ("Z" in parts, "clock.format",
         "%Z is the name of a zone, which is not read; use %z for offsets, or set clock.zone"),
        ("I" in parts and "p" not in parts, "clock.format",
         "%I is an hour from 1 to 12, which needs %p; use %H, or add %p"),
        (mapping.is_rewarded_later
         and (topic is not None or wide is not None or clock.begin is not None or clock.since == "stage"
              or ending.finished == "rewarded"), "reward.row",
         "it is for rows that each have their own time, without topic, wide, begin, since = 'stage' or 'rewarded'; "
         "leave it out"),
        (topic is None and clock.since is None and clock.begin is None and not mapping.is_rewarded_later, "clock.begin",
         "it is missing; name the column of a stage's beginning, or set since; if only ends were logged, add a column "
         "of beginnings, such as the end in the row before"),
        (clock.since is not None and clock.begin is not None, "clock",
         f"since = {clock.since!r} and begin = {clock.begin!r} both define when it begins; leave one out"),
        (bool(mapping.kept) and not mapping.has_begins, f"{(mapping.kept or [''])[0]}.keeps",
         "it is for trajectories that begin with an event; leave it out"),
        (topic is not None and (clock.since == "stage" or clock.begin is not None), "clock",
         "begin, and since = 'stage', are for tables of one row a stage; leave it out"),
        (ending.is_derived and (ending.field is not None or ending.topic is not None), "ending",
         "field and topic are of text, and finished is not; leave one out"),
        (ending.cut is not None and not isinstance(ending.finished, Flag), "ending.finished",
         'it is not a flag, but cut is; set finished = {field = "COLUMN"}, too'),
        (topic is not None and ending.finished == "rewarded", "ending.finished",
         "only rows of stages tell it; name the texts that mean finished"),
    ):
        if is_wrong:
            yield key, trouble
    for key, entry in mapping.entries.items():
        if entry.row is not None and key != "reward":
            yield f"{key}.row", "it is for a reward; leave it out"
        is_derived = isinstance(entry, Ending) and entry.is_derived
        if topic is None and entry.topic is not None:
            yield f"{key}.topic", "no column of events is named; add topic = 'COLUMN' at the top"
        if entry.field is None and (topic is None or entry.topic is None) and not is_derived:
            yield f"{key}.field", "it is missing; name the column"
        is_number = key in NUMBERS or entry.type == "number"
        if is_number and any(isinstance(value, str) for value in entry.values.values()):
            yield f"{key}.values", "they are text; give numbers"
# fmt: on


def _is_encoding(name: str) -> bool:
    """Whether Python decodes text by this name, not bytes as `base64` does."""
    try:
        b"a".decode(name)
    except UnicodeDecodeError:
        return True
    except (LookupError, ValueError):
        return False
    return True
