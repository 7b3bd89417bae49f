"""Programs in any language record line by line, and a bad line harms none after it."""

import io
import json
import re
import socket
import threading
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st
from recordings import logs_or_none

from halfseen.errors import ArgumentError, LogError
from halfseen.logs import LogRecorder, read_logs
from halfseen.logs.protocol import CALLS, MOST_BYTES, listening, record_clients, record_lines
from lines import as_lines
from valid_logs import assert_same

STAGE = {"covariates": {"x": 0.5, "seen": [1, 2]}, "objects": [{"object": 1, "y": 2}]}
TRAJECTORY = [
    {"call": "begin_trajectory", "columns": {"cell": "left"}},
    {"call": "begin_stage", **STAGE, "action": "PICK", "object": 1, "probability": 0.5},
    {"call": "still_running", "elapsed_s": 1.0},
    {"call": "complete_stage", "reward": 1.0, "elapsed_s": 2.5},
    {"call": "finish"},
]
TEAM_STAGE = {"call": "begin_stage", "covariates": {"x": 1}, "action": "WAIT", "robot": 0}
TEAM = [
    {"call": "begin_trajectory"},
    TEAM_STAGE,
    {"call": "drop_out", "robot": 1, "cause": "battery", "elapsed_s": 1.0},
    {"call": "complete_stage", "reward": 3, "elapsed_s": 2.0, "own_rewards": [3, 0]},
    TEAM_STAGE,
    {"call": "cut", "cause": "operator", "elapsed_s": 3.0},
]


def recorded(folder, lines):
    """Record lines; their answers."""
    answers = []
    with LogRecorder(folder) as recorder:
        record_lines(recorder, io.BytesIO(as_lines(lines)), lambda text: answers.append(json.loads(text)))
    return answers


def test_lines_record_what_the_calls_would(tmp_path):
    assert recorded(tmp_path / "lines", TRAJECTORY) == [{"ok": True, "trajectory": 1}] * len(TRAJECTORY)
    with LogRecorder(tmp_path / "calls") as recorder:
        trajectory = recorder.begin_trajectory(cell="left")
        trajectory.begin_stage(**STAGE, action="PICK", object=1, probability=0.5)
        trajectory.still_running(elapsed_s=1.0)
        trajectory.complete_stage(1.0, elapsed_s=2.5)
        trajectory.finish()
    assert_same(read_logs(tmp_path / "lines"), read_logs(tmp_path / "calls"))
    assert all(each["ok"] for each in recorded(tmp_path / "team", TEAM))
    logs = read_logs(tmp_path / "team")
    assert (logs.trajectories["1_out_cause"].tolist(), logs.stages["0_reward"].tolist()[:1]) == (["battery"], [3.0])
    # Where lines end, the trajectory in progress is cut.
    assert all(answer["ok"] for answer in recorded(tmp_path / "short", TRAJECTORY[:2]))
    assert read_logs(tmp_path / "short").trajectories["cause"].tolist() == ["input-ended"]


BAD = {
    "finish: no trajectory has begun; begin_trajectory first": b'{"call": "finish"}\n',
    "is not valid JSON": b"nonsense\n",
    "it is nested too deep|no JSON": b"[" * 100_000 + b"\n",
    "has no call": b"[1]\n",
    "call.*one of begin_trajectory": b'{"call": 1}\n',
    "did you mean 'complete_stage'": b'{"call": "complete_stag"}\n',
    "takes no 'rewrd'": b'{"call": "complete_stage", "rewrd": 1}\n',
    "complete_stage needs reward": b'{"call": "complete_stage", "reward": null}\n',
    "NaN is not a number": b'{"call": "complete_stage", "reward": NaN}\n',
    "reward is inf": b'{"call": "complete_stage", "reward": 1e999, "elapsed_s": 2.0}\n',
    "'reward' is given twice": b'{"call": "complete_stage", "reward": 1, "reward": 2}\n',
    "longer than": b'{"call": "complete_stage", "reward": "' + b"9" * (2 * MOST_BYTES + 5) + b'"}\n',
    "not valid JSON .*utf-8": b'{"call": "cut", "cause": "\xff"}\n',
    "columns are not a JSON object": b'{"call": "begin_trajectory", "columns": [1]}\n',
    "own_rewards is 5": b'{"call": "complete_stage", "reward": 1, "own_rewards": 5}\n',
    "objects is 5": b'{"call": "begin_stage", "covariates": {"x": 0.5, "seen": []}, "objects": 5, "action": "A"}\n',
    "is in progress": b'{"call": "begin_trajectory"}\n',
}
PLACE = {"objects is 5": 4, "finish: no trajectory has begun; begin_trajectory first": 0}
"""Number of lines before a bad one, where it is not 2."""


