"""Mapped messages of bags, in the order of a clock, with their fields read by path.

A simulation's clock falls back at a reset, and later messages belong to another run. A small fall is not a reset,
since messages of several topics arrive slightly out of order. Neither is a fall of some seconds after which the clock
goes on as before: that message was late. Just after a reset some messages may still belong to the run before. The
recording times distinguish these cases.
"""

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from halfseen.errors import ArgumentError, LogError, warn
from halfseen.logs.formats.bag_fields import AbsentEntryError, part, value_of
from halfseen.logs.formats.bag_files import BagMessage, decoded, messages_of, opened_bag
from halfseen.logs.formats.mapping import BagMapping, ValueSource
from halfseen.shapes import Float

POINT_CLOUD = "sensor_msgs/msg/PointCloud2"

_SECONDS, _NANOSECONDS = ("sec", "seconds", "secs"), ("nanosec", "nsec", "nanos", "nsecs")
# Types of a PointCloud2's fields [ROS's numbers]; coordinates are one of these.
_FLOATS = {7: "f4", 8: "f8"}

JITTER_NS = 10**9
"""Largest fall of stamps without a reset, and how long after a reset messages of the run before may come [ns]."""
EARLIEST_DATE_NS = 10**18
"""Larger stamps are dates, not counted from where a controller or a simulation started [ns since 1970]."""
MOST_LATE_NS = 5 * 10**9
"""Largest delay of a late message after which the clock goes on as before [ns]."""


_DEEDS = ("trajectory", "action", "reward", "ending")
"""Keys of values that come once at one time."""
LONGEST_REPEAT_NS = 10**6
"""Messages that are equal and have one stamp are one if recorded within this; simulations repeat stamps later [ns]."""


class Event(NamedTuple):
    """One value in a message or in a row of a table."""

    stamp_ns: int
    """Time on the clock of the mapping [ns]."""
    key: str
    """Its table in the mapping file, such as ``reward`` or ``covariates.occlusion``."""
    value: Any
    """Text, a number or a boolean; for a cloud its number among the bag's clouds, to be read by `read_clouds`."""
    place: str = ""
    """Its place, as the prefix of error messages; empty in a bag, whose reader names the bag."""


def check_topics(bags: list[Path], mapping: BagMapping) -> None:
    """Refuse a mapping with a topic that none of the bags has; a bag that broke off early may lack some.

    Raises
    ------
    ArgumentError
        There is no such topic, or the topic of the clouds has another type.
    LogError
        A bag is missing or broken.
    """
    types: dict[str, str] = {}
    for bag in bags:
        with opened_bag(bag) as reader:
            types |= {channel.topic: channel.kind for channel in reader.channels}
    for key, source in mapping.sources.items():
        if source.topic not in types:
            there = ", ".join(topic[:80] for topic in sorted(types)[:20]) or "none"
            raise ArgumentError(
                f"{mapping.file}, {key}.topic: there is no topic {source.topic!r} in {', '.join(map(str, bags))}; "
                f"there are {there}; convert a bag that ended early together with others"
            )
    cloud = mapping.cloud
    if cloud is not None and types[cloud.topic] != POINT_CLOUD:
        raise ArgumentError(
            f"{mapping.file}, cloud.topic: {cloud.topic} carries {types[cloud.topic]}, not {POINT_CLOUD}; name another"
        )


def read_events(bag: Path, mapping: BagMapping, named: dict[str, str]) -> list[list[Event]]:
    """Read all mapped values, by runs of the clock; a run begins where the clock was reset.

    Each run is in the order of the clock; equal stamps keep the order of the recording. `named` is that of `value_of`,
    for all bags that are read together.

    Raises
    ------
    ArgumentError
        rosbags is not installed, or the mapping names a topic or field that is missing or has the wrong type.
    LogError
        The bag is missing or broken.
    """
    by_topic: dict[str, list[tuple[str, ValueSource]]] = {}
    for key, source in mapping.sources.items():
        by_topic.setdefault(source.topic, []).append((key, source))
    events: list[tuple[int, Event]] = []
    absent: dict[str, AbsentEntryError] = {}
    done: dict[Event, int] = {}
    num_repeats = 0
    with opened_bag(bag) as reader:
        wanted = [channel for channel in reader.channels if channel.topic in by_topic]
        num_clouds = 0
        for recorded in messages_of(bag, reader, wanted):
            message, channel = decoded(bag, recorded), recorded.channel
            stamp_ns = _stamp(message, recorded, mapping)
            for key, source in by_topic[channel.topic]:
                if key == "cloud":
                    value, num_clouds = num_clouds, num_clouds + 1
                else:
                    where = f"{mapping.file}, {key}.field: {source.topic} ({channel.kind})"
                    try:
                        value = value_of(message, key, source.field, where, named)
                    except AbsentEntryError as error:
                        absent[key] = error
                        continue
                event = Event(stamp_ns, key, value)
                if key in _DEEDS:
                    before_ns, done[event] = done.get(event, -LONGEST_REPEAT_NS), recorded.log_ns
                    if abs(recorded.log_ns - before_ns) < LONGEST_REPEAT_NS:
                        num_repeats += 1
                        continue
                events.append((recorded.log_ns, event))
    if num_repeats:
        warn(bag, f"{num_repeats:,} messages repeat one of the same time, as where a topic was recorded twice; skipped")
    for key in absent.keys() - {event.key for _, event in events}:
        raise absent[key]
    _refuse_unset(bag, [event for _, event in events], mapping)
    events.sort(key=lambda entry: entry[0])
    numbers = runs_of([event.stamp_ns for _, event in events], [log_ns for log_ns, _ in events])
    runs: list[list[Event]] = [[] for _ in range(max(numbers, default=-1) + 1)]
    for number, (_, event) in zip(numbers, events, strict=True):
        runs[number].append(event)
    return [sorted(run, key=lambda event: event.stamp_ns) for run in runs]


