import numpy as np
import pytest
from bags import cloud, joints, number, pose, text, two_paths, whole, write_bag

from halfseen.errors import ArgumentError, HalfseenWarning, LogError
from halfseen.logs.formats import MAPPING_TEMPLATE, read_bag

WITHOUT_CLOUD = MAPPING_TEMPLATE[: MAPPING_TEMPLATE.index("# sensor_msgs/PointCloud2")]
SMALL = """
[action]
topic = "/action"
field = "data"
[reward]
topic = "/reward"
field = "data"
[ending]
topic = "/end"
field = "data"
"""


@pytest.fixture
def mapping(tmp_path):
    def write(content=WITHOUT_CLOUD):
        (tmp_path / "cell.toml").write_text(content)
        return tmp_path / "cell.toml"

    return write


@pytest.fixture
def bag(tmp_path):
    def write(messages, name="bag", storage="mcap"):
        return write_bag(tmp_path / name, messages, storage)

    return write


def one_path(*messages, ending="finished"):
    stage = [text(1.0, "/action", "A"), number(2.0, "/reward", 1.0)]
    return [*messages, *stage, text(2.5, "/end", ending)]


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_two_paths_of_one_bag(bag, mapping, storage):
    logs = read_bag(bag(two_paths(), storage=storage), mapping())
    assert logs.path_ids.tolist() == ["monday-1", "monday-2"]
    assert logs.paths["ending"].tolist() == ["finished", "cut"]
    assert logs.paths["cause"].tolist() == [None, "crash"]
    assert logs.end_s.tolist() == [2.75, 2.5]
    assert logs.paths["bag"].tolist() == ["bag", "bag"]
    np.testing.assert_array_equal(logs.elapsed_s(), [[2.0, 2.75], [2.0, np.nan]])
    assert logs.stages["action"].tolist() == ["WASH", "FINISH", "LIFT", None]
    assert logs.stages["object"].tolist() == ["cup", None, None, None]
    assert logs.stages["occlusion"].tolist() == [0.3, 0.2, 0.4, 0.1]
    np.testing.assert_array_equal(logs.stages["probability"], [0.5, 1.0, 0.25, np.nan])
    np.testing.assert_array_equal(logs.stages["reward"], [5.0, -5.0, -0.1, np.nan])


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_a_bag_whose_recorder_died_is_read_from_its_storage(bag, mapping, storage):
    folder = bag(two_paths(), storage=storage)
    whole_logs = read_bag(folder, mapping())
    (folder / "metadata.yaml").unlink()
    assert read_bag(folder, mapping()).stages.equals(whole_logs.stages)
    (file,) = folder.iterdir()
    assert read_bag(file, mapping()).stages.equals(whole_logs.stages)


def test_bags_of_ros_1_are_read_too(tmp_path, mapping):
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    with Writer(tmp_path / "old.bag") as writer:
        connections = {}
        for seconds, topic, kind, message in one_path():
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], int(seconds * 1e9), store.serialize_ros1(message, kind))
    logs = read_bag(tmp_path / "old.bag", mapping(SMALL))
    assert logs.elapsed_s().tolist() == [[1.0]]
    assert logs.stages["action"].tolist() == ["A"]


def test_messages_recorded_out_of_order_are_put_in_order(bag, mapping):
    messages = two_paths()
    mixed = [messages[i] for i in np.random.default_rng(3).permutation(len(messages))]
    # Of equal stamps the recorded order counts, so keep the ending behind the reward and the object with its action.
    mixed.sort(key=lambda message: message[1] == "/episode/end")
    left, right = read_bag(bag(messages), mapping()), read_bag(bag(mixed, "mixed"), mapping())
    assert left.stages.equals(right.stages)


