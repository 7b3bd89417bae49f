"""``halfseen record``, as another program speaks to it."""

import json
import signal
import socket
import subprocess
import sys
from contextlib import contextmanager
from subprocess import PIPE

import pytest

from halfseen.logs import read_logs
from lines import as_lines

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
