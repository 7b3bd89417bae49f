"""Bags of ROS as logs, by a mapping that says which topics carry what."""

import inspect

import numpy as np
import pytest

from bags import (
    SMALL,
    WITHOUT_CLOUD,
    cloud,
    joints,
    number,
    one_trajectory,
    pose,
    tables_of,
    text,
    two_trajectories,
    whole,
    write_bag_of_ros_1,
)
from halfseen.errors import ArgumentError, HalfseenWarning, LogError
from halfseen.logs.formats import MAPPING_TEMPLATE, read_bag, read_mapping
from refusals import refused

in_each_storage = pytest.mark.parametrize("storage", ["sqlite3", "mcap"])


# Mappings.


def test_the_template_is_a_whole_mapping_and_the_example_of_the_documentation_is_the_template(mapping, tmp_path):
    result = read_mapping(mapping(MAPPING_TEMPLATE))
    keys = ["trajectory", "covariates.occlusion", "cloud", "action", "object", "probability", "reward", "ending"]
    assert list(result.sources) == keys
    assert (result.action.topic, result.action.field, result.ending.finished) == ("/pick/action", "data", ["finished"])
    example = inspect.cleandoc(read_mapping.__doc__ or "").partition("are needed::")[2]
    assert read_mapping(mapping(example)) == result
    small = read_mapping(mapping(SMALL))
    assert ([source.topic for source in small.sources.values()], small.clock) == (["/action", "/reward", "/end"], "log")
    with refused(r"none\.toml: it cannot be read .*--mapping-template", ArgumentError):
        read_mapping(tmp_path / "none.toml")


BROKEN = [
    ("[reward]", "[rewards]", r"rewards: it is unknown; .*--mapping-template` prints one"),
    ('[reward]\ntopic = "/reward"\nfield = "data"\n', "", r"reward: it is missing; add it"),
    ('topic = "/reward"\n', "", r"reward\.topic: it is missing"),
    ('topic = "/reward"', "topic = 3", r"reward\.topic: expected `str`, got `int`"),
    ('topic = "/reward"', 'topic = ""', r"reward\.topic: it is missing"),
    ('topic = "/reward"', 'topic = "/r"\ntype = "x"', r"reward\.type: it is unknown"),
    ("[action]", 'clock = "sim"\n[action]', r"clock: 'sim' is not one of 'log', 'publish', 'header'"),
    ("[action]", "covariates = 1\n[action]", r"covariates: expected `object`, got `int`"),
    ("[action]", "trajectory = 1\n[action]", r"trajectory: expected `object.*`, got `int`"),
    ("[action]", "[covariates.reward]\ntopic='/x'\nfield='data'\n[action]", "covariates.reward: stages have such"),
    ("[action]", "[covariates.x]\ntopic='/x'\n[action]", r"covariates\.x\.field: it is missing"),
    ("[action]", "[action]\nkeeps = true", r"action\.keeps: it is for covariates alone; leave it out"),
    ('topic = "/end"', 'topic = "/end"\nfinished = []', r"ending\.finished: expected `array` of length >= 1"),
    ('topic = "/end"', 'topic = "/end"\nfinished = "done"', r"ending\.finished: expected `array`, got `str`"),
    ("[action]", "[action", r".*it is not valid TOML .*line 1"),
    # Those that do not fit the bag.
    ("/reward", "/rewrd", r"reward\.topic: there is no topic '/rewrd' in .*; there are /action, /end, /joints, /rew"),
    ('reward"\nfield = "data"', 'reward"\nfield = "value"', r"reward\.field: .*no field 'value'; name data"),
    ('reward"\nfield = "data"', 'reward"\nfield = "data.x"', r"reward\.field: .* has no field 'data\.x'"),
    ('"/reward"', '"/action"', r"reward\.field: /action .*field 'data' is 'A', not a number"),
    ('"/action"', '"/reward"', r"action\.field: /reward .*field 'data' is 1\.0, neither text nor a whole number"),
    ("[action]", 'clock = "header"\n[action]', r"clock: /action \(std_msgs/msg/String\) has no header\.stamp"),
    *(
        ("[action]", f'[covariates.x]\ntopic="/joints"\nfield="{field}"\n[action]',
         rf"covariates\.x\.field: /joints .*{message}")
        for field, message in (
            ("position", r"'position' is not a single value; name one of its 2 entries, position\.0 to position\.1"),
            ("position.7", r"field 'position\.7': there are 2 entries, counted from 0"),
            ("header", r"field 'header' is not a single value; name header\.stamp, header\.frame_id"),
            ("effort.0", r"field 'effort\.0': there are 0 entries"),
            ("__class__", r"has no field '__class__'"),
        )
    ),
]  # fmt: skip


