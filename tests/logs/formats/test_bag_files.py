"""MCAP written message by message with its own library: each encoding is the log that rosbags' bag of the same is."""

import json

import numpy as np
import pandas as pd
import pytest
from mcap.writer import CompressionType

from bags import (
    FILES,
    SCHEMAS,
    Said,
    as_json,
    as_json_without_schema,
    as_protobuf,
    as_ros,
    cloud,
    mapping_for,
    mixed,
    tables_of,
    two_trajectories,
    write_mcap,
)
from halfseen.errors import ArgumentError
from halfseen.logs.formats import MAPPING_TEMPLATE, bag_files, read_bag
from refusals import refused


@pytest.mark.parametrize("encode", [as_json, as_json_without_schema, as_protobuf, as_ros, mixed])
def test_each_encoding_is_the_log_of_the_bag_of_ros(read, read_mcap, encode):
    wanted, logs = read(two_trajectories()), read_mcap(two_trajectories(), encode)
    pd.testing.assert_frame_equal(logs.stages, wanted.stages)
    pd.testing.assert_frame_equal(logs.trajectories.drop(columns="bag"), wanted.trajectories.drop(columns="bag"))


def test_each_way_to_write_it_is_the_same_log(read_mcap):
    wanted = read_mcap(two_trajectories(), mixed)
    for options in (
        {"compression": CompressionType.NONE},
        {"compression": CompressionType.LZ4},
        {"use_chunking": False},
        {"use_statistics": False},
        {"chunk_size": 100},
        {"repeat_channels": False, "repeat_schemas": False, "use_summary_offsets": False},
        {"enable_crcs": False},
        {"enable_data_crcs": True},
    ):
        pd.testing.assert_frame_equal(read_mcap(two_trajectories(), mixed, **options).stages, wanted.stages)


def test_the_clock_may_be_when_it_was_sent(bag, mapping, read_mcap):
    rng, late = np.random.default_rng(0), mapping_for(as_json, "publish")
    logs = read_mcap(two_trajectories(), as_json, late, late_ns=lambda: int(rng.integers(10**9)))
    pd.testing.assert_frame_equal(logs.stages, read_mcap(two_trajectories(), as_json).stages)
    with refused(r'clock: .* comes from a bag without send times; set clock = "log"', ArgumentError):
        read_bag(bag(two_trajectories(), storage="sqlite3"), mapping(mapping_for(as_ros, "publish")))


@pytest.mark.parametrize("encoding", ["json", "protobuf"])
def test_fields_of_other_encodings_and_their_header_as_the_clock(read_mcap, encoding):
    def encode(topic, kind, said):
        if encoding == "protobuf":
            return encoding, SCHEMAS[encoding], said.SerializeToString()
        parts = {"text": said.text, "number": said.number, "counts": list(said.counts), "shares": dict(said.shares)}
        stamp = {"sec": said.header.stamp.sec, "nsec": said.header.stamp.nsec}
        return encoding, SCHEMAS[encoding], json.dumps({**parts, "header": {"stamp": stamp}}).encode()

    def said(sec, nsec=0, **parts):
        return Said(header={"stamp": {"sec": sec, "nsec": nsec}}, **parts)

    messages = [
        (0.0, "/x", "", said(10, counts=[3, 2**60], shares={"cup": 0.25})),
        (0.1, "/action", "", said(11, text="A")),
        (0.2, "/reward", "", said(12, 500_000_000, number=2.0)),
        (0.3, "/end", "", said(13, text="finished")),
    ]
    tables = {"action": "/action text", "reward": "/reward number", "ending": "/end text"}
    tables |= {"covariates.count": "/x counts.1", "covariates.share": "/x shares.cup"}
    text = 'clock = "header"\n' + tables_of(tables)
    logs = read_mcap(messages, encode, text)
    assert (logs.elapsed_s().tolist(), logs.end_s.tolist()) == ([[2.5]], [3.0])
    assert logs.stages[["count", "share"]].to_numpy().tolist() == [[2**60, 0.25]]
    for field, message in (
        ("shares", r"is not a single value; name shares\.cup"),
        ("shares.mug", r"has no field 'shares\.mug'; name cup"),
        ("counts.7", "there are 2 entries"),
        ("header", r"name header\.stamp"),
    ):
        with refused(message, ArgumentError):
            read_mcap(messages, encode, text.replace('"shares.cup"', f'"{field}"'))


def test_what_is_not_set_in_protobuf_is_reported(read_mcap):
    for field in ("header", "raw"):
        message = mapping_for(as_protobuf).replace('field = "text"', f'field = "{field}"')
        with refused(rf"field '{field}' is not a single value", ArgumentError):
            read_mcap(
                two_trajectories(),
                lambda *_: ("protobuf", SCHEMAS["protobuf"], Said(raw=b"x").SerializeToString()),
                message,
            )