def test_without_a_beginning_a_bag_is_one_path_and_bags_are_numbered(bag, mapping):
    bags = [bag(one_path(), "a"), bag(one_path(ending="battery"), "b"), bag(one_path(ending=""), "c")]
    logs = read_bag(bags, mapping(SMALL))
    assert logs.path_ids.tolist() == [1, 2, 3]
    assert logs.paths["bag"].tolist() == ["a", "b", "c"]
    assert logs.paths["cause"].tolist() == [None, "battery", "unknown"]
    assert logs.end_s.tolist() == [1.5, 1.5, 1.5]
    assert logs.stages.groupby("path").size().tolist() == [1, 2, 2]


def test_a_path_cut_during_an_attempt_keeps_what_was_seen_and_tried(bag, mapping):
    table = '[covariates.x]\ntopic = "/x"\nfield = "data"\n'
    crashed = bag([number(0, "/x", 1.0), text(1, "/action", "A"), number(2, "/x", 2.0)], "crashed")
    logs = read_bag([crashed, bag(one_path(number(0, "/x", 3.0)))], mapping(SMALL + table))
    assert logs.stages[["action", "x"]].to_numpy().tolist() == [["A", 1.0], ["A", 3.0]]
    assert logs.paths["cause"].tolist() == ["crash", None]
    assert logs.end_s.tolist() == [2.0, 2.5]
    with pytest.raises(ArgumentError, match=r"no topic '/reward' in .*together with others"):
        read_bag(crashed, mapping(SMALL + table))


def test_fields_are_paths_into_messages(bag, mapping):
    tables = """
    [covariates.x_m]
    topic = "/pose"
    field = "pose.position.x"
    [covariates.elbow_rad]
    topic = "/joints"
    field = "position.1"
    [covariates.joint]
    topic = "/joints"
    field = "name.0"
    """
    messages = [pose(0.0, "/pose", 0.25), joints(0.1, "/joints", [0.5, 0.75])]
    logs = read_bag(bag(one_path(*messages)), mapping(SMALL + tables))
    assert logs.stages[["x_m", "elbow_rad", "joint"]].to_numpy().tolist() == [[0.25, 0.75, "a"]]


def test_actions_may_be_whole_numbers_and_endings_too(bag, mapping):
    messages = [whole(1.0, "/action", 3), number(2.0, "/reward", 1.0), whole(2.0, "/end", 1)]
    content = SMALL.replace('topic = "/end"', 'topic = "/end"\nfinished = [0]')
    logs = read_bag(bag(messages), mapping(content))
    assert logs.stages["action"].tolist()[0] == 3
    assert logs.paths["cause"].tolist() == ["1"]


def test_the_header_may_be_the_clock(bag, mapping):
    content = 'clock = "header"\n' + "".join(
        f'[{key}]\ntopic = "/{key}"\nfield = "{field}"\n'
        for key, field in (("action", "header.frame_id"), ("reward", "pose.position.x"), ("ending", "header.frame_id"))
    )
    content = content.replace("[ending]", '[ending]\nfinished = ["camera"]')
    messages = [
        pose(5.0, "/reward", 2.0, stamp_s=101.5),  # recorded first, yet stamped after the action
        pose(6.0, "/action", 0.0, stamp_s=100.0),
        pose(7.0, "/ending", 0.0, stamp_s=102.0),
    ]
    logs = read_bag(bag(messages), mapping(content))
    assert logs.elapsed_s().tolist() == [[1.5]]
    assert logs.end_s.tolist() == [2.0]
    with pytest.raises(ArgumentError, match=r"cell\.toml, clock: /action \(std_msgs/msg/String\) has no header\.stamp"):
        read_bag(bag(one_path(), "plain"), mapping('clock = "header"\n' + SMALL))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "/reward",
            "/rewrd",
            r"cell\.toml, reward\.topic: there is no topic '/rewrd' in .*; there are /action, /end, /rew",
        ),
        (
            'reward"\nfield = "data"',
            'reward"\nfield = "value"',
            r"cell\.toml, reward\.field: .*no field 'value'; name data",
        ),
        ('reward"\nfield = "data"', 'reward"\nfield = "data.x"', r"reward\.field: .* has no field 'data\.x'"),
        ('"/reward"', '"/action"', r"reward\.field: /action .*field 'data' is 'A', no number"),
        ('"/action"', '"/reward"', r"action\.field: /reward .*field 'data' is 1\.0, neither text nor a whole number"),
    ],
)
def test_a_mapping_that_does_not_fit_is_told(bag, mapping, old, new, message):
    assert old in SMALL
    with pytest.raises(ArgumentError, match=message) as told:
        read_bag(bag(one_path()), mapping(SMALL.replace(old, new, 1)))
    assert "\n" not in str(told.value)


