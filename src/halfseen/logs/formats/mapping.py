"""Mapping files (TOML): which topic of a bag, or which column of a table, carries what."""

import re
from collections.abc import Iterator
from itertools import chain, repeat
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import msgspec

from halfseen.errors import ArgumentError
from halfseen.logs.columns import FINISHED, STAGE_COLUMNS
from halfseen.reading import read_text, reason_of, toml_of

Of = TypeVar("Of")
Given: Any = {"frozen": True, "forbid_unknown_fields": True}
NUMBERS = ("probability", "reward")
"""Keys of numbers; covariates may be such, too."""
_KEYS = ("cloud", "action", "object", "probability", "reward", "ending")
MAPPING_TEMPLATE = Path(__file__).with_name("bag_mapping.toml").read_text(encoding="utf-8")
"""A whole mapping file of a bag, with comments."""
_CLOCKS = ("log", "publish", "header")


def mapping_in(file: str | Path, kind: type[Of], remedy: str) -> Of:
    """Read a mapping file (TOML) as a record of a kind (`ArgumentError`); what makes one is the remedy."""
    try:
        return msgspec.convert(toml_of(read_text(Path(file))), kind)
    except OSError as error:
        raise ArgumentError(f"{file}: it cannot be read ({error.strerror}); {remedy}") from error
    except msgspec.ValidationError as error:
        raise ArgumentError(f"{file}, {_reworded(str(error))}; {remedy}") from error
    except ValueError as error:
        raise ArgumentError(f"{file}: it is no TOML ({reason_of(error)}); mend it") from error


def _reworded(trouble: str) -> str:
    """Begin with the key what msgspec ends with."""
    words, _, place = trouble.partition(" - at `$")
    key = re.sub(r"\[\.\.\.\]", "", place.strip("`."))
    name = re.search(r"Object (?:missing required|contains unknown) field `(\w+)`", words)
    if name is not None:
        trouble = "missing; add it" if "required" in words else "unknown"
        return f"{key}.{name[1]}: it is {trouble}".removeprefix(".")
    return f"{key}: {words[:1].lower()}{words[1:]}".removeprefix(": ")


def _mapped(mapping: Any) -> dict[str, Any]:
    """All that is mapped, by its table in the file, in the order in which it counts within a row."""
    named = {"trajectory": mapping.trajectory, **{f"covariates.{name}": of for name, of in mapping.covariates.items()}}
    named |= {key: getattr(mapping, key, None) for key in _KEYS}
    return {key: source for key, source in named.items() if source is not None}


def _refuse(file: str | Path, mapping: Any, troubles: Iterator[tuple[str, str]]) -> None:
    """Refuse a mapping that does not fit together, by key."""
    taken = [f"covariates.{name}" for name in mapping.covariates if name in (*STAGE_COLUMNS, "cloud")]
    trouble_of_name = "stages have such a column already; give the covariate another name"
    for key, trouble in chain(troubles, zip(taken, repeat(trouble_of_name))):
        raise ArgumentError(f"{file}, {key}: {trouble}")


class Source(msgspec.Struct, **Given):
    """Where a value comes from."""

    topic: str = ""
    field: str | None = None
    """Path into the message; None where the message itself is meant."""


class EndingSource(Source, **Given):
    """Where an ending comes from; values in `finished` are no cause of a cut."""

    finished: Annotated[list[str | int | bool], msgspec.Meta(min_length=1)] = msgspec.field(
        default_factory=lambda: [FINISHED]
    )


class BagMapping(msgspec.Struct, **Given):
    """Which topic carries what; made by `read_mapping`.

    Parameters
    ----------
    action, reward, ending
        What every bag has.
    clock
        "log", "publish" or "header".
    trajectory, object, probability, cloud
        What a bag may have.
    covariates
        Source of each covariate of the stages.
    """

    action: Source
    reward: Source
    ending: EndingSource
    clock: str = "log"
    trajectory: Source | None = None
    object: Source | None = None
    probability: Source | None = None
    cloud: Source | None = None
    covariates: dict[str, Source] = {}
    file: str = msgspec.field(default="", name="file of the mapping")
    """Where it was read, for messages."""

    @property
    def sources(self) -> dict[str, Source]:
        """All that is mapped, by its table in the file, such as ``covariates.occlusion``."""
        return _mapped(self)


