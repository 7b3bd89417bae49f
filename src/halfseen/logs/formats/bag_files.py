"""Reading bag files by channel: ROS bags, and MCAP files with ROS 2 (CDR), JSON and protobuf messages, also mixed.

Every MCAP chunk is unpacked within bounds and checked against its checksum. A ROS message is read as an object, any
other as nested dicts, lists and plain values.
"""

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import cache, partial
from io import BufferedReader
from pathlib import Path
from typing import Any, NamedTuple

from halfseen.errors import HalfseenError, LogError
from halfseen.installation import extra
from halfseen.logs.formats.sqlite_file import check_sqlite
from halfseen.reading import TABLE, check_file, check_unpacked, json_of, opened, refused

STORAGES = (".mcap", ".db3", ".bag")
ENCODINGS = ("cdr", "json", "protobuf")
_IDL_LINE = "=" * 80 + "\n"


class Channel(NamedTuple):
    """A stream of messages of one type under a topic."""

    topic: str
    kind: str
    key: Any
    """Identifies the channel within its bag."""
    decode: Callable[[bytes], Any]
    """Decodes bytes into a message; broken bytes raise almost any exception."""


class BagMessage(NamedTuple):
    """A message as it was recorded."""

    channel: Channel
    log_ns: int
    publish_ns: int | None
    """When it was sent [ns]; `log_ns` is when it was recorded [ns]. None if the bag does not say."""
    content: bytes


@contextmanager
def opened_bag(bag: Path) -> Iterator[Any]:
    """Open a bag, a folder or a storage file, as a reader with ``channels``; a broken bag is refused."""
    if not bag.exists():
        raise LogError(f"{bag}: no such bag; give the folder that `ros2 bag record` wrote, or its .mcap file")
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
                if file.suffix == ".db3":
                    check_sqlite(file)
            stored = sorted(file for file in inside if file.suffix != ".yaml")
            if stored and all(file.suffix == ".mcap" for file in stored):
                reader = _McapFiles(stored)
            else:
                reader = _RosBag(files)
                stack.callback(reader.close)
            if not all(isinstance(word, str) for each in reader.channels for word in (each.topic, each.kind)):
                raise ValueError("a topic has a name or a type that is not text")
        yield reader


def _whole(bag: Path) -> Any:
    remedy = "repair it with `ros2 bag reindex` or `mcap recover`, then convert again"
    return refused(bag, "it is not a complete bag", remedy, passed=(HalfseenError,))


def messages_of(bag: Path, reader: Any, channels: list[Channel]) -> Iterator[BagMessage]:
    """Read the messages of some channels of an opened bag, in the order of its files (`LogError`)."""
    with _whole(bag):
        for message in reader.messages(channels) if channels else ():
            if not isinstance(message.log_ns, int):
                raise ValueError("the timestamp of a message is not a whole number")
            yield message


def decoded(bag: Path, message: BagMessage) -> Any:
    """Decode a message (`LogError`)."""
    with _whole(bag):
        return message.channel.decode(message.content)


class _RosBag:
    """A bag read by rosbags, with the interface of `_McapFiles`."""

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

    def messages(self, channels: Collection[Channel]) -> Iterator[BagMessage]:
        by_key = {channel.key: channel for channel in channels}
        for each, log_ns, content in self._reader.messages(connections=[self._connections[key] for key in by_key]):
            yield BagMessage(by_key[id(each)], log_ns, None, content)


class _McapFiles:
    """Messages of consecutive MCAP files; a broken file raises almost any exception."""

    def __init__(self, files: Sequence[Path]) -> None:
        extra("mcap", "mcap")
        self._files = files
        self.channels = [channel for number, file in enumerate(files) for channel in _channels(number, file)]

    def messages(self, channels: Collection[Channel]) -> Iterator[BagMessage]:
        wanted = {channel.key: channel for channel in channels}
        message = extra("mcap.records", "mcap").Message
        for number, file in enumerate(self._files):
            for record in _records(file):
                if isinstance(record, message) and (number, record.channel_id) in wanted:
                    channel = wanted[number, record.channel_id]
                    yield BagMessage(channel, record.log_time, record.publish_time, record.data)


def _channels(number: int, file: Path) -> Iterator[Channel]:
    schemas, channels = _described(file)
    for channel in channels.values():
        schema, encoding = schemas.get(channel.schema_id), channel.message_encoding
        decoder = cache(partial(_decoder, schema, encoding))
        kind = encoding if schema is None else schema.name
        yield Channel(channel.topic, kind, (number, channel.id), lambda content, made=decoder: made()(content))


def _described(file: Path) -> tuple[dict[int, Any], dict[int, Any]]:
    """Schemas and channels by their numbers, from the summary or, without one, from all records."""
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
    """Unpack a chunk, up to its declared size."""
    size = chunk.uncompressed_size
    check_unpacked(len(chunk.data), size)
    if chunk.compression == "zstd":
        data = extra("zstandard", "mcap").ZstdDecompressor().stream_reader(chunk.data).read(size + 1)
    elif chunk.compression == "lz4":
        data = extra("lz4.frame", "mcap").LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    elif chunk.compression == "":
        data = chunk.data
    else:
        raise ValueError(
            f"a chunk is compressed by {chunk.compression[:40]!r}; zstd, lz4 and no compression are supported"
        )
    if len(data) != size:
        raise ValueError(f"a chunk says that it has {size} bytes uncompressed, but has another number")
    return data


class _Bounded:
    """A file whose reads are limited to its actual size, whatever sizes its contents declare."""

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
        return lambda content: json_of(content.decode("utf-8"), any_number=True)
    if encoding == "protobuf":
        decode = extra("mcap_protobuf.decoder", "mcap").DecoderFactory().decoder_for(encoding, schema)
        if decode is None:
            raise ValueError("a protobuf channel has no protobuf schema")
        return lambda content: _plain(decode(content))
    if encoding == "cdr" and schema is not None:
        return _of_ros(schema)
    raise ValueError(f"messages are of encoding {encoding[:40]!r}, but only {', '.join(ENCODINGS)} are supported")


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
        raise ValueError(f"the schema of {schema.name[:80]} is of {schema.encoding[:40]!r}, not an encoding of ROS 2")
    store = typesys.get_typestore(typesys.Stores.EMPTY)
    store.register(types)
    return lambda content: store.deserialize_cdr(content, schema.name)


def _plain(message: Any) -> dict[str, Any]:
    """A protobuf message as a dict: enum values by name, unset messages as null."""
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