def _refuse_unset(bag: Path, events: Sequence[Event], mapping: BagMapping) -> None:
    """Refuse stamps of 0 beside dates: they were not set, or came before a simulation's clock (`LogError`)."""
    unset = next((event for event in events if event.stamp_ns == 0), None)
    if unset is not None and any(event.stamp_ns >= EARLIEST_DATE_NS for event in events):
        clocks = " or ".join(repr(clock) for clock in ("log", "publish", "header") if clock != mapping.clock)
        raise LogError(
            f"{bag}: a message of {mapping.sources[unset.key].topic} has the time 0 by clock {mapping.clock!r}, and "
            f"others have dates; set clock = {clocks} in {mapping.file}, or leave such messages out"
        )


def runs_of(stamps_ns: Sequence[int], recorded_ns: Sequence[int]) -> list[int]:
    """Number the run, from 0, of each of N messages.

    Parameters
    ----------
    stamps_ns
        Clock of each message [ns].
    recorded_ns
        When it was recorded [ns]; never decreases.
    """
    # Python integers: a broken stamp may have any number of digits.
    ahead_ns = [stamp_ns - at_ns for stamp_ns, at_ns in zip(stamps_ns, recorded_ns, strict=True)]
    runs: list[int] = []
    run = reset_ns = highest_ns = 0
    now = before = 0  # how far the clock is ahead of the recorder's, in this run and in the one before
    for k, (stamp_ns, offset) in enumerate(zip(stamps_ns, ahead_ns, strict=True)):
        if run and recorded_ns[k] - reset_ns <= JITTER_NS and abs(offset - before) < abs(offset - now):
            runs.append(run - 1)
            continue
        is_fall = bool(runs) and stamp_ns < highest_ns - JITTER_NS
        if is_fall and not (now - offset <= MOST_LATE_NS and _goes_on(k, now, ahead_ns, recorded_ns)):
            run, reset_ns, before = run + 1, recorded_ns[k], now
            highest_ns, now = stamp_ns, offset
        elif not runs or stamp_ns > highest_ns:
            highest_ns, now = stamp_ns, offset
        runs.append(run)
    return runs


def _goes_on(k: int, now: int, ahead_ns: Sequence[int], recorded_ns: Sequence[int]) -> bool:
    """Whether the clock goes on after message k as if it had not come, rather than from its stamp."""
    begin = bisect_right(recorded_ns, recorded_ns[k] + JITTER_NS)
    end = bisect_right(recorded_ns, recorded_ns[k] + 2 * JITTER_NS)
    return any(abs(each - now) < abs(each - ahead_ns[k]) for each in ahead_ns[begin : max(end, begin + 1)])


def read_clouds(bag: Path, topic: str, wanted: set[int]) -> Iterator[tuple[int, Any]]:
    """Read some of a bag's clouds one by one: a recording of clouds is often larger than memory.

    Parameters
    ----------
    bag
        Folder or storage file of a bag.
    topic
        Topic of the clouds.
    wanted
        Numbers of the clouds, as in `Event`.

    Raises
    ------
    LogError
        The bag is broken.
    """
    with opened_bag(bag) as reader:
        channels = [channel for channel in reader.channels if channel.topic == topic]
        for number, recorded in enumerate(messages_of(bag, reader, channels)):
            if number in wanted:
                yield number, decoded(bag, recorded)


def points_of(message: Any, where: str) -> tuple[Float[np.ndarray, "n 3"], tuple[int, int]]:
    """Points of a PointCloud2 [m], and its numbers of rows and columns.

    Raises
    ------
    LogError
        The cloud has no coordinates, or fewer bytes than declared.
    """
    fields = {entry.name: entry for entry in message.fields}
    kinds = {axis: _FLOATS.get(fields[axis].datatype) for axis in "xyz" if axis in fields}
    if len(kinds) < 3 or None in kinds.values():
        raise LogError(f"{where}: its fields {', '.join(fields)} lack x, y and z as floats; record coordinates [m]")
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


def _stamp(message: Any, recorded: BagMessage, mapping: BagMapping) -> int:
    where = f"{mapping.file}, clock: {recorded.channel.topic} ({recorded.channel.kind})"
    if mapping.clock == "log":
        return recorded.log_ns
    if mapping.clock == "publish":
        if recorded.publish_ns is None:
            raise ArgumentError(f'{where} comes from a bag without send times; set clock = "log"')
        return recorded.publish_ns
    stamp = part(part(message, "header"), "stamp")
    seconds, rest_ns = (
        next((found for name in names if (found := part(stamp, name)) is not None), None)
        for names in (_SECONDS, _NANOSECONDS)
    )
    if not isinstance(seconds, int | np.integer) or not isinstance(rest_ns, int | np.integer):
        raise ArgumentError(f'{where} has no header.stamp; set clock = "log"')
    return int(seconds) * 10**9 + int(rest_ns)