def read_mapping(file: str | Path) -> BagMapping:
    """Read a mapping file (TOML); `MAPPING_TEMPLATE` is one, and says what each table means.

    Raises
    ------
    ArgumentError
        It is missing or no TOML, a table is missing, or something in it is unknown or of the wrong type; the file and
        the key are named.

    Examples
    --------
    All that a mapping may hold; the first three tables are needed::

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
    """What of the mapping of a bag does not fit together, by key."""
    if mapping.clock not in _CLOCKS:
        yield "clock", f"{mapping.clock!r} is none of {', '.join(map(repr, _CLOCKS))}; choose one"
    for key, source in mapping.sources.items():
        if not source.topic:
            yield f"{key}.topic", "it is missing; add it"
        if not source.field and key not in ("trajectory", "cloud"):
            yield f"{key}.field", "it is missing; add it"
        if source.field is not None and key == "cloud":
            yield "cloud.field", "a cloud is a whole message; leave it out"


class Layout(msgspec.Struct, **Given):
    """How a file of text holds a table; what is None is found in the file."""

    separator: Annotated[str, msgspec.Meta(min_length=1, max_length=1)] | None = None
    decimal: Literal[",", "."] | None = None
    thousands: Literal[".", ",", "'", " "] | None = None
    """Mark between groups of three digits: point, comma, apostrophe or space."""
    encoding: Literal["utf-8", "utf-8-sig", "cp1252", "utf-16"] | None = None
    heading: Annotated[int, msgspec.Meta(ge=1)] = 1
    """Line that names the columns, from 1."""
    query: str | None = None
    """Of a database: the SELECT whose rows are read."""


class Clock(msgspec.Struct, **Given):
    """Where times stand, and how they are written."""

    field: str | Annotated[list[str], msgspec.Meta(min_length=1)]
    """Column of the time of a row; or those of its date and of its time of day, which are read with a space between."""
    format: str | None = None
    """Of times that are not ISO 8601, as in Python: ``%d.%m.%Y %H:%M:%S``. Without a day they are times of day, and
    the next day begins where they fall back past midnight."""
    zone: str | None = None
    """Of dates without one, such as ``Europe/Berlin``."""
    unit: Literal["s", "ms", "us", "ns", "min"] | None = None
    since: Literal["trajectory", "stage"] | None = None
    """What numbers count from: the beginning of the trajectory, or of the stage; None for a clock of their own."""
    begin: str | list[str] | None = None
    """Of one row a stage: column of the time at which the stage began; or two, as of `field`."""

    @property
    def fields(self) -> list[str]:
        """The columns of the time of a row."""
        return [self.field] if isinstance(self.field, str) else self.field

    @property
    def begins(self) -> list[str]:
        """The columns of the time of a beginning."""
        return [self.begin] if isinstance(self.begin, str) else self.begin or []


class Entry(msgspec.Struct, **Given):
    """Where a value stands."""

    field: str | None = None
    """Its column; by default that of the events."""
    topic: str | list[str] | None = None
    """Which events carry it; None for any row in which the cell is not empty."""
    values: dict[str, str | int | float] = {}
    """What text stands for; other text stays what it is."""
    type: Literal["number", "text"] | None = None
    """Of a covariate, if it is not to be found."""

    @property
    def topics(self) -> list[str]:
        """The events that carry it."""
        return [self.topic] if isinstance(self.topic, str) else list(self.topic or [])


class Flag(msgspec.Struct, **Given):
    """A column that is true where something holds."""

    field: str


class Ending(Entry, **Given):
    """Where an ending stands: as text, or as flags of the row that acts."""

    finished: list[str] | Flag = msgspec.field(default_factory=lambda: [FINISHED])
    """Text that is no cause of a cut; or the flag of the end that a trajectory itself has."""
    cut: Flag | None = None
    """The flag of a cut, whose cause is the name of the column; where `finished` is a flag, too."""

    @property
    def finishing(self) -> list[str]:
        """Text that is no cause of a cut; none where flags tell."""
        return self.finished if isinstance(self.finished, list) else []


class EventMapping(msgspec.Struct, **Given):
    """Which column carries what; made by `read_event_mapping`.

    Parameters
    ----------
    clock
        Times of the rows.
    action, reward, ending
        What every table has.
    topic
        Column of events; None where each row is a stage.
    trajectory
        Column of its name, or the event that begins it; None where the table is one trajectory.
    object, probability, covariates
        What a table may have.
    table
        How the file holds it.
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
    table: Layout = Layout()

    @property
    def entries(self) -> dict[str, Entry]:
        """All that is mapped, in the order in which it counts within a row."""
        return _mapped(self)

    def column(self, key: str) -> str:
        """The column of what is mapped."""
        return str(self.entries[key].field or self.topic)

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
    """Whether a file is the mapping of a table, and no other one: it says where the times stand."""
    try:
        return isinstance(toml_of(read_text(Path(file))).get("clock"), dict)
    except (OSError, ValueError):
        return False


def _troubles_of_table(mapping: EventMapping) -> Iterator[tuple[str, str]]:
    """What of the mapping of a table does not fit together, by key."""
    clock, layout = mapping.clock, mapping.table
    if layout.thousands is not None and layout.thousands == layout.decimal:
        yield "table.thousands", "it is the mark of fractions, too; mend one of the two"
    if clock.unit is not None and max(len(clock.fields), len(clock.begins)) > 1:
        yield (
            "clock.field",
            "several columns are for a date and a time of day, and times of a unit stand in one; name it",
        )
    if clock.format is not None and (clock.unit or clock.since):
        yield "clock.format", "dates have a format, and numbers a unit; leave one of the two out"
    if mapping.topic is None and clock.since is None and clock.begin is None:
        yield "clock.begin", "it is missing; name the column of the beginning of a stage, or say since what times count"
    if clock.since is not None and clock.begin is not None:
        yield "clock", f"since = {clock.since!r} and begin = {clock.begin!r} both say when it begins; leave one out"
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
        yield "ending.finished", 'it is no flag, and cut is one; say finished = {field = "COLUMN"}, too'
