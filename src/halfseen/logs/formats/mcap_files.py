"""MCAP files, channel by channel: messages of ROS 2 (CDR), JSON and protobuf, also mixed in one file.

Every chunk is unpacked within bounds and checked against its checksum. A ROS message comes as an object, any other as
nested dicts, lists and plain values.
"""

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import replace
from functools import cache, partial
from io import BufferedReader
from pathlib import Path
from typing import Any, NamedTuple

from halfseen.installation import extra
from halfseen.reading import TABLE, check_unpacked, json_of, opened

ENCODINGS = ("cdr", "json", "protobuf")
_IDL_LINE = "=" * 80 + "\n"


class Channel(NamedTuple):
    """What carries messages of one type under a topic.

    Parameters
    ----------
    topic
        Its name.
    kind
        Type of its messages.
    key
        What tells it from the others of its bag.
    decode
        Makes a message of bytes; of broken ones it raises nearly anything.
    """

    topic: str
    kind: str
    key: Any
    decode: Callable[[bytes], Any]


class Recorded(NamedTuple):
    """A message as it was recorded.

    Parameters
    ----------
    channel
        Which carried it.
    log_ns, publish_ns
        When it was recorded, and when it was sent [ns]; None where the bag does not say.
    content
        Its bytes.
    """

    channel: Channel
    log_ns: int
    publish_ns: int | None
    content: bytes


class McapFiles:
    """Messages of MCAP files that follow one another; a broken file raises nearly anything."""

    def __init__(self, files: Sequence[Path]) -> None:
        extra("mcap", "mcap")
        self._files = files
        self.channels = [channel for number, file in enumerate(files) for channel in _channels(number, file)]

    def messages(self, channels: Collection[Channel]) -> Iterator[Recorded]:
        """Read the messages of some channels in the order of the files."""
        wanted = {channel.key: channel for channel in channels}
        message = extra("mcap.records", "mcap").Message
        for number, file in enumerate(self._files):
            for record in _records(file):
                if isinstance(record, message) and (number, record.channel_id) in wanted:
                    channel = wanted[number, record.channel_id]
                    yield Recorded(channel, record.log_time, record.publish_time, record.data)


def _channels(number: int, file: Path) -> Iterator[Channel]:
    schemas, channels = _described(file)
    for channel in channels.values():
        schema, encoding = schemas.get(channel.schema_id), channel.message_encoding
        decoder = cache(partial(_decoder, schema, encoding))
        kind = encoding if schema is None else schema.name
        yield Channel(channel.topic, kind, (number, channel.id), lambda content, made=decoder: made()(content))


def _described(file: Path) -> tuple[dict[int, Any], dict[int, Any]]:
    """Schemas and channels by their numbers: as the summary says, or, where there is none, from all that is there."""
    with opened(file, TABLE) as content:
        summary = extra("mcap.reader", "mcap").SeekingReader(_Bounded(content)).get_summary()
    counted = None if summary is None or summary.statistics is None else summary.statistics.channel_count
    if summary is not None and len(summary.channels) == counted:
        return summary.schemas, summary.channels
    records = extra("mcap.records", "mcap")
    schemas, channels = {}, {}
    for record in _records(file):
        if isinstance(record, records.Schema):
            schemas[record.id] = record
        elif isinstance(record, records.Channel):
            channels[record.id] = record
    return schemas, channels


def _records(file: Path) -> Iterator[Any]:
    stream, chunk = extra("mcap.stream_reader", "mcap"), extra("mcap.records", "mcap").Chunk
    with opened(file, TABLE) as content:
        for record in stream.StreamReader(_Bounded(content), emit_chunks=True, validate_crcs=True).records:
            if isinstance(record, chunk):
                unpacked = replace(record, compression="", data=_unpacked(record))
                yield from stream.breakup_chunk(unpacked, validate_crc=True)
            else:
                yield record


def _unpacked(chunk: Any) -> bytes:
    """Unpack no more of a chunk than it says to hold."""
    size = chunk.uncompressed_size
    check_unpacked(len(chunk.data), size)
    if chunk.compression == "zstd":
        data = extra("zstandard", "mcap").ZstdDecompressor().stream_reader(chunk.data).read(size + 1)
    elif chunk.compression == "lz4":
        data = extra("lz4.frame", "mcap").LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    elif chunk.compression == "":
        data = chunk.data
    else:
        raise ValueError(f"a chunk is packed by {chunk.compression[:40]!r}, and zstd, lz4 and none are known")
    if len(data) != size:
        raise ValueError(f"a chunk says that it has {size} bytes unpacked, and has other than that")
    return data


class _Bounded:
    """A file of which no more is asked for than it has, whatever it says itself."""

    def __init__(self, file: BufferedReader) -> None:
        self._file = file
        self._size = file.seek(0, 2)
        file.seek(0)

    def read(self, size: int = -1) -> bytes:
        return self._file.read(min(size, self._size))

    def seek(self, offset: int, whence: int = 0) -> int:
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        return self._file.tell()

    def seekable(self) -> bool:
        return True


def _decoder(schema: Any, encoding: str) -> Callable[[bytes], Any]:
    if encoding == "json":
        return lambda content: json_of(content.decode("utf-8"))
    if encoding == "protobuf":
        decode = extra("mcap_protobuf.decoder", "mcap").DecoderFactory().decoder_for(encoding, schema)
        if decode is None:
            raise ValueError("a channel of protobuf has no schema of protobuf")
        return lambda content: _plain(decode(content))
    if encoding == "cdr" and schema is not None:
        return _of_ros(schema)
    raise ValueError(f"messages are of encoding {encoding[:40]!r}, and {', '.join(ENCODINGS)} are known")


def _of_ros(schema: Any) -> Callable[[bytes], Any]:
    typesys = extra("rosbags.typesys", "ros")
    text = schema.data.decode()
    if schema.encoding == "ros2msg":
        types = typesys.get_types_from_msg(text, schema.name)
    elif schema.encoding in ("ros2idl", "omgidl"):
        parts = (
            [part.partition("\n")[2] for part in text.split(_IDL_LINE)[1:]] if text.startswith(_IDL_LINE) else [text]
        )
        types = {name: kind for part in parts for name, kind in typesys.get_types_from_idl(part).items()}
    else:
        raise ValueError(f"the schema of {schema.name[:80]} is of {schema.encoding[:40]!r}, no form of ROS 2")
    store = typesys.get_typestore(typesys.Stores.EMPTY)
    store.register(types)
    return lambda content: store.deserialize_cdr(content, schema.name)


def _plain(message: Any) -> dict[str, Any]:
    """A message of protobuf as a dict: enumerated values by their names, messages that are not set as null."""
    return {field.name: _field(message, field) for field in message.DESCRIPTOR.fields}


def _field(message: Any, field: Any) -> Any:
    value = getattr(message, field.name)
    if field.is_repeated:
        if field.message_type is not None and field.message_type.GetOptions().map_entry:
            entry = field.message_type.fields_by_name["value"]
            return {str(key): _single(each, entry) for key, each in value.items()}
        return [_single(each, field) for each in value]
    return None if field.message_type is not None and not message.HasField(field.name) else _single(value, field)


def _single(value: Any, field: Any) -> Any:
    if field.message_type is not None:
        return _plain(value)
    if field.enum_type is not None:
        named = field.enum_type.values_by_number.get(value)
        return value if named is None else named.name
    return value
