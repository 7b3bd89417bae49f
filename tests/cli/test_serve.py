"""``halfseen serve`` as a process, at its port and its signals; ``halfseen record``, as a program speaks to it."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager
from subprocess import PIPE

import httpx2
import pytest

from halfseen.logs import read_logs
from halfseen.serving.limits import MOST_CONNECTIONS
from lines import as_lines
from small_logs import flat_learner, flat_log, kept

SEEN = {"x1": 0.4, "x2": 1}


@pytest.fixture
def policy(tmp_path):
    kept(flat_learner(), flat_log(), tmp_path / "policy")
    return tmp_path / "policy"


@contextmanager
def served(*words, **environment):
    """A server in a process of its own, and who asks it."""
    # A monitor would outlive a server that is killed, and speak in between.
    alone = ("--monitor-every", "0", "--port", "0")
    command = [sys.executable, "-m", "halfseen.cli", "serve", *alone, *map(str, words)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, env=os.environ | environment, **pipes) as process:
        try:
            url = process.stdout.readline().split()[0]
            with httpx2.Client(base_url=url, timeout=120) as client:
                yield process, client
        finally:
            process.kill()


def test_a_controller_without_python_gets_decisions_and_makes_the_next_log(policy, tmp_path):
    with served(policy, "--record", tmp_path / "logs", "--explore", "0.2") as (process, client):
        answer = client.post("/decide", json=SEEN).json()
        assert answer["action"] in ("A", "B")
        client.post("/reward", json={"reward": 2})
        kept(flat_learner(5.0), flat_log(), policy, overwrite=True)
        process.send_signal(signal.SIGHUP)
        assert client.post("/decide", json=SEEN).json()["policy"] == answer["policy"]
        client.post("/end", json={"ending": "cut", "cause": "operator"}).raise_for_status()
        for _ in range(2000):
            if client.get("/health").json()["policy"] != answer["policy"]:
                break
            time.sleep(0.05)
        assert client.post("/decide", json=SEEN).json()["policy"] != answer["policy"]
        (policy / "policy.json").write_text("{}")
        process.send_signal(signal.SIGHUP)
        assert "the previous policy stays in use" in process.stderr.readline()
        assert client.post("/reward", json={"reward": 1}).status_code == 200
        process.send_signal(signal.SIGTERM)
        process.wait(120)
    logs = read_logs(tmp_path / "logs")
    assert logs.trajectories["cause"].tolist() == ["operator", "server stopped"]
    assert logs.stages["reward"].dropna().tolist() == [2.0]


@pytest.mark.slow
def test_a_token_comes_from_the_environment_what_is_no_http_harms_nobody_and_ctrl_c_ends_it_without_a_word(policy):
    with served(policy, HALFSEEN_TOKEN="a-token-that-is-long") as (process, client):
        assert client.get("/health").status_code == 401
        client.headers["authorization"] = "Bearer a-token-that-is-long"
        assert client.get("/health").json()["status"] == "ok"
        for sent in (b"\x16\x03\x01", b"GET / HTTP/1.1\r\nx: " + b"y" * 100_000, b"POST /decide HTTP/9\r\n\r\n"):
            with socket.create_connection((client.base_url.host, client.base_url.port)) as raw:
                raw.sendall(sent)
                raw.settimeout(120)
                assert b"400" in raw.recv(100)
        with ExitStack() as idle:
            at = client.base_url.host, client.base_url.port
            for _ in range(MOST_CONNECTIONS):
                idle.enter_context(socket.create_connection(at))
            refused = httpx2.get(f"{client.base_url}/health", timeout=120)
            assert (refused.status_code, refused.headers["connection"]) == (503, "close")
            assert "keep one open" in refused.json()["error"]
        assert client.post("/decide", json=SEEN).status_code == 200
        # Also twice, as by one who does not wait.
        for _ in range(2):
            process.send_signal(signal.SIGINT)
        assert process.wait(120) == 0
        assert set(process.stderr.read().splitlines()) == {"WARNING:  Invalid HTTP request received."}


@pytest.mark.slow
def test_a_server_that_begins_again_has_its_log_watched_at_once(policy, tmp_path):
    words = (policy, "--record", tmp_path / "logs", "--monitor-every", "3600")
    with served(*words, "--monitor-every", "0") as (process, client):
        client.post("/decide", json=SEEN)
        client.post("/reward", json={"reward": 2, "elapsed_s": 1.0})
        client.post("/end", json={"ending": "finished", "elapsed_s": 1.0})
        process.send_signal(signal.SIGINT)
        process.wait(120)
    with served(*words) as (_, client):
        while client.get("/state").json()["monitor"] is None:
            time.sleep(0.01)


@pytest.mark.slow
def test_a_comparison_survives_kill_9_and_says_when_its_verdict_changes(policy, tmp_path):
    (tmp_path / "rule.csv").write_text("action\nA\n")
    words = (policy, "--record", tmp_path / "logs", "--against", tmp_path / "rule.csv", "--share", "0.5", "--seed", "1")

    def run(client, num):
        for _ in range(num):
            arm = client.post("/decide", json=SEEN).json()["arm"]
            client.post("/reward", json={"reward": 9.0 if arm == "policy" else 0.0, "elapsed_s": 1.0})
            client.post("/end", json={"ending": "finished", "elapsed_s": 2.0})

    with served(*words) as (process, client):
        run(client, 6)
        before = client.get("/comparison").json()
        client.post("/decide", json=SEEN)
        process.kill()
        process.wait(120)
    with served(*words) as (process, client):
        again = client.get("/comparison").json()
        # The stage in progress was cut.
        assert (before["num"], again["num"]) == (6, 7)
        run(client, 25)
        assert client.get("/comparison").json()["verdict"] == "promoted"
        assert process.stdout.readline().startswith("the policy is promoted after ")
    assert len(read_logs(tmp_path / "logs").trajectories) == 32


LINES = [
    {"call": "begin_trajectory"},
    {"call": "begin_stage", "covariates": {"x": 1}, "action": "PICK"},
    {"call": "complete_stage", "reward": 1.0, "elapsed_s": 2.0},
    {"call": "finish"},
]


# Where the tests run in the background of a shell, what they start would be deaf to Ctrl-C.
HEARS_CTRL_C = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
MAIN = f"{HEARS_CTRL_C}; from halfseen.cli import main; main()"


@contextmanager
def recording(*arguments):
    command = [sys.executable, "-c", MAIN, "record", *map(str, arguments)]
    with subprocess.Popen(command, stdin=PIPE, stdout=PIPE, stderr=PIPE) as other:
        try:
            yield other
        finally:
            other.kill()


@pytest.mark.slow
def test_a_program_speaks_over_a_pipe_and_each_line_is_answered_at_once(tmp_path):
    with recording("--out", tmp_path / "logs", "--fsync", "stage", "--reward-unit", "parts") as other:
        for call in LINES[:3]:
            other.stdin.write(as_lines([call]))
            other.stdin.flush()
            assert json.loads(other.stdout.readline()) == {"ok": True, "trajectory": 1}
        assert read_logs(tmp_path / "logs").trajectories["cause"].tolist() == ["still-running"]
        out, err = other.communicate(as_lines([LINES[3], b"nonsense"]))
        assert (other.returncode, err) == (0, b"")
    assert [json.loads(line)["ok"] for line in out.splitlines()] == [True, False]
    logs = read_logs(tmp_path / "logs")
    assert (logs.is_finished.tolist(), logs.reward_unit) == ([True], "parts")


@pytest.mark.slow
@pytest.mark.parametrize("is_port", [True, False])
def test_a_program_speaks_over_a_socket_and_ctrl_c_cuts_the_trajectory_in_progress_as_the_operator_does(
    tmp_path, is_port
):
    with recording("--out", tmp_path / "logs", "--listen", "0" if is_port else tmp_path / "socket") as other:
        where = other.stdout.readline().decode().split()[0]
        host, _, port = where.partition(":")
        with socket.socket(socket.AF_INET if is_port else socket.AF_UNIX) as client:
            client.connect((host, int(port)) if is_port else where)
            client.sendall(as_lines([*LINES, *LINES[:2]]))
            with client.makefile("rb") as answers:
                assert [json.loads(answers.readline())["ok"] for _ in range(6)] == [True] * 6
                other.send_signal(signal.SIGINT)
                assert other.wait(timeout=120.0) == 130
    assert host == "127.0.0.1" if is_port else not (tmp_path / "socket").exists()
    assert read_logs(tmp_path / "logs").trajectories["cause"].tolist() == [None, "operator"]


def test_lines_of_a_file_are_recorded(typed, tmp_path):
    (tmp_path / "calls.jsonl").write_bytes(as_lines(LINES))
    status, out, err = typed("record", tmp_path / "calls.jsonl", "--out", tmp_path / "logs")
    assert (status, out.count('"ok": true'), err) == (0, len(LINES), "")
    assert read_logs(tmp_path / "logs").num_trajectories == 1