def test_bad_lines_are_reported_in_one_and_harm_none_after_them(tmp_path):
    lines = {
        trouble: [*TRAJECTORY[: PLACE.get(trouble, 2)], bad, b"\n", *TRAJECTORY[PLACE.get(trouble, 2) :]]
        for trouble, bad in BAD.items()
    }
    answers = iter(recorded(tmp_path, [line for each in lines.values() for line in each]))
    for trouble in BAD:
        number = PLACE.get(trouble, 2)
        result = [next(answers) for _ in range(len(TRAJECTORY) + 1)]
        assert [answer["ok"] for answer in result] == [True] * number + [False] + [True] * (len(TRAJECTORY) - number), (
            trouble
        )
        assert re.search(trouble, result[number]["error"])
        assert len(result[number]["error"]) < 400
    assert read_logs(tmp_path).is_finished.tolist() == [True] * len(BAD)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=5,
)
CALL = st.sampled_from(sorted(CALLS)).flatmap(
    lambda name: st.fixed_dictionaries({"call": st.just(name)}, optional=dict.fromkeys(CALLS[name], JSON))
)
ODD = st.binary(max_size=9).map(lambda odd: odd.replace(b"\n", b"") + b"\n")


@pytest.mark.slow
@given(lines=st.lists(CALL | JSON | ODD, max_size=8))
def test_whatever_lines_say_a_whole_trajectory_can_follow(tmp_path_factory, lines):
    folder = tmp_path_factory.mktemp("logs") / "logs"
    answers = recorded(folder, [TRAJECTORY[0], *lines, {"call": "cut", "cause": "operator"}])
    assert all(set(answer) in ({"ok", "trajectory"}, {"ok", "error"}) for answer in answers)
    logs_or_none(folder)


@pytest.fixture(params=["port", "file"])
def served(request, tmp_path):
    """What connects to a recorder of tmp_path / "logs", and what waits until a client has gone."""
    gone = threading.Semaphore(0)
    address = 0 if request.param == "port" else tmp_path / "socket"
    with LogRecorder(tmp_path / "logs") as recorder, listening(address) as listener:
        where = listener.getsockname()

        def serve():
            with suppress(OSError):  # the listener is closed at the end of a test, perhaps before the next accept
                record_clients(recorder, listener, gone.release)

        def connected():
            client = socket.socket(listener.family)
            client.settimeout(60.0)
            client.connect(where)
            return client

        threading.Thread(target=serve, daemon=True).start()
        yield connected, lambda: gone.acquire(timeout=60.0)


def test_clients_record_one_after_the_other(served, tmp_path):
    connected, has_gone = served
    for lines in (TRAJECTORY, TRAJECTORY[:2]):
        with connected() as client, client.makefile("rwb") as stream:
            for line in lines:
                stream.write(as_lines([line]))
                stream.flush()
                assert json.loads(stream.readline())["ok"]
        assert has_gone()
    assert read_logs(tmp_path / "logs").trajectories["cause"].tolist() == [None, "input-ended"]
    # One that leaves without its answers harms none after it.
    for _ in range(2):
        with connected() as client:
            client.sendall(as_lines(TRAJECTORY))
            client.shutdown(socket.SHUT_WR)
        assert has_gone()
    assert 2 < read_logs(tmp_path / "logs").num_trajectories <= 4


def test_a_browser_is_turned_away_before_what_it_posts_is_read(served, tmp_path):
    connected, has_gone = served
    posted = as_lines([TRAJECTORY[0], {"call": "begin_stage", "action": "A"}])
    with connected() as client:
        client.sendall(b"POST / HTTP/1.1\r\nHost: x\r\n\r\n" + posted)
        assert b"is not valid JSON" in client.recv(1000)
    assert has_gone()
    with pytest.raises(LogError, match="no stage is recorded yet"):
        read_logs(tmp_path / "logs")


def test_a_socket_that_is_taken_is_refused_and_one_left_behind_is_not(tmp_path):
    file = tmp_path / "socket"

    def refused():
        with pytest.raises(ArgumentError, match="it cannot be listened on"), listening(file):
            pass

    with listening(file):
        assert file.stat().st_mode & 0o077 == 0
        refused()
    with socket.socket(socket.AF_UNIX) as left:
        left.bind(str(file))
    with listening(file):
        pass
    file.write_text("mine")
    refused()
    assert file.read_text() == "mine"