@pytest.mark.parametrize(
    ("field", "message"),
    [
        ("position", r"field 'position' is no single value; name one of its 2 entries, position\.0 to position\.1"),
        ("position.7", r"field 'position\.7': there are 2 entries, counted from 0"),
        ("header", r"field 'header' is no single value; name header\.stamp, header\.frame_id"),
        ("effort.0", r"field 'effort\.0': there are 0 entries"),
        ("__class__", r"has no field '__class__'"),
    ],
)
def test_what_is_no_single_value_is_told(bag, mapping, field, message):
    table = f'[covariates.x]\ntopic = "/joints"\nfield = "{field}"\n'
    with pytest.raises(ArgumentError, match=r"cell\.toml, covariates\.x\.field: /joints .*" + message):
        read_bag(bag(one_path(joints(0.0, "/joints", [0.5, 0.75]))), mapping(SMALL + table))


A, R, E = text(1.0, "/action", "A"), number(2.0, "/reward", 1.0), text(9.0, "/end", "finished")


@pytest.mark.parametrize(
    ("messages", "message"),
    [
        ([number(0.5, "/reward", 1.0), A, E], r"path 1, stage 1: reward 1\.0 comes at 0 s with no action before it"),
        (
            [A, text(1.5, "/action", "B"), R, E],
            r"path 1, stage 1: action 'B' comes at 0\.5 s, yet 'A' before it has no",
        ),
        ([A, R, text(3.0, "/action", "B"), E], r"path 1, stage 2: the path finished, yet the stage has no reward"),
        (
            [A, R, text(3.0, "/end", "finished"), E],
            r"path 1: ending comes at 8 s, after its ending at 2 s; map \[path\]",
        ),
        ([A, number(1.0, "/reward", 1.0), E], r"path 1, stage 1: elapsed_s 0\.0 is no time after the path's beginning"),
        ([A, number(2.0, "/reward", np.nan), E], r"path 1, stage 1: .*its reward is nan"),
    ],
)
def test_messages_that_make_no_stages_are_told(bag, mapping, messages, message):
    with pytest.raises(LogError, match=message):
        read_bag(bag(messages), mapping(SMALL))


def test_an_action_before_its_covariates_is_refused(bag, mapping):
    messages = [message for message in two_paths() if message[0] != 1.1]
    with pytest.raises(LogError, match=r"path 'monday-1', stage 1: no message of /camera/occlusion came before"):
        read_bag(bag(messages), mapping())


def test_a_path_cut_before_anything_was_seen_is_left_out_with_a_warning(bag, mapping):
    messages = [*two_paths(), text(20.0, "/episode/begin", "monday-3"), text(21.0, "/episode/end", "operator")]
    folder = bag(messages)
    with pytest.warns(HalfseenWarning, match=r"path 'monday-3' was cut before any message of /camera/occlusion came"):
        logs = read_bag(folder, mapping())
    assert logs.num_paths == 2


def test_bags_without_a_path_are_refused(bag, mapping):
    messages = [message for message in two_paths() if message[1] != "/episode/begin"]
    bags = [bag(messages, "without"), bag([text(0.0, "/episode/begin", "late")], "late")]
    with (
        pytest.warns(HalfseenWarning, match="'late' was cut"),
        pytest.raises(LogError, match=r"no path with a stage was found; look at \[path\] in .*cell\.toml"),
    ):
        read_bag(bags, mapping())


