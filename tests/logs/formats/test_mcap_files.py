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
    mapping,
    mixed,
    tables_of,
    two_paths,
    write_bag,
    write_mcap,
)
from halfseen.errors import ArgumentError, HalfseenError
from halfseen.logs.formats import MAPPING_TEMPLATE, mcap_files, read_bag

ENCODINGS = [as_json, as_json_without_schema, as_protobuf, as_ros, mixed]


@pytest.mark.parametrize("encode", ENCODINGS)
def test_each_encoding_is_the_log_of_the_bag_of_ros(tmp_path, encode):
    wanted = read_bag(write_bag(tmp_path / "bag", two_paths()), mapping(tmp_path, as_ros))
    logs = read_bag(write_mcap(tmp_path / "cell.mcap", two_paths(), encode), mapping(tmp_path, encode))
    pd.testing.assert_frame_equal(logs.stages, wanted.stages)
    pd.testing.assert_frame_equal(logs.paths.drop(columns="bag"), wanted.paths.drop(columns="bag"))


@pytest.mark.parametrize(
    "options",
    [
        {"compression": CompressionType.NONE},
        {"compression": CompressionType.LZ4},
        {"use_chunking": False},
        {"use_statistics": False},
        {"chunk_size": 100},
        {"repeat_channels": False, "repeat_schemas": False, "use_summary_offsets": False},
        {"enable_crcs": False},
        {"enable_data_crcs": True},
    ],
)
def test_each_way_to_write_it_is_the_same_log(tmp_path, options):
    file = mapping(tmp_path, mixed)
    wanted = read_bag(write_mcap(tmp_path / "a.mcap", two_paths(), mixed), file)
    logs = read_bag(write_mcap(tmp_path / "b.mcap", two_paths(), mixed, **options), file)
    pd.testing.assert_frame_equal(logs.stages, wanted.stages)


def test_the_clock_may_be_when_it_was_sent(tmp_path):
    wanted = read_bag(write_mcap(tmp_path / "a.mcap", two_paths(), as_json), mapping(tmp_path, as_json))
    rng = np.random.default_rng(0)
    file = write_mcap(tmp_path / "b.mcap", two_paths(), as_json, late_ns=lambda: int(rng.integers(10**9)))
    pd.testing.assert_frame_equal(read_bag(file, mapping(tmp_path, as_json, "publish")).stages, wanted.stages)
    bag = write_bag(tmp_path / "bag", two_paths())
    with pytest.raises(ArgumentError, match=r'clock: .* does not say when it was sent; say clock = "log"'):
        read_bag(bag, mapping(tmp_path, as_ros, "publish"))


@pytest.mark.parametrize("encoding", ["json", "protobuf"])
def test_fields_are_paths_into_messages_and_the_header_may_be_the_clock(tmp_path, encoding):
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
    file = tmp_path / "cell.toml"
    file.write_text(text)
    logs = read_bag(write_mcap(tmp_path / "a.mcap", messages, encode), file)
    assert logs.elapsed_s().tolist() == [[2.5]]
    assert logs.end_s.tolist() == [3.0]
    assert logs.stages[["count", "share"]].to_numpy().tolist() == [[2**60, 0.25]]
    for field, told in (
        ("shares", r"is no single value; name shares\.cup"),
        ("shares.mug", r"has no field 'shares\.mug'; name cup"),
        ("counts.7", "there are 2 entries"),
        ("header", r"name header\.stamp"),
    ):
        file.write_text(text.replace('"shares.cup"', f'"{field}"'))
        with pytest.raises(ArgumentError, match=told):
            read_bag(tmp_path / "a.mcap", file)


def test_what_is_not_set_in_protobuf_is_told(tmp_path):
    def encode(topic, kind, message):
        return "protobuf", SCHEMAS["protobuf"], Said(raw=b"x").SerializeToString()

    file = write_mcap(tmp_path / "a.mcap", two_paths(), encode)
    for field in ("header", "raw"):
        text = mapping(tmp_path, as_protobuf).read_text().replace('field = "text"', f'field = "{field}"')
        (tmp_path / "cell.toml").write_text(text)
        with pytest.raises(ArgumentError, match=rf"field '{field}' is no single value"):
            read_bag(file, tmp_path / "cell.toml")