def test_a_mapping_that_is_broken_or_does_not_fit_is_reported_with_file_and_key(bag, mapping):
    folder, content = bag(one_trajectory(joints(0.0, "/joints", [0.5, 0.75]))), tables_of(SMALL)
    for old, new, message in BROKEN:
        assert old in content
        with refused(rf"cell\.toml(, |:){message}", ArgumentError):
            read_bag(folder, mapping(content.replace(old, new, 1)))


# Trajectories.


@in_each_storage
def test_two_trajectories_of_one_bag_which_is_read_from_its_storage_where_its_recorder_died(bag, mapping, storage):
    folder, file = bag(two_trajectories(), storage=storage), mapping()
    logs = read_bag(folder, file)
    trajectories = logs.trajectories[["trajectory", "ending", "cause", "end_s", "bag"]].values.tolist()
    assert trajectories == [["monday-1", "finished", None, 2.75, "bag"], ["monday-2", "cut", "crash", 2.5, "bag"]]
    assert logs.stages["action"].tolist() == ["WASH", "FINISH", "LIFT", None]
    assert logs.stages["object"].tolist() == ["cup", None, None, None]
    wanted = {
        "elapsed_s": [2.0, 2.75, 2.0, np.nan],
        "occlusion": [0.3, 0.2, 0.4, 0.1],
        "probability": [0.5, 1.0, 0.25, np.nan],
        "reward": [5.0, -5.0, -0.1, np.nan],
    }
    for name, values in wanted.items():
        np.testing.assert_array_equal(logs.stages[name], values)
    (folder / "metadata.yaml").unlink()
    for source in (folder, *folder.iterdir()):
        assert read_bag(source, file).stages.equals(logs.stages)


def test_a_covariate_that_keeps_its_value_is_seen_in_every_trajectory_until_the_next(bag, mapping):
    latched = [(0.5, "G1"), (12.0, "G2"), (31.0, "G3")]
    messages = [text(at, "/tool", name) for at, name in latched] + two_trajectories()
    for at in (20.0, 30.0):
        messages += [text(at, "/episode/begin", f"tuesday-{at:g}"), number(at + 0.1, "/camera/occlusion", 0.5)]
        messages += [text(at + 2.0, "/pick/action", "WASH"), number(at + 2.0, "/pick/probability", 1.0)]
        messages += [number(at + 3.0, "/pick/reward", 1.0)]
    covariate = '[covariates.tool]\ntopic = "/tool"\nfield = "data"\n'
    logs = read_bag(bag(messages), mapping(WITHOUT_CLOUD + covariate + "keeps = true\n"))
    assert logs.stages["tool"].tolist() == ["G1", "G1", "G1", "G2", "G2", "G2", "G3", "G3"]
    assert logs.trajectories["end_s"].tolist() == [2.75, 2.5, 3.0, 3.0]
    with refused(r"no message of /tool came before .* set keeps = true", LogError):
        read_bag(bag(messages, "again"), mapping(WITHOUT_CLOUD + covariate))


def test_bags_of_ros_1_are_read_too(tmp_path, mapping):
    logs = read_bag(write_bag_of_ros_1(tmp_path / "old.bag", one_trajectory()), mapping(SMALL))
    assert logs.stages[["elapsed_s", "action"]].values.tolist() == [[1.0, "A"]]


def test_messages_recorded_out_of_order_are_put_in_order(bag, mapping):
    messages = two_trajectories()
    other = [messages[i] for i in np.random.default_rng(3).permutation(len(messages))]
    # Of equal stamps the recorded order counts, so keep the ending behind the reward and the object with its action.
    other.sort(key=lambda message: message[1] == "/episode/end")
    left, right = read_bag(bag(messages), mapping()), read_bag(bag(other, "mixed"), mapping())
    assert left.stages.equals(right.stages)


def test_without_a_beginning_a_bag_is_one_trajectory_and_bags_are_numbered(bag, mapping):
    bags = [bag(one_trajectory(), "a"), bag(one_trajectory(ending="battery"), "b"), bag(one_trajectory(ending=""), "c")]
    logs = read_bag(bags, mapping(SMALL))
    assert logs.trajectories[["trajectory", "bag"]].values.tolist() == [[1, "a"], [2, "b"], [3, "c"]]
    assert logs.trajectories["cause"].tolist() == [None, "battery", "unknown"]
    assert logs.end_s.tolist() == [1.5, 1.5, 1.5]
    assert logs.stages.groupby("trajectory").size().tolist() == [1, 2, 2]