@pytest.mark.parametrize(
    ("encoding", "schema", "content", "message"),
    [
        ("json", SCHEMAS["json"], b"{", "not a complete bag"),
        ("json", SCHEMAS["json"], b"[" * 1000 + b"]" * 1000, "nested more than 64 levels"),
        ("json", SCHEMAS["json"], b'{"data": NaN}', "field 'data' is nan, neither text nor a whole number"),
        ("json", SCHEMAS["json"], b"\xff\xfe", "decode"),
        ("protobuf", SCHEMAS["protobuf"], b"\xff\xff", "not a complete bag"),
        ("protobuf", ("cell.Other", "protobuf", FILES.SerializeToString()), b"", r"cell\.Other"),
        ("protobuf", ("cell.Said", "protobuf", b"\xff"), b"", "not a complete bag"),
        ("protobuf", SCHEMAS["json"], b"", "a protobuf channel has no protobuf schema"),
        ("cdr", None, b"", "messages are of encoding 'cdr'"),
        ("cdr", SCHEMAS["json"], b"", "the schema of cell.Said is of 'jsonschema', not an encoding of ROS 2"),
        ("cdr", ("std_msgs/msg/String", "ros2msg", b"string data"), b"\0", "not a complete bag"),
        ("flatbuffer", None, b"", "messages are of encoding 'flatbuffer', but only cdr, json, protobuf are supported"),
    ],
)
def test_messages_that_are_none_are_reported(read_mcap, encoding, schema, content, message):
    with refused(message):
        read_mcap(two_trajectories(), lambda *_: (encoding, schema, content), mapping_for(as_json))


def test_channels_that_nobody_names_need_not_be_known_and_those_that_are_named_must_be_there(read_mcap):
    def encode(topic, kind, message):
        return ("flatbuffer", None, b"") if topic == "/other" else as_json(topic, kind, message)

    messages = [*two_trajectories(), (14.0, "/other", "", None)]
    assert read_mcap(messages, encode, mapping_for(as_json)).num_trajectories == 2
    with refused(r"no topic '/pick/action' in .*; there are /camera/occlusion, /episode/begin"):
        read_mcap(two_trajectories()[:3], as_json)


def test_a_wrong_checksum_is_reported(tmp_path, mapping):
    file = write_mcap(tmp_path / "a.mcap", two_trajectories(), as_json, compression=CompressionType.NONE)
    content = file.read_bytes()
    assert content.count(b"monday-2") == 1
    file.write_bytes(content.replace(b"monday-2", b"monday-3"))
    with refused(r"a\.mcap: it is not a complete bag \(crc validation failed in Chunk"):
        read_bag(file, mapping(mapping_for(as_json)))


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4])
def test_a_chunk_of_few_bytes_and_many_or_of_more_than_it_says_is_refused(read_mcap, monkeypatch, compression):
    def padded(topic, kind, message):
        return "json", None, json.dumps({"data": message.data, "pad": "a" * 3 * 10**5}).encode()

    with monkeypatch.context() as patch:
        patch.setattr("halfseen.reading.ALWAYS_UNPACKED", 10**6)
        with refused(r"unpacked, it has 6 MB, and at most"):
            read_mcap(two_trajectories(), padded, mapping_for(as_json), compression=compression, chunk_size=10**8)
    unpacked = bag_files._unpacked

    def less(chunk):
        chunk.uncompressed_size -= 5
        return unpacked(chunk)

    monkeypatch.setattr(bag_files, "_unpacked", less)
    with refused("a chunk says that it has .* bytes uncompressed, but has another"):
        read_mcap(two_trajectories(), as_json, compression=compression, enable_crcs=False)


def test_clouds_of_ros_stand_beside_other_encodings(tmp_path, mapping):
    points = np.arange(18.0).reshape(6, 3)
    clouds = [cloud(1.2, "/camera/points", points, (2, 3)), cloud(11.3, "/camera/points", points + 1, (2, 3))]
    messages = sorted([*two_trajectories(), *clouds], key=lambda message: message[0])
    file = write_mcap(tmp_path / "a.mcap", messages, lambda t, *of: (as_ros if "points" in t else as_json)(t, *of))
    kept = []

    def keep(points_m, shape, name):
        kept.append((points_m[0, 0], shape))
        return f"{name}.pcd"

    logs = read_bag(file, mapping(MAPPING_TEMPLATE), keep=keep)
    assert kept == [(0.0, (2, 3)), (1.0, (2, 3))]
    assert logs.stages["cloud"].tolist() == ["a-0.pcd", "a-0.pcd", "a-1.pcd", "a-1.pcd"]
    with refused(r"/camera/occlusion carries cell\.Said, not sensor_msgs", ArgumentError):
        read_bag(file, mapping(MAPPING_TEMPLATE.replace("/camera/points", "/camera/occlusion")))
