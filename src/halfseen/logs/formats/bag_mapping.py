"""Which topic of a bag carries what: a mapping file."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import msgspec

from halfseen.errors import ArgumentError
from halfseen.logs.columns import FINISHED, STAGE_COLUMNS
from halfseen.logs.formats.event_mapping import Given, mapping_in

MAPPING_TEMPLATE = Path(__file__).with_name("bag_mapping.toml").read_text(encoding="utf-8")
"""A whole mapping file, with comments."""
_CLOCKS = ("log", "publish", "header")


class Source(msgspec.Struct, **Given):
    """Where a value comes from.

    Parameters
    ----------
    topic
        Topic of the messages.
    field
        Path into the message; None where the message itself is meant.
    """

    topic: str = ""
    field: str | None = None


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
        named = {"trajectory": self.trajectory, **{f"covariates.{name}": one for name, one in self.covariates.items()}}
        named |= {key: getattr(self, key) for key in ("cloud", "action", "object", "probability", "reward", "ending")}
        return {key: source for key, source in named.items() if source is not None}


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
    for key, trouble in _troubles(mapping):
        raise ArgumentError(f"{file}, {key}: {trouble}")
    return msgspec.structs.replace(mapping, file=str(file))


def _troubles(mapping: BagMapping) -> Iterator[tuple[str, str]]:
    """What of a mapping does not fit together, by key."""
    if mapping.clock not in _CLOCKS:
        yield "clock", f"{mapping.clock!r} is none of {', '.join(map(repr, _CLOCKS))}; choose one"
    for name in mapping.covariates:
        if name in (*STAGE_COLUMNS, "cloud"):
            yield f"covariates.{name}", "stages have such a column already; give the covariate another name"
    for key, source in mapping.sources.items():
        if not source.topic:
            yield f"{key}.topic", "it is missing; add it"
        if not source.field and key not in ("trajectory", "cloud"):
            yield f"{key}.field", "it is missing; add it"
        if source.field is not None and key == "cloud":
            yield "cloud.field", "a cloud is a whole message; leave it out"
