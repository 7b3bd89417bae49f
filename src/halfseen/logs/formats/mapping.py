"""Mapping files (TOML), which assign topics of a bag or columns of a table to the parts of a log."""

import re
from collections.abc import Iterator
from itertools import chain, repeat
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import msgspec

from halfseen.errors import ArgumentError
from halfseen.logs.columns import FINISHED, STAGE_COLUMNS, shown
from halfseen.reading import read_text, reason_of, toml_of

Of = TypeVar("Of")
Given: Any = {"frozen": True, "forbid_unknown_fields": True}
NUMBERS = ("probability", "reward")
"""Keys with numeric values; covariates may be numeric, too."""
_KEYS = ("cloud", "action", "object", "probability", "reward", "ending")
MAPPING_TEMPLATE = Path(__file__).with_name("bag_mapping.toml").read_text(encoding="utf-8")
"""A complete mapping file for a bag, with comments."""
_CLOCKS = ("log", "publish", "header")


def mapping_in(file: str | Path, kind: type[Of], remedy: str) -> Of:
    """Read a mapping file (TOML) as a record of type `kind` (`ArgumentError`); `remedy` says how to make one."""
    try:
        return msgspec.convert(toml_of(read_text(Path(file))), kind)
    except OSError as error:
        raise ArgumentError(f"{file}: it cannot be read ({error.strerror}); {remedy}") from error
    except msgspec.ValidationError as error:
        raise ArgumentError(f"{file}, {_reworded(str(error))}; {remedy}") from error
    except ValueError as error:
        raise ArgumentError(f"{file}: it is not valid TOML ({reason_of(error)}); fix it") from error


def _reworded(trouble: str) -> str:
    """Put the key, which msgspec names last, first."""
    words, _, place = trouble.partition(" - at `$")
    key = re.sub(r"\[\.\.\.\]", "", place.strip("`."))
    name = re.search(r"Object (?:missing required|contains unknown) field `(\w+)`", words)
    if name is not None:
        trouble = "missing; add it" if "required" in words else "unknown"
        return f"{key}.{name[1]}: it is {trouble}".removeprefix(".")
    return f"{key}: {words[:1].lower()}{words[1:]}".removeprefix(": ")


def _mapped(mapping: Any) -> dict[str, Any]:
    """All mapped entries by their table in the file, in the order in which they apply within a row."""
    named = {"trajectory": mapping.trajectory, **{f"covariates.{name}": of for name, of in mapping.covariates.items()}}
    named |= {key: getattr(mapping, key, None) for key in _KEYS}
    return {key: source for key, source in named.items() if source is not None}


def _refuse(file: str | Path, mapping: Any, troubles: Iterator[tuple[str, str]]) -> None:
    """Refuse an inconsistent mapping, naming the key."""
    taken = [f"covariates.{name}" for name in mapping.covariates if name in (*STAGE_COLUMNS, "cloud")]
    trouble_of_name = "stages have such a column already; give the covariate another name"
    for key, trouble in chain(troubles, zip(taken, repeat(trouble_of_name))):
        raise ArgumentError(f"{file}, {key}: {trouble}")


class ValueSource(msgspec.Struct, **Given):
    """Source of a value."""

    topic: str = ""
    field: str | None = None
    """Path into the message; None for the message itself."""


class EndingSource(ValueSource, **Given):
    """Source of an ending; values in `finished` mean finished, all others are causes of a cut."""

    finished: Annotated[list[str | int | bool], msgspec.Meta(min_length=1)] = msgspec.field(
        default_factory=lambda: [FINISHED]
    )


