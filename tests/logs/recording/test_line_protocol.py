"""Programs in any language record line by line, and a bad line harms none after it."""

import io
import json
import re
import socket
import threading
from contextlib import suppress

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from recordings import logs_or_none
from test_logs import assert_same

from halfseen.errors import ArgumentError, LogError
from halfseen.logs import LogRecorder, read_logs
from halfseen.logs.recording.line_protocol import CALLS, MOST_BYTES, record_lines
from halfseen.logs.recording.line_socket import listening, record_clients

STAGE = {"covariates": {"x": 0.5, "seen": [1, 2]}, "objects": [{"object": 1, "y": 2}]}
PATH = [
    {"call": "begin_path", "columns": {"cell": "left"}},
    {"call": "begin_stage", **STAGE, "action": "PICK", "object": 1, "probability": 0.5},
    {"call": "still_running", "elapsed_s": 1.0},
    {"call": "complete_stage", "reward": 1.0, "elapsed_s": 2.5},
    {"call": "finish"},
]


def recorded(folder, lines, **options):
    """Record lines; their answers."""
    answers = []
    content = b"".join(line if isinstance(line, bytes) else json.dumps(line).encode() + b"\n" for line in lines)
    with LogRecorder(folder, **options) as recorder:
        record_lines(recorder, io.BytesIO(content), lambda text: answers.append(json.loads(text)))
    return answers


def test_lines_record_what_the_calls_would(tmp_path):
    answers = recorded(tmp_path / "lines", PATH)
    assert answers == [{"ok": True, "path": 1}] * len(PATH)
    with LogRecorder(tmp_path / "calls") as recorder:
        path = recorder.begin_path(cell="left")
        path.begin_stage(**STAGE, action="PICK", object=1, probability=0.5)
        path.still_running(elapsed_s=1.0)
        path.complete_stage(1.0, elapsed_s=2.5)
        path.finish()
    assert_same(read_logs(tmp_path / "lines"), read_logs(tmp_path / "calls"))


def test_lines_record_a_team(tmp_path):
    stage = {"call": "begin_stage", "covariates": {"x": 1}, "action": "WAIT", "robot": 0}
    out = {"call": "drop_out", "robot": 1, "cause": "battery", "elapsed_s": 1.0}
    done = {"call": "complete_stage", "reward": 3, "elapsed_s": 2.0, "own_rewards": [3, 0]}
    cut = {"call": "cut", "cause": "operator", "elapsed_s": 3.0}
    assert all(each["ok"] for each in recorded(tmp_path, [{"call": "begin_path"}, stage, out, done, stage, cut]))
    logs = read_logs(tmp_path)
    assert logs.paths["1_out_cause"].tolist() == ["battery"]
    assert logs.stages["0_reward"].tolist()[:1] == [3.0]


def test_where_lines_end_the_path_in_progress_is_cut(tmp_path):
    assert all(answer["ok"] for answer in recorded(tmp_path, PATH[:2]))
    assert read_logs(tmp_path).paths["cause"].tolist() == ["input-ended"]


BAD = {
    "finish: no path has begun; begin_path first": b'{"call": "finish"}\n',
    "is no JSON": b"nonsense\n",
    "it is nested too deep|no JSON": b"[" * 100_000 + b"\n",
    "names no call": b"[1]\n",
    "call.*one of begin_path": b'{"call": 1}\n',
    "did you mean 'complete_stage'": b'{"call": "complete_stag"}\n',
    "takes no 'rewrd'": b'{"call": "complete_stage", "rewrd": 1}\n',
    "complete_stage needs reward": b'{"call": "complete_stage", "reward": null}\n',
    "NaN is no number": b'{"call": "complete_stage", "reward": NaN}\n',
    "reward is inf": b'{"call": "complete_stage", "reward": 1e999, "elapsed_s": 2.0}\n',
    "a name is given twice": b'{"call": "complete_stage", "reward": 1, "reward": 2}\n',
    "longer than": b'{"call": "complete_stage", "reward": "' + b"9" * (2 * MOST_BYTES + 5) + b'"}\n',
    "no JSON .*utf-8": b'{"call": "cut", "cause": "\xff"}\n',
    "columns are no JSON object": b'{"call": "begin_path", "columns": [1]}\n',
    "own_rewards is 5": b'{"call": "complete_stage", "reward": 1, "own_rewards": 5}\n',
    "objects is 5": b'{"call": "begin_stage", "covariates": {"x": 0.5, "seen": []}, "objects": 5, "action": "A"}\n',
    "is in progress": b'{"call": "begin_path"}\n',
}


