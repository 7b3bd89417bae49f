"""Mapping files (TOML): how they are read, and those that assign the topics of a bag to the parts of a log."""

import re
from collections.abc import Iterator
from itertools import chain, repeat
from pathlib import Path
from typing import Annotated, Any, Generic, TypeVar

import msgspec

from halfseen.errors import ArgumentError
from halfseen.logs.columns import FINISHED, STAGE_COLUMNS
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


def refuse_mapping(file: str | Path, mapping: Any, troubles: Iterator[tuple[str, str]]) -> None:
    """Refuse an inconsistent mapping, naming the key."""
    taken = [f"covariates.{name}" for name in mapping.covariates if name in (*STAGE_COLUMNS, "cloud")]
    trouble_of_name = "stages have such a column already; give the covariate another name"
    wrong = [f"{key}.keeps" for key in mapping.kept if not key.startswith("covariates.")]
    trouble_of_key = "it is for covariates alone; leave it out"
    for key, trouble in chain(troubles, zip(taken, repeat(trouble_of_name)), zip(wrong, repeat(trouble_of_key))):
        raise ArgumentError(f"{file}, {key}: {trouble}")


class ValueSource(msgspec.Struct, **Given):
    """Source of a value."""

    topic: str = ""
    field: str | None = None
    """Path into the message; None for the message itself."""
    keeps: bool = False
    """Whether a covariate keeps its value from before the trajectory began, as on a latched topic."""


class Parts(msgspec.Struct, Generic[Of], kw_only=True, **Given):
    """Sources of the parts of a log that any mapping has."""

    action: Of
    reward: Of
    trajectory: Of | None = None
    object: Of | None = None
    probability: Of | None = None
    covariates: dict[str, Of] = {}

    @property
    def entries(self) -> dict[str, Of]:
        """All sources by their table in the file, in the order in which they apply within a row."""
        named = {"trajectory": self.trajectory, **{f"covariates.{name}": of for name, of in self.covariates.items()}}
        named |= {key: getattr(self, key, None) for key in _KEYS}
        return {key: source for key, source in named.items() if source is not None}

    @property
    def kept(self) -> list[str]:
        """Keys of the sources whose values outlast a trajectory."""
        entries: dict[str, Any] = self.entries
        return [key for key, source in entries.items() if source.keeps]


class EndingSource(ValueSource, **Given):
    """Source of an ending; values in `finished` mean finished, all others are causes of a cut."""

    finished: Annotated[list[str | int | bool], msgspec.Meta(min_length=1)] = msgspec.field(
        default_factory=lambda: [FINISHED]
    )


class BagMapping(Parts[ValueSource], kw_only=True, **Given):
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

    ending: EndingSource
    clock: str = "log"
    cloud: ValueSource | None = None
    file: str = msgspec.field(default="", name="file of the mapping")
    """File it was read from, for messages."""

    @property
    def sources(self) -> dict[str, ValueSource]:
        """All sources by their table in the file, such as ``covariates.occlusion``."""
        return self.entries


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
    refuse_mapping(file, mapping, _troubles_of_bag(mapping))
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