class BagMapping(msgspec.Struct, **Given):
    """Mapping of the topics of a bag; made by `read_mapping`.

    Parameters
    ----------
    action, reward, ending
        Required sources.
    clock
        "log", "publish" or "header".
    trajectory, object, probability, cloud
        Optional sources.
    covariates
        Source of each covariate of the stages.
    """

    action: ValueSource
    reward: ValueSource
    ending: EndingSource
    clock: str = "log"
    trajectory: ValueSource | None = None
    object: ValueSource | None = None
    probability: ValueSource | None = None
    cloud: ValueSource | None = None
    covariates: dict[str, ValueSource] = {}
    file: str = msgspec.field(default="", name="file of the mapping")
    """File it was read from, for messages."""

    @property
    def sources(self) -> dict[str, ValueSource]:
        """All sources by their table in the file, such as ``covariates.occlusion``."""
        return _mapped(self)


def read_mapping(file: str | Path) -> BagMapping:
    """Read a mapping file (TOML); `MAPPING_TEMPLATE` is an example that explains each table.

    Raises
    ------
    ArgumentError
        The file is missing or not TOML, a table is missing, or a key is unknown or has the wrong type; the message
        names the file and the key.

    Examples
    --------
    All tables of a mapping; the first three are needed::

        action = {topic = "/pick/action", field = "data"}
        reward = {topic = "/pick/reward", field = "data"}
        ending = {topic = "/episode/end", field = "data", finished = ["finished"]}

        clock = "log"
        trajectory = {topic = "/episode/begin", field = "data"}
        object = {topic = "/pick/object", field = "data"}
        probability = {topic = "/pick/probability", field = "data"}
        cloud = {topic = "/camera/points"}

        [covariates]
        occlusion = {topic = "/camera/occlusion", field = "data"}
    """
    mapping = mapping_in(file, BagMapping, "`halfseen convert --mapping-template` prints one")
    _refuse(file, mapping, _troubles_of_bag(mapping))
    return msgspec.structs.replace(mapping, file=str(file))


def _troubles_of_bag(mapping: BagMapping) -> Iterator[tuple[str, str]]:
    """Inconsistencies in the mapping of a bag, by key."""
    if mapping.clock not in _CLOCKS:
        yield "clock", f"{mapping.clock!r} is not one of {', '.join(map(repr, _CLOCKS))}; choose one"
    for key, source in mapping.sources.items():
        if not source.topic:
            yield f"{key}.topic", "it is missing; add it"
        if not source.field and key not in ("trajectory", "cloud"):
            yield f"{key}.field", "it is missing; add it"
        if source.field is not None and key == "cloud":
            yield "cloud.field", "a cloud is a whole message; leave it out"


class TextLayout(msgspec.Struct, **Given):
    """Layout of a table in a text file; None means to detect it."""

    separator: Annotated[str, msgspec.Meta(min_length=1, max_length=1)] | None = None
    decimal: Literal[",", "."] | None = None
    thousands: Literal[".", ",", "'", " "] | None = None
    """Thousands separator: point, comma, apostrophe or space."""
    encoding: Literal["utf-8", "utf-8-sig", "cp1252", "utf-16"] | None = None
    heading: Annotated[int, msgspec.Meta(ge=1)] = 1
    """Line that names the columns, from 1."""
    query: str | None = None
    """For a database, the SELECT whose rows are read."""


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

    @property
    def topics(self) -> list[str]:
        """The events that carry the value."""
        return [self.topic] if isinstance(self.topic, str) else list(self.topic or [])


class Flag(msgspec.Struct, **Given):
    """A column of true and false."""

    field: str


class Ending(Entry, **Given):
    """Source of an ending: text, or flags in the row of the action."""

    finished: list[str] | Flag = msgspec.field(default_factory=lambda: [FINISHED])
    """Texts that mean finished, not a cause of a cut; or the flag of a trajectory's own end."""
    cut: Flag | None = None
    """Flag of a cut, whose cause is the name of the column; only if `finished` is a flag, too."""

    @property
    def finishing(self) -> list[str]:
        """Texts that mean finished; empty if flags are used."""
        return self.finished if isinstance(self.finished, list) else []


