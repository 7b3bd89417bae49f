"""A simulation's clock that is reset within a bag begins another trajectory."""

import json
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bags import BEGAN_NS, SCHEMAS, Said, as_ros, pose, tables_of, write_bag, write_bag_of_ros_1, write_mcap
from halfseen.errors import HalfseenWarning
from halfseen.logs.formats import read_bag
from halfseen.logs.formats.bag_messages import JITTER_NS, runs_of
from refusals import refused

OF_ROS = {"covariates.x": "/x pose.position.x", "reward": "/reward pose.position.x"}
OF_ROS |= {"action": "/action header.frame_id", "ending": "/end header.frame_id"}
OF_SAID = {"covariates.x": "/x number", "reward": "/reward number", "action": "/action text", "ending": "/end text"}
BEGIN = '[trajectory]\ntopic = "/begin"\n'


def mapping(folder, sources, more=""):
    (folder / "cell.toml").write_text(f'clock = "header"\n{tables_of(sources)}finished = ["camera"]\n{more}')
    return folder / "cell.toml"


def said(kind, topic, _, message):
    """A pose in JSON or protobuf."""
    stamp = {"sec": message.header.stamp.sec, "nsec": message.header.stamp.nanosec}
    parts = {"text": message.header.frame_id, "number": message.pose.position.x, "header": {"stamp": stamp}}
    content = Said(**parts).SerializeToString() if kind == "protobuf" else json.dumps(parts).encode()
    return kind, SCHEMAS[kind], content


KINDS = {
    "ROS 1": (OF_ROS, lambda folder, messages: write_bag_of_ros_1(folder / "a.bag", messages)),
    "SQLite": (OF_ROS, lambda folder, messages: write_bag(folder / "a", messages, "sqlite3")),
    "MCAP": (OF_ROS, lambda folder, messages: write_bag(folder / "a", messages, "mcap")),
    "CDR": (OF_ROS, lambda folder, messages: write_mcap(folder / "a.mcap", messages, as_ros)),
    **{
        kind: (OF_SAID, lambda folder, messages, k=kind: write_mcap(folder / "a.mcap", messages, partial(said, k)))
        for kind in ("json", "protobuf")
    },
}


def episode(recorded_s, x, *, begin=None):
    """Of 2.5 s, recorded from some time on; the clock of its messages begins at 0."""
    parts = [(0.0, "/x", x), (0.5, "/action", 0.0), (2.0, "/reward", 10 * x), (2.5, "/end", 0.0)]
    parts = parts if begin is None else [(begin, "/begin", 0.0), *parts]
    return [pose(recorded_s + max(at, 0.0), topic, value, stamp_s=at % 100.0) for at, topic, value in parts]


@pytest.mark.parametrize("kind", list(KINDS))
@pytest.mark.parametrize("begin", [None, 0.0])
@pytest.mark.parametrize("every_s", [2.6, 10.0])
def test_a_reset_begins_another_trajectory_with_what_it_saw(tmp_path, kind, begin, every_s):
    sources, write = KINDS[kind]
    messages = [message for k in range(3) for message in episode(10.0 + k * every_s, k + 1.0, begin=begin)]
    logs = read_bag(write(tmp_path, messages), mapping(tmp_path, sources, "" if begin is None else BEGIN))
    assert (logs.elapsed_s().tolist(), logs.end_s.tolist()) == ([[2.0]] * 3, [2.5] * 3)
    assert logs.stages[["x", "reward"]].to_numpy().tolist() == [[1.0, 10.0], [2.0, 20.0], [3.0, 30.0]]
    assert logs.is_finished.all()


def test_what_is_only_seen_between_resets_is_no_trajectory(tmp_path):
    sources, write = KINDS["MCAP"]
    messages = [pose(0.0, "/x", 7.0, stamp_s=50.0), *episode(10.0, 1.0), pose(20.0, "/x", 8.0, stamp_s=0.0)]
    logs = read_bag(write(tmp_path, messages), mapping(tmp_path, sources))
    assert (logs.stages["x"].tolist(), logs.end_s.tolist()) == ([1.0], [2.5])


def test_a_beginning_before_the_reset_is_refused(tmp_path):
    sources, write = KINDS["MCAP"]
    messages = [*episode(10.0, 1.0, begin=0.0), *episode(20.0, 2.0, begin=-90.0)]
    with refused(r"a: action 'camera' comes after the clock was reset and before a message of /begin; record"):
        read_bag(write(tmp_path, messages), mapping(tmp_path, sources, BEGIN))


def test_a_trajectory_that_a_reset_breaks_off_was_cut(tmp_path):
    sources, write = KINDS["MCAP"]
    messages = [*episode(10.0, 1.0, begin=0.0)[:-1], *episode(20.0, 2.0, begin=0.0)]
    logs = read_bag(write(tmp_path, messages), mapping(tmp_path, sources, BEGIN))
    assert (logs.trajectories["cause"].tolist(), logs.end_s.tolist()) == (["crash", None], [2.0, 2.5])


@pytest.mark.parametrize("late_s", [0.0, 0.3, 0.99])
def test_messages_out_of_order_are_no_reset(tmp_path, late_s):
    sources, write = KINDS["MCAP"]
    sent = [(1.0, "/x", 1.0), (1.5, "/action", 0.0), (3.0, "/reward", 2.0), (3.0 + late_s, "/end", 0.0)]
    messages = [pose(at, topic, value, stamp_s=100.0 + at) for at, topic, value in sent]
    messages.append(pose(3.5 + late_s, "/x", 5.0, stamp_s=103.0))
    logs = read_bag(write(tmp_path, messages), mapping(tmp_path, sources))
    assert (logs.elapsed_s().tolist(), logs.end_s.tolist()) == ([[2.0]], [2.0 + late_s])