def test_a_trajectory_cut_during_an_attempt_keeps_what_was_seen_and_tried(bag, mapping):
    result = SMALL | {"covariates.x": "/x data"}
    crashed = bag([number(0, "/x", 1.0), text(1, "/action", "A"), number(2, "/x", 2.0)], "crashed")
    logs = read_bag([crashed, bag(one_trajectory(number(0, "/x", 3.0)))], mapping(result))
    assert logs.stages[["action", "x"]].to_numpy().tolist() == [["A", 1.0], ["A", 3.0]]
    assert (logs.trajectories["cause"].tolist(), logs.end_s.tolist()) == (["crash", None], [2.0, 2.5])
    with refused(r"no topic '/reward' in .*together with others", ArgumentError):
        read_bag(crashed, mapping(result))


def test_fields_are_paths_into_messages(read):
    seen = {"x_m": "/pose pose.position.x", "elbow_rad": "/joints position.1", "joint": "/joints name.0"}
    messages = one_trajectory(pose(0.0, "/pose", 0.25), joints(0.1, "/joints", [0.5, 0.75]))
    logs = read(messages, SMALL | {f"covariates.{name}": source for name, source in seen.items()})
    assert logs.stages[list(seen)].to_numpy().tolist() == [[0.25, 0.75, "a"]]


def test_a_topic_that_was_recorded_twice_counts_once(read):
    messages = one_trajectory(number(0.5, "/x", 0.25))
    twice = [each for each in messages for _ in range(2)]
    with pytest.warns(HalfseenWarning, match="3 messages repeat one of the same time"):
        logs = read(twice, SMALL | {"covariates.x": "/x data"})
    assert logs.stages[["action", "elapsed_s", "reward", "x"]].to_numpy().tolist() == [["A", 1.5, 1.0, 0.25]]


LATER = [joints(2.6, "/joints", [0.1], ["finger"]), joints(2.7, "/joints", [0.9, 0.4], ["arm.b", "a"])]
TWO = [joints(0.1, "/joints", [0.5, 0.75], ["a", "arm.b"]), *one_trajectory()[:-1], *LATER]
TWO += [text(3.0, "/action", "A"), number(4.0, "/reward", 1.0), text(4.5, "/end", "finished")]


def test_entries_with_names_are_read_by_name_whatever_their_order_and_their_publisher(read):
    seen = {"a": "/joints position.a", "b": "/joints position.arm.b"}
    logs = read(TWO, SMALL | {f"covariates.{name}": source for name, source in seen.items()})
    assert logs.stages[["a", "b"]].to_numpy().tolist() == [[0.5, 0.75], [0.4, 0.9]]


@pytest.mark.parametrize(
    ("field", "message"),
    [
        ("position.0", r"'position\.0' is of 'a' in one message and of 'finger' in another; name .*: position\.a"),
        ("position.elbow", r"has no 'position\.elbow'; there are arm\.b, a"),
    ],
)
def test_an_entry_that_no_one_name_tells_is_refused(read, field, message):
    with refused(message, ArgumentError):
        read(TWO, SMALL | {"covariates.x": f"/joints {field}"})


def test_actions_may_be_whole_numbers_and_endings_too(read):
    messages = [whole(1.0, "/action", 3), number(2.0, "/reward", 1.0), whole(2.0, "/end", 1)]
    logs = read(messages, tables_of(SMALL) + "finished = [0]")
    assert (logs.stages["action"].tolist()[0], logs.trajectories["cause"].tolist()) == (3, ["1"])


def test_the_header_may_be_the_clock(read):
    result = {
        "action": "/action header.frame_id",
        "reward": "/reward pose.position.x",
        "ending": "/end header.frame_id",
    }
    messages = [
        pose(5.0, "/reward", 2.0, stamp_s=101.5),  # recorded first, yet stamped after the action
        pose(5.1, "/action", 0.0, stamp_s=100.0),
        pose(7.0, "/end", 0.0, stamp_s=103.5),
    ]
    logs = read(messages, 'clock = "header"\n' + tables_of(result) + 'finished = ["camera"]')
    assert (logs.elapsed_s().tolist(), logs.end_s.tolist()) == ([[1.5]], [3.5])


A, R, E = text(1.0, "/action", "A"), number(2.0, "/reward", 1.0), text(9.0, "/end", "finished")
B = text(3.0, "/action", "B")


