"""The small file that says which topic of a ROS bag carries what."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

from halfseen.errors import ArgumentError
from halfseen.logs.columns import FINISHED, STAGE_COLUMNS
from halfseen.reading import read_text, toml_of

MAPPING_TEMPLATE = """\
# Which topic of a bag carries what, for `halfseen convert BAG --mapping THIS --out LOGS`.
# A field is a path into the message: "data", "pose.position.x", "data.2" (the third number of an array).
# [action], [reward] and [ending] are needed; leave out what you do not record.

# "log": the time at which the recorder got a message. "publish": that at which it was sent, which MCAP alone knows.
# "header": header.stamp, which every topic below must then have.
clock = "log"

# A message that begins a trajectory, and its name (leave field out to number the trajectories). Without this table a
# bag is one trajectory that begins with its first message.
[trajectory]
topic = "/episode/begin"
field = "data"

# What the policy saw: the last value before the action. One table a covariate.
[covariates.occlusion]
topic = "/camera/occlusion"
field = "data"

# The action of a stage, as text or a whole number; then what it acted on and how probable it was, which may come at
# any time between the previous reward and this one.
[action]
topic = "/pick/action"
field = "data"

[object]
topic = "/pick/object"
field = "data"

[probability]
topic = "/pick/probability"
field = "data"

# A reward completes the stage: its time is the clock of the stage.
[reward]
topic = "/pick/reward"
field = "data"

# How a trajectory ended: one of the values in finished, or else the cause of a cut, such as "operator" or "battery".
# A trajectory without such a message was cut by "crash" when its last message came.
[ending]
topic = "/episode/end"
field = "data"
finished = ["finished"]

# sensor_msgs/PointCloud2 in the camera frame [m]: the last cloud before the action belongs to the stage.
[cloud]
topic = "/camera/points"
"""
"""A whole mapping file, with comments."""

_CLOCKS = ("log", "publish", "header")
_NEEDED = ("action", "reward", "ending")
_FIELDS = ("object", "probability")


@dataclass(frozen=True)
class Source:
    """Where a value comes from.

    Parameters
    ----------
    key
        Its table in the mapping file, such as ``reward`` or ``covariates.occlusion``.
    topic
        Topic of the messages.
    field
        Path into the message; None where the message itself is meant.
    """

    key: str
    topic: str
    field: str | None


@dataclass(frozen=True)
class BagMapping:
    """Which topic carries what; made by `read_mapping`.

    Parameters
    ----------
    file
        Where it was read, for messages.
    action, reward, ending
        What every bag has.
    finished
        Values of the ending that mean finished.
    clock
        "log", "publish" or "header".
    trajectory, object, probability, cloud
        What a bag may have.
    covariates
        Source of each covariate of the stages.
    """

    file: str
    action: Source
    reward: Source
    ending: Source
    finished: tuple[Any, ...] = (FINISHED,)
    clock: str = "log"
    trajectory: Source | None = None
    object: Source | None = None
    probability: Source | None = None
    cloud: Source | None = None
    covariates: Mapping[str, Source] = field(default_factory=dict)

    @property
    def sources(self) -> list[Source]:
        """All that is mapped."""
        named = [self.trajectory, *self.covariates.values(), self.cloud, self.action, self.object, self.probability]
        return [source for source in (*named, self.reward, self.ending) if source is not None]


def read_mapping(file: str | Path) -> BagMapping:
    """Read a mapping file (TOML); `MAPPING_TEMPLATE` is one, and says what each table means.

    Parameters
    ----------
    file
        The file.

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
    try:
        tables = toml_of(read_text(Path(file)))
    except OSError as error:
        raise ArgumentError(
            f"{file}: it cannot be read ({error.strerror}); `halfseen convert --mapping-template` prints one"
        ) from error
    except ValueError as error:
        raise ArgumentError(f"{file}: it is no TOML ({error}); mend it") from error
    return _mapping(str(file), tables)


def _mapping(file: str, tables: dict[str, Any]) -> BagMapping:
    _check_keys(file, "", tables, ("clock", "trajectory", "covariates", "cloud", *_NEEDED, *_FIELDS))
    for key in _NEEDED:
        if key not in tables:
            _refuse(file, key, "it is missing; say which topic and field carry it")
    clock, covariates = tables.pop("clock", "log"), tables.pop("covariates", {})
    if clock not in _CLOCKS:
        _refuse(file, "clock", f"{clock!r} is none of {', '.join(map(repr, _CLOCKS))}; choose one")
    if not isinstance(covariates, dict):
        _refuse(file, "covariates", f"{covariates!r} is no table; give each covariate a table [covariates.NAME]")
    for name in covariates:
        if name in (*STAGE_COLUMNS, "cloud"):
            _refuse(file, f"covariates.{name}", "stages have such a column already; give the covariate another name")
    sources = {key: _source(file, key, table) for key, table in tables.items()}
    seen = {name: _source(file, f"covariates.{name}", table) for name, table in covariates.items()}
    finished = tables["ending"].get("finished", [FINISHED])
    if not (isinstance(finished, list) and finished and all(isinstance(value, str | int | bool) for value in finished)):
        _refuse(file, "ending.finished", f"{finished!r} is no list of values; say for example ['finished']")
    return BagMapping(file=file, clock=clock, finished=tuple(finished), covariates=seen, **sources)


def _source(file: str, key: str, table: Any) -> Source:
    if not isinstance(table, dict):
        _refuse(file, key, f"{table!r} is no table; write [{key}] with topic and field below it")
    known = {"cloud": ("topic",), "ending": ("topic", "field", "finished")}
    _check_keys(file, f"{key}.", table, known.get(key, ("topic", "field")))
    for entry in ("topic", "field"):
        value = table.get(entry)
        if value is None and (entry == "topic" or key not in ("trajectory", "cloud")):
            _refuse(file, f"{key}.{entry}", "it is missing; add it")
        if value is not None and not (isinstance(value, str) and value):
            _refuse(file, f"{key}.{entry}", f"{value!r} is no text; give the {entry}'s name")
    return Source(key, table["topic"], table.get("field"))


def _check_keys(file: str, prefix: str, table: dict[str, Any], known: tuple[str, ...]) -> None:
    for key in table:
        if key not in known:
            _refuse(file, f"{prefix}{key}", f"it is unknown; there are {', '.join(known)}")


def _refuse(file: str, key: str, trouble: str) -> NoReturn:
    raise ArgumentError(f"{file}, {key}: {trouble}")
