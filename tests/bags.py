"""Bags written with rosbags from messages of standard types, and MCAP written with its own library in any encoding."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from google.protobuf import descriptor_pb2
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as OldWriter
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from halfseen.logs.formats import MAPPING_TEMPLATE

STORE = get_typestore(Stores.ROS2_HUMBLE)
BEGAN_NS = 1_700_000_000 * 10**9


def made(kind, *fields):
    return STORE.types[kind](*fields)


def sent(kind, seconds, topic, *fields):
    """A message of a kind on a topic."""
    return seconds, topic, kind, made(kind, *fields)


text, number, whole = (partial(sent, f"std_msgs/msg/{kind}") for kind in ("String", "Float64", "Int32"))


def header(stamp_s):
    stamp = made("builtin_interfaces/msg/Time", int(stamp_s), round(stamp_s % 1 * 1e9))
    return made("std_msgs/msg/Header", stamp, "camera")


def pose(seconds, topic, x, stamp_s=0.0):
    point = made("geometry_msgs/msg/Point", x, 0.0, 0.0)
    turn = made("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0)
    there = made("geometry_msgs/msg/Pose", point, turn)
    return sent("geometry_msgs/msg/PoseStamped", seconds, topic, header(stamp_s), there)


def joints(seconds, topic, positions, names=("a", "b")):
    empty = np.zeros(0)
    fields = header(0.0), list(names), np.array(positions), empty, empty
    return sent("sensor_msgs/msg/JointState", seconds, topic, *fields)


def cloud(seconds, topic, points_m, shape, *, dtype="<f4", padding=0, axes="xyz", lost_bytes=0):
    """A PointCloud2 with an intensity before the coordinates, and unused bytes at the end of each row."""
    code = {"f4": 7, "f8": 8, "i4": 5}[dtype[1:]]
    size = np.dtype(dtype).itemsize
    table = np.zeros(len(points_m), dtype=[("intensity", "u1"), *[(axis, dtype) for axis in axes]])
    for k, axis in enumerate(axes):
        table[axis] = points_m[:, k]
    rows = table.reshape(shape)
    data = b"".join(row.tobytes() + bytes(padding) for row in rows)
    field = STORE.types["sensor_msgs/msg/PointField"]
    columns = [field("intensity", 0, 2, 1), *[field(axis, 1 + k * size, code, 1) for k, axis in enumerate(axes)]]
    content = np.frombuffer(data[: len(data) - lost_bytes], dtype=np.uint8)
    steps = table.itemsize, shape[1] * table.itemsize + padding
    fields = header(0.0), *shape, columns, dtype[0] == ">", *steps, content, False
    return sent("sensor_msgs/msg/PointCloud2", seconds, topic, *fields)


def write_bag(path: Path, messages, storage="sqlite3") -> Path:
    with Writer(path, version=9, storage_plugin=StoragePlugin[storage.upper()]) as writer:
        connections = {}
        for seconds, topic, kind, message in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            stamp_ns = BEGAN_NS + round(seconds * 1e9)
            writer.write(connections[topic], stamp_ns, STORE.serialize_cdr(message, kind))
    return path


def write_bag_of_ros_1(path: Path, messages) -> Path:
    store = get_typestore(Stores.ROS1_NOETIC)
    with OldWriter(path) as writer:
        connections = {}
        for seconds, topic, kind, message in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            if hasattr(message, "header"):  # that of ROS 1 is numbered
                numbered = store.types["std_msgs/msg/Header"](0, message.header.stamp, message.header.frame_id)
                message = replace(message, header=numbered)
            writer.write(connections[topic], int(seconds * 1e9), store.serialize_ros1(message, kind))
    return path


SMALL = {"action": "/action data", "reward": "/reward data", "ending": "/end data"}
"""The least that a mapping says."""


def one_trajectory(*messages, ending="finished"):
    stage = [text(1.0, "/action", "A"), number(2.0, "/reward", 1.0)]
    return [*messages, *stage, text(2.5, "/end", ending)]


def two_trajectories():
    """A trajectory that finished in two stages, and one that just stops in its second."""
    return [
        number(0.0, "/camera/occlusion", 0.9),  # before any trajectory: belongs to none
        text(1.0, "/episode/begin", "monday-1"),
        number(1.1, "/camera/occlusion", 0.3),
        text(1.5, "/pick/action", "WASH"),
        text(1.5, "/pick/object", "cup"),
        number(1.6, "/pick/probability", 0.5),
        number(2.0, "/camera/occlusion", 0.2),  # during the stage: what the next one sees
        number(3.0, "/pick/reward", 5.0),
        text(3.5, "/pick/action", "FINISH"),
        number(3.5, "/pick/probability", 1.0),
        number(3.75, "/pick/reward", -5.0),
        text(3.75, "/episode/end", "finished"),
        number(4.0, "/camera/occlusion", 0.8),  # after its end: belongs to none
        text(11.0, "/episode/begin", "monday-2"),
        number(11.25, "/camera/occlusion", 0.4),
        text(11.5, "/pick/action", "LIFT"),
        number(11.5, "/pick/probability", 0.25),
        number(13.0, "/pick/reward", -0.1),
        number(13.5, "/camera/occlusion", 0.1),
    ]


# MCAP.

WITHOUT_CLOUD = MAPPING_TEMPLATE[: MAPPING_TEMPLATE.index("# sensor_msgs/PointCloud2")]
FIELD = descriptor_pb2.FieldDescriptorProto


ONE, MANY = FIELD.LABEL_OPTIONAL, FIELD.LABEL_REPEATED


def described():
    """A message with text, a number, an enumerated value, a list, a map and a message in it."""
    file = descriptor_pb2.FileDescriptorProto(name="cell.proto", package="cell", syntax="proto3")
    kind = file.enum_type.add(name="Verb")
    for number, name in enumerate(["NONE", "WASH", "FINISH", "LIFT"]):
        kind.value.add(name=name, number=number)
    stamp, header, said = (file.message_type.add(name=name) for name in ("Stamp", "Header", "Said"))
    entry = said.nested_type.add(name="SharesEntry")
    entry.options.map_entry = True
    for message, fields in (
        (stamp, [("sec", FIELD.TYPE_INT64), ("nsec", FIELD.TYPE_UINT32)]),
        (header, [("stamp", FIELD.TYPE_MESSAGE, ".cell.Stamp")]),
        (entry, [("key", FIELD.TYPE_STRING), ("value", FIELD.TYPE_DOUBLE)]),
        (said, [
            ("text", FIELD.TYPE_STRING), ("number", FIELD.TYPE_DOUBLE), ("verb", FIELD.TYPE_ENUM, ".cell.Verb"),
            ("counts", FIELD.TYPE_INT64, None, MANY), ("header", FIELD.TYPE_MESSAGE, ".cell.Header"),
            ("shares", FIELD.TYPE_MESSAGE, ".cell.Said.SharesEntry", MANY), ("raw", FIELD.TYPE_BYTES),
        ]),
    ):  # fmt: skip
        for number, (name, of, *more) in enumerate(fields, start=1):
            named, label = (*more, *(None, ONE)[len(more) :])
            message.field.add(name=name, number=number, type=of, type_name=named, label=label)
    return descriptor_pb2.FileDescriptorSet(file=[file])


FILES = described()
POOL = DescriptorPool()
POOL.Add(FILES.file[0])
Said = GetMessageClass(POOL.FindMessageTypeByName("cell.Said"))
SCHEMAS = {
    "json": ("cell.Said", "jsonschema", b'{"type": "object"}'),
    "protobuf": ("cell.Said", "protobuf", FILES.SerializeToString()),
}


def write_mcap(path, messages, encode, *, late_ns=lambda: 0, **options):
    """Write messages; `encode` says encoding and content of each."""
    with path.open("wb") as file:
        writer = McapWriter(file, **options)
        writer.start(profile="", library="test")
        channels = {}
        for seconds, topic, kind, message in messages:
            encoding, schema, content = encode(topic, kind, message)
            if (topic, encoding) not in channels:
                number = 0 if schema is None else writer.register_schema(*schema)
                channels[topic, encoding] = writer.register_channel(topic, encoding, number)
            stamp_ns = BEGAN_NS + round(seconds * 1e9)
            writer.add_message(channels[topic, encoding], stamp_ns + late_ns(), content, stamp_ns)
        writer.finish()
    return path


def as_json(topic, kind, message):
    return "json", SCHEMAS["json"], json.dumps({"data": message.data}).encode()


def as_json_without_schema(topic, kind, message):
    return "json", None, json.dumps({"data": message.data}).encode()


def as_protobuf(topic, kind, message):
    if isinstance(message.data, float):
        said = Said(number=message.data)
    elif topic == "/pick/action":
        said = Said(verb=message.data)
    else:
        said = Said(text=message.data)
    return "protobuf", SCHEMAS["protobuf"], said.SerializeToString()


def as_ros(topic, kind, message):
    definition, _ = STORE.generate_msgdef(kind, ros_version=2)
    return "cdr", (kind, "ros2msg", definition.encode()), bytes(STORE.serialize_cdr(message, kind))


def mixed(topic, kind, message):
    return {"/pick/reward": as_protobuf, "/pick/action": as_json}.get(topic, as_ros)(topic, kind, message)


OF_PROTOBUF = {"reward": "number", "probability": "number", "covariates.occlusion": "number", "action": "verb"}


def tables_of(sources):
    """A mapping of topics and fields, by key."""
    parts = ((key, *source.split()) for key, source in sources.items())
    return "".join(f'[{key}]\ntopic = "{topic}"\nfield = "{field}"\n' for key, topic, field in parts)


def mapping_for(encode, clock="log"):
    """The template, with the fields of protobuf where a topic has it."""
    lines, table = [], ""
    for line in WITHOUT_CLOUD.replace('clock = "log"', f'clock = "{clock}"').splitlines():
        table = line.strip("[]") if line.startswith("[") else table
        is_protobuf = encode is as_protobuf or (encode is mixed and table == "reward")
        lines.append(line.replace('"data"', f'"{OF_PROTOBUF.get(table, "text")}"') if is_protobuf else line)
    return "\n".join(lines)