@pytest.mark.parametrize(
    ("messages", "message"),
    [
        ([number(0.5, "/reward", 1.0), A, E], r"trajectory 1, stage 1: reward 1\.0 comes at 0 s with no action"),
        ([A, text(1.5, "/action", "B"), R, E], r"stage 1: action 'B' comes at 0\.5 s, yet 'A' before it has no"),
        ([A, R, B, E], r"trajectory 1, stage 2: the trajectory finished, yet the stage has no reward"),
        ([A, R, text(3.0, "/end", "Finished")],
         r"bag: trajectory 1, stage 2: ending 'Finished' differs from 'finished' only in spelling; name both in fin"),
        ([A, R, text(3.0, "/end", "finished"), E], r"trajectory 1: ending comes at 8 s, after .* at 2 s; map"),
        ([A, number(1.0, "/reward", 1.0), E], r"trajectory 1, stage 1: elapsed_s 0\.0 is not a time after"),
        ([A, number(2.0, "/reward", np.nan), E], r"trajectory 1, stage 1: .*its reward is nan"),
        ([message for message in two_trajectories() if message[0] != 1.1],
         r"trajectory 'monday-1', stage 1: no message of /camera/occlusion came before"),
    ],
)  # fmt: skip
def test_messages_that_make_no_stages_are_reported(read, messages, message):
    with refused(message, LogError):
        read(messages, SMALL if A in messages or E in messages else WITHOUT_CLOUD)


def test_a_trajectory_cut_before_anything_was_seen_is_left_out_with_a_warning(bag, mapping):
    messages = [*two_trajectories(), text(20.0, "/episode/begin", "monday-3"), text(21.0, "/episode/end", "operator")]
    words = "1 of 3 trajectories are left out, such as 'monday-3': cut before any message of /camera/occlusion came"
    with pytest.warns(HalfseenWarning, match=words):
        assert read_bag(bag(messages), mapping()).num_trajectories == 2
    messages = [message for message in two_trajectories() if message[1] != "/episode/begin"]
    bags = [bag(messages, "without"), bag([text(0.0, "/episode/begin", "late")], "late")]
    words = r"no trajectory with a stage was found; check \[trajectory\] in .*cell\.toml"
    early = "7 actions, rewards and endings come before the first message of /episode/begin"
    with (
        pytest.warns(HalfseenWarning, match=early),
        pytest.warns(HalfseenWarning, match="'late': cut"),
        refused(words, LogError),
    ):
        read_bag(bags, mapping())


def test_what_is_no_bag_is_reported(tmp_path, mapping):
    for folder in ("empty", "broken"):
        (tmp_path / folder).mkdir()
    (tmp_path / "broken" / "metadata.yaml").write_text("nonsense: [")
    for name, message in (
        ("none", "no such bag"),
        ("empty", "it holds no bag"),
        ("broken", "it is not a complete bag"),
    ):
        with refused(message, LogError):
            read_bag(tmp_path / name, mapping())


# Clouds.

CLOUD = tables_of(SMALL) + '[cloud]\ntopic = "/points"\n'
POINTS = np.arange(18.0).reshape(6, 3) / 7


@pytest.mark.parametrize(("dtype", "padding"), [("<f4", 0), (">f4", 5), ("<f8", 5)])
def test_points_come_out_as_they_went_in(read, dtype, padding):
    seen = []

    def see(points_m, shape, name):
        seen.append((points_m, shape, name))
        return {"object": [0], "occlusion": [0.5]}

    logs = read(one_trajectory(cloud(0.0, "/points", POINTS, (2, 3), dtype=dtype, padding=padding)), CLOUD, see=see)
    ((points_m, *result),) = seen
    assert result == [(2, 3), "bag-0"]
    assert np.array_equal(points_m, POINTS.astype(dtype))
    assert logs.objects.to_numpy().tolist() == [[1, 1, 0, 0.5]]


def test_each_stage_has_the_last_cloud_before_its_action_and_only_those_are_read(read):
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
    logs = read(messages, CLOUD, keep=keep)
    assert logs.stages["cloud"].tolist() == ["bag-4.pcd", "bag-5.pcd", "bag-6.pcd"]
    assert kept == [("bag-4", 4.0), ("bag-5", 5.0), ("bag-6", 6.0)]
    assert logs.objects is None


@pytest.mark.parametrize(
    ("options", "expected", "message"),
    [
        ({"axes": "xy"}, CLOUD, r"bag, /points, cloud 0: its fields intensity, x, y lack x, y and z"),
        ({"dtype": "<i4"}, CLOUD, r"lack x, y and z as floats"),
        ({"lost_bytes": 3}, CLOUD, r"75 bytes are not the 2 × 39 announced; it was cut short"),
        ({}, SMALL, r"cell\.toml, cloud: it is missing, so no cloud is read"),
        ({}, CLOUD.replace("/points", "/reward"), r"cloud\.topic: /reward carries std_msgs/msg/Float64, not sensor_"),
    ],
)
def test_broken_clouds_and_mappings_without_them_are_reported(read, options, expected, message):
    with refused(message):
        read(one_trajectory(cloud(0.0, "/points", POINTS, (2, 3), **options)), expected, see=lambda *_: {})