@pytest.mark.parametrize("trouble", BAD)
def test_a_bad_line_is_told_in_one_and_harms_none_after_it(tmp_path, trouble):
    number = {"objects is 5": 4, "finish: no path has begun; begin_path first": 0}.get(trouble, 2)
    answers = recorded(tmp_path, [*PATH[:number], BAD[trouble], b"\n", *PATH[number:]])
    assert [answer["ok"] for answer in answers] == [True] * number + [False] + [True] * (len(PATH) - number)
    assert re.search(trouble, answers[number]["error"])
    assert len(answers[number]["error"]) < 400
    assert read_logs(tmp_path).is_finished.tolist() == [True]


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=5,
)
CALL = st.sampled_from(sorted(CALLS)).flatmap(
    lambda name: st.fixed_dictionaries({"call": st.just(name)}, optional=dict.fromkeys(CALLS[name].names, JSON))
)


@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
@given(lines=st.lists(CALL | JSON | st.binary(max_size=9).map(lambda odd: odd.replace(b"\n", b"") + b"\n"), max_size=8))
def test_whatever_lines_say_a_whole_path_can_follow(tmp_path_factory, lines):
    folder = tmp_path_factory.mktemp("logs") / "logs"
    answers = recorded(folder, [PATH[0], *lines, {"call": "cut", "cause": "operator"}])
    assert all(set(answer) in ({"ok", "path"}, {"ok", "error"}) for answer in answers)
    logs_or_none(folder)


@pytest.fixture(params=["port", "file"])
def served(request, tmp_path):
    """The address at which a recorder of tmp_path / "logs" takes clients, and what waits until one has gone."""
    gone = threading.Semaphore(0)
    address = 0 if request.param == "port" else tmp_path / "socket"
    with LogRecorder(tmp_path / "logs") as recorder, listening(address) as listener:

        def serve():
            with suppress(OSError):  # the listener is closed at the end of a test, perhaps before the next accept
                record_clients(recorder, listener, gone.release)

        threading.Thread(target=serve, daemon=True).start()
        yield listener.getsockname(), lambda: gone.acquire(timeout=60.0)


def connected(where):
    client = socket.socket(socket.AF_UNIX if isinstance(where, str) else socket.AF_INET)
    client.settimeout(60.0)
    client.connect(where)
    return client


def test_clients_record_one_after_the_other(served, tmp_path):
    where, has_gone = served
    for lines in (PATH, PATH[:2]):
        with connected(where) as client, client.makefile("rwb") as stream:
            for line in lines:
                stream.write(json.dumps(line).encode() + b"\n")
                stream.flush()
                assert json.loads(stream.readline())["ok"]
        assert has_gone()
    assert read_logs(tmp_path / "logs").paths["cause"].tolist() == [None, "input-ended"]


def test_a_client_that_leaves_without_its_answers_harms_none_after_it(served, tmp_path):
    where, has_gone = served
    for _ in range(2):
        with connected(where) as client:
            client.sendall(b"".join(json.dumps(line).encode() + b"\n" for line in PATH))
            client.shutdown(socket.SHUT_WR)
        assert has_gone()
    assert 0 < read_logs(tmp_path / "logs").num_paths <= 2


def test_a_browser_is_turned_away_before_what_it_posts_is_read(served, tmp_path):
    where, has_gone = served
    posted = json.dumps(PATH[0]) + "\n" + json.dumps({"call": "begin_stage", "action": "A"}) + "\n"
    with connected(where) as client:
        client.sendall(f"POST / HTTP/1.1\r\nHost: x\r\n\r\n{posted}".encode())
        assert b"is no JSON" in client.recv(1000)
    assert has_gone()
    with pytest.raises(LogError, match="no stage is recorded yet"):
        read_logs(tmp_path / "logs")


def test_a_socket_that_is_taken_is_refused_and_one_left_behind_is_not(tmp_path):
    file = tmp_path / "socket"
    with listening(file):
        assert file.stat().st_mode & 0o077 == 0
        with pytest.raises(ArgumentError, match="nobody can listen there"), listening(file):
            pass
    with socket.socket(socket.AF_UNIX) as left:
        left.bind(str(file))
    with listening(file):
        pass
    file.write_text("mine")
    with pytest.raises(ArgumentError, match="nobody can listen there"), listening(file):
        pass
    assert file.read_text() == "mine"
