"""Messages of bags by a mapping: in the order of a clock, their fields read by path."""

import re
from collections.abc import Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from halfseen.errors import ArgumentError, HalfseenError, LogError
from halfseen.installation import extra
from halfseen.logs.formats.bag_mapping import BagMapping, Source
from halfseen.logs.formats.clocks import runs_of
from halfseen.logs.formats.mcap_files import Channel, McapFiles, Recorded
from halfseen.reading import TABLE, check_file, refused
from halfseen.shapes import Float

POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
STORAGES = (".mcap", ".db3", ".bag")

_SECONDS, _NANOSECONDS = ("sec", "seconds", "secs"), ("nanosec", "nsec", "nanos", "nsecs")
# Types of a PointCloud2's fields [ROS's numbers]; coordinates are one of these.
_FLOATS = {7: "f4", 8: "f8"}


class Event(NamedTuple):
    """One value that a message, or a row of a table, carries.

    Parameters
    ----------
    stamp_ns
        When, on the clock of the mapping [ns].
    key
        Its table in the mapping file, such as ``reward`` or ``covariates.occlusion``.
    value
        Text, a number or a boolean; of a cloud its number among the bag's clouds, to be read by `read_clouds`.
    place
        Where it stands, as a message begins; empty in a bag, whose reader names the bag.
    """

    stamp_ns: int
    key: str
    value: Any
    place: str = ""


def check_topics(bags: list[Path], mapping: BagMapping) -> None:
    """Refuse a mapping that names a topic which none of the bags has; one that broke off early may lack some.

    Raises
    ------
    ArgumentError
        There is no such topic, or that of the clouds carries something else.
    LogError
        A bag is missing or broken.
    """
    types: dict[str, str] = {}
    for bag in bags:
        with _opened(bag) as reader:
            types |= {channel.topic: channel.kind for channel in reader.channels}
    for key, source in mapping.sources.items():
        if source.topic not in types:
            there = ", ".join(topic[:80] for topic in sorted(types)[:20]) or "none"
            raise ArgumentError(
                f"{mapping.file}, {key}.topic: there is no topic {source.topic!r} in "
                f"{', '.join(map(str, bags))}; there are {there}; give a bag that broke off early together with others"
            )
    cloud = mapping.cloud
    if cloud is not None and types[cloud.topic] != POINT_CLOUD:
        raise ArgumentError(
            f"{mapping.file}, cloud.topic: {cloud.topic} carries {types[cloud.topic]}, not {POINT_CLOUD}; name another"
        )


def read_events(bag: Path, mapping: BagMapping) -> list[list[Event]]:
    """Read all that the mapping names, by runs of its clock, which begin where it was reset.

    Each is in the order of the clock; equal stamps keep the order of the recording.

    Raises
    ------
    ArgumentError
        rosbags is not installed, or the mapping names a topic or field that is not there, or one of a wrong type.
    LogError
        The bag is missing or broken.
    """
    by_topic: dict[str, list[tuple[str, Source]]] = {}
    for key, source in mapping.sources.items():
        by_topic.setdefault(source.topic, []).append((key, source))
    events: list[tuple[int, Event]] = []
    with _opened(bag) as reader:
        wanted = [channel for channel in reader.channels if channel.topic in by_topic]
        num_clouds = 0
        for recorded in _messages(bag, reader, wanted):
            message, channel = _decoded(bag, recorded), recorded.channel
            stamp_ns = _stamp(message, recorded, mapping)
            for key, source in by_topic[channel.topic]:
                if key == "cloud":
                    value, num_clouds = num_clouds, num_clouds + 1
                else:
                    value = _value(
                        message, key, source, f"{mapping.file}, {key}.field: {source.topic} ({channel.kind})"
                    )
                events.append((recorded.log_ns, Event(stamp_ns, key, value)))
    events.sort(key=lambda entry: entry[0])
    numbers = runs_of([event.stamp_ns for _, event in events], [log_ns for log_ns, _ in events])
    runs: list[list[Event]] = [[] for _ in range(max(numbers, default=-1) + 1)]
    for number, (_, event) in zip(numbers, events, strict=True):
        runs[number].append(event)
    return [sorted(run, key=lambda event: event.stamp_ns) for run in runs]