def test_clouds_of_ros_stand_beside_other_encodings(tmp_path):
    points = np.arange(18.0).reshape(6, 3)
    clouds = [cloud(1.2, "/camera/points", points, (2, 3)), cloud(11.3, "/camera/points", points + 1, (2, 3))]
    messages = sorted([*two_paths(), *clouds], key=lambda message: message[0])

    def encode(topic, kind, message):
        return (as_ros if topic == "/camera/points" else as_json)(topic, kind, message)

    (tmp_path / "cell.toml").write_text(MAPPING_TEMPLATE)
    kept = []
    logs = read_bag(
        write_mcap(tmp_path / "a.mcap", messages, encode),
        tmp_path / "cell.toml",
        keep=lambda points_m, shape, name: kept.append((points_m[0, 0], shape)) or f"{name}.pcd",
    )
    assert kept == [(0.0, (2, 3)), (1.0, (2, 3))]
    assert logs.stages["cloud"].tolist() == ["a-0.pcd", "a-0.pcd", "a-1.pcd", "a-1.pcd"]
    (tmp_path / "cell.toml").write_text(MAPPING_TEMPLATE.replace("/camera/points", "/camera/occlusion"))
    with pytest.raises(ArgumentError, match=r"/camera/occlusion carries cell\.Said, not sensor_msgs"):
        read_bag(tmp_path / "a.mcap", tmp_path / "cell.toml")


def refused(source, file, told):
    with pytest.raises(HalfseenError, match=told) as caught:
        read_bag(source, file)
    assert "\n" not in str(caught.value)


def test_a_wrong_checksum_is_told(tmp_path):
    file = write_mcap(tmp_path / "a.mcap", two_paths(), as_json, compression=CompressionType.NONE)
    content = file.read_bytes()
    assert content.count(b"monday-2") == 1
    file.write_bytes(content.replace(b"monday-2", b"monday-3"))
    refused(file, mapping(tmp_path, as_json), r"a\.mcap: it is no whole bag \(crc validation failed in Chunk")


@pytest.mark.parametrize(
    ("encoding", "schema", "content", "told"),
    [
        ("json", SCHEMAS["json"], b"{", "no whole bag"),
        ("json", SCHEMAS["json"], b"[" * 1000, "nested more than 64 levels"),
        ("json", SCHEMAS["json"], b'{"data": NaN}', "NaN is no number of JSON"),
        ("json", SCHEMAS["json"], b"\xff\xfe", "decode"),
        ("protobuf", SCHEMAS["protobuf"], b"\xff\xff", "no whole bag"),
        ("protobuf", ("cell.Other", "protobuf", FILES.SerializeToString()), b"", r"cell\.Other"),
        ("protobuf", ("cell.Said", "protobuf", b"\xff"), b"", "no whole bag"),
        ("protobuf", SCHEMAS["json"], b"", "a channel of protobuf has no schema of protobuf"),
        ("cdr", None, b"", "messages are of encoding 'cdr'"),
        ("cdr", SCHEMAS["json"], b"", "the schema of cell.Said is of 'jsonschema', no form of ROS 2"),
        ("cdr", ("std_msgs/msg/String", "ros2msg", b"string data"), b"\0", "no whole bag"),
        ("flatbuffer", None, b"", "messages are of encoding 'flatbuffer', and cdr, json, protobuf are known"),
    ],
)
def test_messages_that_are_none_are_told(tmp_path, encoding, schema, content, told):
    file = write_mcap(tmp_path / "a.mcap", two_paths(), lambda *_: (encoding, schema, content))
    refused(file, mapping(tmp_path, as_json), told)


def test_channels_that_nobody_names_need_not_be_known(tmp_path):
    def encode(topic, kind, message):
        return ("flatbuffer", None, b"") if topic == "/other" else as_json(topic, kind, message)

    messages = [*two_paths(), (14.0, "/other", "", None)]
    logs = read_bag(write_mcap(tmp_path / "a.mcap", messages, encode), mapping(tmp_path, as_json))
    assert logs.num_paths == 2


packed = pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4])


@packed
def test_a_chunk_of_few_bytes_and_many_is_refused_before_it_is_unpacked(tmp_path, monkeypatch, compression):
    monkeypatch.setattr("halfseen.reading.ALWAYS_UNPACKED", 10**6)

    def padded(topic, kind, message):
        return "json", None, json.dumps({"data": message.data, "pad": "a" * 3 * 10**5}).encode()

    file = write_mcap(tmp_path / "a.mcap", two_paths(), padded, compression=compression, chunk_size=10**8)
    refused(file, mapping(tmp_path, as_json), r"unpacked, it has 6 MB, and at most")


@packed
def test_a_chunk_that_has_more_than_it_says_is_refused(tmp_path, monkeypatch, compression):
    file = write_mcap(tmp_path / "a.mcap", two_paths(), as_json, compression=compression, enable_crcs=False)
    whole = mcap_files._unpacked

    def less(chunk):
        chunk.uncompressed_size -= 5
        return whole(chunk)

    monkeypatch.setattr(mcap_files, "_unpacked", less)
    refused(file, mapping(tmp_path, as_json), "a chunk says that it has .* bytes unpacked, and has other")


def test_a_topic_that_is_not_there_is_told(tmp_path):
    file = write_mcap(tmp_path / "a.mcap", two_paths()[:3], as_json)
    told = r"no topic '/pick/action' in .*; there are /camera/occlusion, /episode/begin"
    refused(file, mapping(tmp_path, as_json), told)