def test_what_is_no_bag_is_told(tmp_path, mapping):
    with pytest.raises(LogError, match="there is no such bag"):
        read_bag(tmp_path / "nowhere", mapping())
    (tmp_path / "empty").mkdir()
    with pytest.raises(LogError, match="it holds no bag"):
        read_bag(tmp_path / "empty", mapping())
    (tmp_path / "empty" / "metadata.yaml").write_text("nonsense: [")
    with pytest.raises(LogError, match="it is no whole bag"):
        read_bag(tmp_path / "empty", mapping())


# Clouds.

CLOUD = SMALL + '[cloud]\ntopic = "/points"\n'
POINTS = np.arange(18.0).reshape(6, 3) / 7


@pytest.mark.parametrize("dtype", ["<f4", ">f4", "<f8"])
@pytest.mark.parametrize("padding", [0, 5])
def test_points_come_out_as_they_went_in(bag, mapping, dtype, padding):
    seen = []

    def see(points_m, shape, name):
        seen.append((points_m, shape, name))
        return {"object": [0], "occlusion": [0.5]}

    messages = one_path(cloud(0.0, "/points", POINTS, (2, 3), dtype=dtype, padding=padding))
    logs = read_bag(bag(messages), mapping(CLOUD), see=see)
    ((points_m, shape, name),) = seen
    assert shape == (2, 3)
    assert name == "bag-0"
    assert np.array_equal(points_m, POINTS.astype(dtype))
    assert logs.objects.to_numpy().tolist() == [[1, 1, 0, 0.5]]


def test_each_stage_has_the_last_cloud_before_its_action_and_only_those_are_read(bag, mapping):
    kept = []

    def keep(points_m, shape, name):
        kept.append((name, points_m[0, 0]))
        return f"{name}.pcd"

    messages = [
        *(cloud(k / 10, "/points", POINTS + k, (1, 6)) for k in range(5)),
        text(1.0, "/action", "A"),
        cloud(1.5, "/points", POINTS + 5, (1, 6)),
        number(2.0, "/reward", 1.0),
        text(3.0, "/action", "B"),
        cloud(3.5, "/points", POINTS + 6, (1, 6)),
        number(4.0, "/reward", 1.0),
        text(4.5, "/end", "operator"),
    ]
    logs = read_bag(bag(messages), mapping(CLOUD), keep=keep)
    assert logs.stages["cloud"].tolist() == ["bag-4.pcd", "bag-5.pcd", "bag-6.pcd"]
    assert kept == [("bag-4", 4.0), ("bag-5", 5.0), ("bag-6", 6.0)]
    assert logs.objects is None


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"axes": "xy"}, r"bag, /points, cloud 0: its fields intensity, x, y have no x, y and z"),
        ({"dtype": "<i4"}, r"have no x, y and z of floats"),
        ({"lost_bytes": 3}, r"75 bytes are not the 2 × 39 announced; it was cut short"),
    ],
)
def test_broken_clouds_are_told(bag, mapping, options, message):
    folder = bag(one_path(cloud(0.0, "/points", POINTS, (2, 3), **options)))
    with pytest.raises(LogError, match=message):
        read_bag(folder, mapping(CLOUD), keep=lambda *_: "file")


def test_seeing_without_a_topic_of_clouds_is_refused(bag, mapping):
    with pytest.raises(ArgumentError, match=r"cell\.toml, cloud: it is missing, so that no cloud is seen"):
        read_bag(bag(one_path()), mapping(SMALL), see=lambda *_: {})


def test_a_topic_without_clouds_is_told(bag, mapping):
    content = CLOUD.replace("/points", "/reward")
    with pytest.raises(ArgumentError, match=r"cloud\.topic: /reward carries std_msgs/msg/Float64, not sensor_msgs"):
        read_bag(bag(one_path()), mapping(content))
