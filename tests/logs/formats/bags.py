"""Bags written with rosbags, from messages of standard types."""

from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
BEGAN_NS = 1_700_000_000 * 10**9


def text(seconds, topic, value):
    return seconds, topic, "std_msgs/msg/String", STORE.types["std_msgs/msg/String"](value)


def number(seconds, topic, value):
    return seconds, topic, "std_msgs/msg/Float64", STORE.types["std_msgs/msg/Float64"](value)


def whole(seconds, topic, value):
    return seconds, topic, "std_msgs/msg/Int32", STORE.types["std_msgs/msg/Int32"](value)


def header(stamp_s):
    stamp = STORE.types["builtin_interfaces/msg/Time"](int(stamp_s), round(stamp_s % 1 * 1e9))
    return STORE.types["std_msgs/msg/Header"](stamp, "camera")


def pose(seconds, topic, x, stamp_s=0.0):
    point = STORE.types["geometry_msgs/msg/Point"](x, 0.0, 0.0)
    turn = STORE.types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    message = STORE.types["geometry_msgs/msg/PoseStamped"](
        header(stamp_s), STORE.types["geometry_msgs/msg/Pose"](point, turn)
    )
    return seconds, topic, "geometry_msgs/msg/PoseStamped", message


def joints(seconds, topic, positions, names=("a", "b")):
    empty = np.zeros(0)
    message = STORE.types["sensor_msgs/msg/JointState"](header(0.0), list(names), np.array(positions), empty, empty)
    return seconds, topic, "sensor_msgs/msg/JointState", message


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
    fields = [field("intensity", 0, 2, 1), *[field(axis, 1 + k * size, code, 1) for k, axis in enumerate(axes)]]
    row_step = shape[1] * table.itemsize + padding
    message = STORE.types["sensor_msgs/msg/PointCloud2"](
        header(0.0), *shape, fields, dtype[0] == ">", table.itemsize, row_step,
        np.frombuffer(data[: len(data) - lost_bytes], dtype=np.uint8), False,
    )  # fmt: skip
    return seconds, topic, "sensor_msgs/msg/PointCloud2", message


def write_bag(path: Path, messages, storage="sqlite3") -> Path:
    with Writer(path, version=9, storage_plugin=StoragePlugin[storage.upper()]) as writer:
        connections = {}
        for seconds, topic, kind, message in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            stamp_ns = BEGAN_NS + round(seconds * 1e9)
            writer.write(connections[topic], stamp_ns, STORE.serialize_cdr(message, kind))
    return path


def two_paths():
    """A path that finished in two stages, and one that just stops in its second."""
    return [
        number(0.0, "/camera/occlusion", 0.9),  # before any path: belongs to none
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