def read_clouds(bag: Path, topic: str, wanted: set[int]) -> Iterator[tuple[int, Any]]:
    """Read some of a bag's clouds, one after the other: a recording of clouds is often larger than memory.

    Parameters
    ----------
    bag
        Folder or storage file of a bag.
    topic
        Topic of the clouds.
    wanted
        Their numbers, as in `Event`.

    Raises
    ------
    LogError
        The bag is broken.
    """
    with _opened(bag) as reader:
        channels = [channel for channel in reader.channels if channel.topic == topic]
        for number, recorded in enumerate(_messages(bag, reader, channels)):
            if number in wanted:
                yield number, _decoded(bag, recorded)


def points_of(message: Any, where: str) -> tuple[Float[np.ndarray, "n 3"], tuple[int, int]]:
    """Points of a PointCloud2 [m], and its rows and columns.

    Raises
    ------
    LogError
        It has no coordinates, or fewer bytes than it announces.
    """
    fields = {entry.name: entry for entry in message.fields}
    kinds = {axis: _FLOATS.get(fields[axis].datatype) for axis in "xyz" if axis in fields}
    if len(kinds) < 3 or None in kinds.values():
        raise LogError(f"{where}: its fields {', '.join(fields)} have no x, y and z of floats; record coordinates [m]")
    rows, columns = int(message.height), int(message.width)
    data = np.asarray(message.data, dtype=np.uint8)
    if len(data) != rows * message.row_step or columns * message.point_step > message.row_step:
        raise LogError(
            f"{where}: {len(data)} bytes are not the {rows} × {message.row_step} announced; it was cut short"
        )
    order = ">" if message.is_bigendian else "<"
    layout = np.dtype(
        {
            "names": list("xyz"),
            "formats": [order + str(kinds[axis]) for axis in "xyz"],
            "offsets": [fields[axis].offset for axis in "xyz"],
            "itemsize": int(message.point_step),
        }
    )
    lines = data.reshape(rows, message.row_step)[:, : columns * message.point_step]
    points = np.frombuffer(lines.tobytes(), dtype=layout)
    with np.errstate(invalid="ignore"):  # signalling NaN
        return np.stack([points[axis].astype(np.float64) for axis in "xyz"], axis=1), (rows, columns)


class _RosBag:
    """A bag that rosbags opens; it speaks as `McapFiles` does."""

    def __init__(self, files: list[Path]) -> None:
        highlevel, typesys = extra("rosbags.highlevel", "ros"), extra("rosbags.typesys", "ros")
        self._reader = highlevel.AnyReader(files, default_typestore=typesys.get_typestore(typesys.Stores.LATEST))
        self._reader.open()
        self.close = self._reader.close
        self._connections = {id(each): each for each in self._reader.connections}
        self.channels = [
            Channel(each.topic, each.msgtype, key, partial(self._decoded, each.msgtype))
            for key, each in self._connections.items()
        ]

    def _decoded(self, kind: str, content: bytes) -> Any:
        return self._reader.deserialize(content, kind)

    def messages(self, channels: Collection[Channel]) -> Iterator[Recorded]:
        by_key = {channel.key: channel for channel in channels}
        for each, log_ns, content in self._reader.messages(connections=[self._connections[key] for key in by_key]):
            yield Recorded(by_key[id(each)], log_ns, None, content)


@contextmanager
def _opened(bag: Path) -> Iterator[Any]:
    if not bag.exists():
        raise LogError(f"{bag}: there is no such bag; give the folder that `ros2 bag record` wrote, or its .mcap file")
    files = [bag]
    if bag.is_dir() and not (bag / "metadata.yaml").exists():  # the recorder died before it wrote that
        files = sorted(file for file in bag.iterdir() if file.suffix in STORAGES)
    if not files:
        raise LogError(f"{bag}: it holds no bag ({', '.join(STORAGES)}); give the folder that `ros2 bag record` wrote")
    with ExitStack() as stack:
        with _whole(bag):
            inside = [each for file in files for each in (file.iterdir() if file.is_dir() else [file])]
            inside = [each for each in inside if each in files or not each.is_dir()]
            for file in inside:
                check_file(file, TABLE)
            stored = sorted(file for file in inside if file.suffix != ".yaml")
            if stored and all(file.suffix == ".mcap" for file in stored):
                reader = McapFiles(stored)
            else:
                reader = _RosBag(files)
                stack.callback(reader.close)
            if not all(isinstance(word, str) for each in reader.channels for word in (each.topic, each.kind)):
                raise ValueError("a topic has a name or a type that is no text")
        yield reader