class EventMapping(msgspec.Struct, **Given):
    """Mapping of the columns of a table; made by `read_event_mapping`.

    Parameters
    ----------
    clock
        Times of the rows.
    action, reward, ending
        Required entries.
    topic
        Column of events; None if each row is a stage.
    trajectory
        Column of its name, or the event that begins it; None if each file is one trajectory.
    object, probability, covariates
        Optional entries.
    table
        Layout of the file.
    """

    clock: Clock
    action: Entry
    reward: Entry
    ending: Ending
    topic: str | None = None
    trajectory: Entry | None = None
    object: Entry | None = None
    probability: Entry | None = None
    covariates: dict[str, Entry] = {}
    table: TextLayout = TextLayout()

    @property
    def entries(self) -> dict[str, Entry]:
        """All mapped entries, in the order in which they apply within a row."""
        return _mapped(self)

    def column(self, key: str) -> str:
        """The column of a mapped entry."""
        return str(self.entries[key].field or self.topic)

    def origin(self, key: str) -> str:
        """Source of a value for messages: its events, or its column."""
        topics = self.entries[key].topics
        return " or ".join(map(shown, topics)) if topics else f"column {self.column(key)!r}"

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
    _refuse(file, mapping, _troubles_of_table(mapping))
    return mapping


def is_event_mapping(file: str | Path) -> bool:
    """Whether a file is the mapping of a table: only such a mapping has a [clock] table."""
    try:
        return isinstance(toml_of(read_text(Path(file))).get("clock"), dict)
    except (OSError, ValueError):
        return False


def _troubles_of_table(mapping: EventMapping) -> Iterator[tuple[str, str]]:
    """Inconsistencies in the mapping of a table, by key."""
    clock, layout = mapping.clock, mapping.table
    if layout.thousands is not None and layout.thousands == layout.decimal:
        yield "table.thousands", "it is also the decimal mark; fix one of the two"
    if clock.unit is not None and max(len(clock.fields), len(clock.begins)) > 1:
        yield (
            "clock.field",
            "several columns are for a date and a time of day, but times with a unit need only one; name it",
        )
    if clock.format is not None and (clock.unit or clock.since):
        yield "clock.format", "dates have a format, and numbers a unit; leave one of the two out"
    hours = {each[-1] for each in re.findall("%.", clock.format or "")}
    if "p" in hours and "I" not in hours:
        yield "clock.format", "%p has no effect with %H, so 01:00 PM is read as 01:00; use %I instead of %H"
    if "I" in hours and "p" not in hours:
        yield "clock.format", "%I is an hour from 1 to 12, which needs %p; use %H, or add %p"
    if mapping.topic is None and clock.since is None and clock.begin is None:
        yield "clock.begin", "it is missing; name the column of a stage's beginning, or set since"
    if clock.since is not None and clock.begin is not None:
        yield "clock", f"since = {clock.since!r} and begin = {clock.begin!r} both define when it begins; leave one out"
    if mapping.topic is not None and (clock.since == "stage" or clock.begin is not None):
        yield "clock", "begin, and since = 'stage', are for tables of one row a stage; leave it out"
    yield from _troubles_of_flags(mapping.ending)
    for key, entry in mapping.entries.items():
        if mapping.topic is None and entry.topic is not None:
            yield f"{key}.topic", "no column of events is named; add topic = 'COLUMN' at the top"
        is_flag = isinstance(entry, Ending) and isinstance(entry.finished, Flag)
        if entry.field is None and (mapping.topic is None or entry.topic is None) and not is_flag:
            yield f"{key}.field", "it is missing; name the column"
        if (key in NUMBERS or entry.type == "number") and any(
            isinstance(value, str) for value in entry.values.values()
        ):
            yield f"{key}.values", "they are text; give numbers"


def _troubles_of_flags(ending: Ending) -> Iterator[tuple[str, str]]:
    is_flag = isinstance(ending.finished, Flag)
    if is_flag and (ending.field is not None or ending.topic is not None):
        yield "ending", "field and topic are of text, and finished names a column of true and false; leave one out"
    if ending.cut is not None and not is_flag:
        yield "ending.finished", 'it is not a flag, but cut is; set finished = {field = "COLUMN"}, too'