def test_late_messages_of_the_run_before_stay_with_it():
    second = 10**9
    recorded = [0, 1, 2, 3, 3.2, 3.4, 3.6, 4, 5]
    stamps = [50, 51, 52, 0.1, 53.0, 0.5, 53.1, 1.0, 2.0]
    wanted = [0, 0, 0, 1, 0, 1, 0, 1, 1]
    assert runs_of([int(one * second) for one in stamps], [int(one * second) for one in recorded]) == wanted


def test_stamps_of_any_size_are_compared():
    assert runs_of([10**30, 10**30 + 1, 5], [0, 1, 2]) == [0, 0, 1]
    assert runs_of([], []) == []


@pytest.mark.parametrize("late_s", [0.5, 1.5, 4.0])
def test_messages_of_a_slow_topic_are_no_reset(late_s):
    """What is seen comes late, each time; all else comes at once."""
    sent = [(0.5 * k, 0.5 * k) for k in range(40)] + [(0.5 * k + late_s, 0.5 * k) for k in range(26)]
    columns = np.array(sorted(sent))
    stamps, recorded = ((columns[:, column] * JITTER_NS).astype(int).tolist() for column in (1, 0))
    assert runs_of(stamps, recorded) == [0] * len(sent)


@given(
    st.lists(st.tuples(st.integers(4, 30), st.integers(0, 10)), min_size=1, max_size=4),
    st.randoms(use_true_random=False),
)
def test_runs_are_those_that_were_made(runs, rng):
    """Runs of some seconds, messages every 0.5 s that arrive up to 0.4 s late, with pauses between the runs."""
    sent, now = [], 0.0
    for number, (halves, pause) in enumerate(runs):
        sent += [(now + 0.5 * k + 0.4 * rng.random(), 0.5 * k, number) for k in range(halves)]
        now += 0.5 * halves + pause
    sent.sort()
    columns = np.array(sent)
    found = runs_of((columns[:, 1] * JITTER_NS).astype(int).tolist(), (columns[:, 0] * JITTER_NS).astype(int).tolist())
    assert found == columns[:, 2].astype(int).tolist()


@pytest.mark.parametrize("clock", ["header", "log"])
def test_times_of_0_beside_dates_are_refused(tmp_path, clock):
    """A header whose stamp nobody set; a recorder that waited for the clock of a simulation."""
    times = [(0.0, "/x"), (0.5, "/action"), (2.0, "/reward"), (2.5, "/end")]

    def messages(of_x_s):
        return [pose(at, topic, 1.0, stamp_s=of_x_s if topic == "/x" else BEGAN_NS / 1e9 + at) for at, topic in times]

    file = mapping(tmp_path, OF_ROS).read_text().replace('"header"', f'"{clock}"')
    (tmp_path / "cell.toml").write_text(file)
    right, wrong = write_bag(tmp_path / "right", messages(BEGAN_NS / 1e9)), messages(0.0)
    assert read_bag(right, tmp_path / "cell.toml").end_s.tolist() == [2.5]
    if clock == "log":
        wrong = [(-BEGAN_NS / 1e9 if message[1] == "/x" else message[0], *message[1:]) for message in wrong]
    others = "'publish' or 'header'" if clock == "log" else "'log' or 'publish'"
    with refused(rf"a message of /x has the time 0 by clock '{clock}', and others have dates; set clock = {others} in"):
        read_bag(write_bag(tmp_path / "wrong", wrong), tmp_path / "cell.toml")


def test_parts_of_one_recording_that_are_given_as_bags_are_reported(tmp_path):
    """ROS 2 splits long recordings into NAME_0.mcap, NAME_1.mcap and so on."""
    times = [("/x", 0.0), ("/action", 0.5), ("/reward", 2.0), ("/action", 2.5), ("/reward", 4.0), ("/end", 5.0)]
    messages = [pose(10.0 + at, topic, 1.0, stamp_s=at) for topic, at in times]
    parts = [
        write_mcap(tmp_path / f"rec_{k}.mcap", part, as_ros) for k, part in enumerate((messages[:3], messages[3:]))
    ]
    file = mapping(tmp_path, {name: source for name, source in OF_ROS.items() if not name.startswith("covariates")})
    with pytest.warns(
        HalfseenWarning, match=r"rec_1\.mcap: its name continues that of rec_0\.mcap, which has no ending"
    ):
        logs = read_bag(parts, file)
    assert logs.trajectories["cause"].tolist() == ["crash", None]
    whole = read_bag(write_mcap(tmp_path / "rec.mcap", messages, as_ros), file)
    assert (whole.num_trajectories, whole.end_s.tolist()) == (1, [4.5])
    (tmp_path / "cell.toml").write_text(file.read_text() + BEGIN)
    begun = (
        [pose(9.0, "/begin", 0.0, stamp_s=0.0), *messages[:3]],
        [*messages[3:], pose(20.0, "/begin", 0.0, stamp_s=9.0)],
    )
    parts = [write_mcap(tmp_path / f"begun_{k}.mcap", part, as_ros) for k, part in enumerate(begun)]
    message = r"begun_1\.mcap: 3 actions, rewards and endings come before the first message of /begin, and are left out"
    with (
        pytest.warns(HalfseenWarning, match=message),
        pytest.warns(HalfseenWarning, match="cut as it began; give the time"),
    ):
        read_bag(parts, file)