def _whole(bag: Path) -> Any:
    remedy = "mend it with `ros2 bag reindex` or `mcap recover`, then convert again"
    return refused(bag, "it is no whole bag", remedy, passed=(HalfseenError,))


def _messages(bag: Path, reader: Any, channels: list[Channel]) -> Iterator[Recorded]:
    with _whole(bag):
        for message in reader.messages(channels) if channels else ():
            if not isinstance(message.log_ns, int):
                raise ValueError("the time stamp of a message is no whole number")
            yield message


def _decoded(bag: Path, message: Recorded) -> Any:
    with _whole(bag):
        return message.channel.decode(message.content)


def _stamp(message: Any, recorded: Recorded, mapping: BagMapping) -> int:
    where = f"{mapping.file}, clock: {recorded.channel.topic} ({recorded.channel.kind})"
    if mapping.clock == "log":
        return recorded.log_ns
    if mapping.clock == "publish":
        if recorded.publish_ns is None:
            raise ArgumentError(f'{where} is of a bag that does not say when it was sent; say clock = "log"')
        return recorded.publish_ns
    stamp = _part(_part(message, "header"), "stamp")
    seconds, rest_ns = (
        next((part for name in names if (part := _part(stamp, name)) is not None), None)
        for names in (_SECONDS, _NANOSECONDS)
    )
    if not isinstance(seconds, int | np.integer) or not isinstance(rest_ns, int | np.integer):
        raise ArgumentError(f'{where} has no header.stamp; say clock = "log"')
    return int(seconds) * 10**9 + int(rest_ns)


def _part(value: Any, name: str) -> Any:
    """A field of a message; None where it has none."""
    return value.get(name) if isinstance(value, Mapping) else getattr(value, name, None)


def _value(message: Any, key: str, source: Source, where: str) -> Any:
    if source.field is None:  # a trajectory's beginning without a name
        return None
    value = message
    for step in source.field.split("."):
        value = _entered(value, step, source.field, where)
    value = value.item() if isinstance(value, np.generic) else value
    if not isinstance(value, str | bool | int | float):
        raise ArgumentError(f"{where}, field {source.field!r} is no single value; name {_inside(value, source.field)}")
    _check_kind(value, key, f"{where}, field {source.field!r} is {value!r}")
    return value


def _entered(value: Any, step: str, path: str, where: str) -> Any:
    if re.fullmatch(r"[0-9]+", step) and isinstance(value, list | np.ndarray):
        if int(step) >= len(value):
            raise ArgumentError(f"{where}, field {path!r}: there are {len(value)} entries, counted from 0; name one")
        return value[int(step)]
    if step not in _fields(value):
        raise ArgumentError(f"{where} has no field {path!r}; name {_inside(value, '')}")
    return _part(value, step)


def _fields(value: Any) -> list[str]:
    """What a message, or a part of one, consists of, by name."""
    if isinstance(value, Mapping):
        return list(value)
    return [name for name in getattr(value, "__dataclass_fields__", {}) if not name.startswith("_")]


def _inside(value: Any, path: str) -> str:
    """What a path could go on with."""
    prefix = f"{path}." if path else ""
    if isinstance(value, list | np.ndarray):
        return f"one of its {len(value)} entries, {prefix}0 to {prefix}{len(value) - 1}" if len(value) else "another"
    return ", ".join(prefix + name for name in _fields(value)[:40]) or "a field above it"


def _check_kind(value: Any, key: str, what: str) -> None:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if key in ("reward", "probability") and not is_number:
        raise ArgumentError(f"{what}, no number; name another field")
    is_name = isinstance(value, str) or (isinstance(value, int) and is_number)
    if key in ("action", "object", "trajectory") and not is_name:
        raise ArgumentError(f"{what}, neither text nor a whole number; name another field")
