"""Kills and Ctrl-C at any moment: what is on disk is whole, and is what the recorder knows."""

import os
import random
import signal
import struct
import subprocess
import sys
import time
from pathlib import Path

import pytest
from recordings import as_recorded, covariates_of, logs_or_none, reward_of

import halfseen.logs
from halfseen.errors import ArgumentError, LogError
from halfseen.logs import LogRecorder, read_logs
from halfseen.logs.journal.parts import PART_BYTES

# JAX warns of forks where other tests have loaded it; the children here do not touch it.
pytestmark = pytest.mark.filterwarnings("ignore:os.fork:RuntimeWarning")

STAGES_A_PATH = 4
BEGUN, COMPLETED, FINISHED = range(3)
REPORT = struct.Struct("<BII")


def record_at_full_speed(folder, pipe):
    """Record without end, and report each event once it is returned from."""
    recorder = LogRecorder(folder, part_bytes=2000)
    while True:
        path = recorder.begin_path()
        for stage in range(1, STAGES_A_PATH + 1):
            path.begin_stage(covariates_of(path.name, stage), [{"object": 1, "x": 1.0}], "PICK", 1, 0.5)
            os.write(pipe, REPORT.pack(BEGUN, path.name, stage))
            path.complete_stage(reward_of(path.name, stage))
            os.write(pipe, REPORT.pack(COMPLETED, path.name, stage))
        path.finish()
        os.write(pipe, REPORT.pack(FINISHED, path.name, STAGES_A_PATH))


def recording_child(folder):
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            record_at_full_speed(folder, writing)
        finally:
            os._exit(1)
    os.close(writing)
    return child, os.fdopen(reading, "rb")


def kill_one(folder, seconds, has_begun):
    """Let a child record for a while, kill it, and return what it reported, as (kind, path, stage).

    The while is counted from where it was started, or, however slow the machine is, from its first report.
    """
    child, pipe = recording_child(folder)
    told = pipe.read(REPORT.size) if has_begun else b""
    time.sleep(seconds)
    os.kill(child, signal.SIGKILL)
    with pipe:
        told += pipe.read()
    _, status = os.waitpid(child, 0)
    assert os.WTERMSIG(status) == signal.SIGKILL
    whole = len(told) // REPORT.size * REPORT.size
    return list(REPORT.iter_unpack(told[:whole]))


def events_after(reports):
    """The event that follows: it may have reached the disk without being reported."""
    if not reports:
        return (BEGUN, 1, 1)
    kind, path, stage = reports[-1]
    if kind == BEGUN:
        return (COMPLETED, path, stage)
    if kind == FINISHED:
        return (BEGUN, path + 1, 1)
    return (BEGUN, path, stage + 1) if stage < STAGES_A_PATH else (FINISHED, path, stage)


def expected(reports):
    """Number of stages of each path that are completed for good, and whether the path finished."""
    paths = {}
    for kind, path, stage in reports:
        # A stage is completed for good when the next begins, or the path finishes.
        paths[path] = (stage if kind == FINISHED else stage - 1, kind == FINISHED)
    return paths


def recovered(folder):
    logs = logs_or_none(folder, "there is no such folder", "holds no logs")
    return {} if logs is None else as_recorded(logs)


def check_kills(folder, num_kills, longest_s, seed):
    rng = random.Random(seed)
    num_torn = 0
    for kill in range(num_kills):
        logs = folder / str(kill)
        # One in four may fall before anything is recorded.
        reports = kill_one(logs, rng.uniform(0.0, longest_s), has_begun=kill % 4 > 0)
        there = recovered(logs)
        assert there in (expected(reports), expected([*reports, events_after(reports)]))
        num_torn += any(not is_finished for _, is_finished in there.values())
    return num_torn


@pytest.mark.parametrize(
    ("num_kills", "longest_s", "seed", "fewest_torn"),
    [(40, 0.02, 1, 5), pytest.param(1000, 0.01, 2, 500, marks=pytest.mark.slow)],
)
def test_kills_lose_at_most_the_stage_in_progress(tmp_path, num_kills, longest_s, seed, fewest_torn):
    """In a process with no more loaded than the recorder, which forks fast, whatever other tests have loaded here."""
    command = [sys.executable, __file__, str(tmp_path), str(num_kills), str(longest_s), str(seed)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > fewest_torn


def test_one_folder_outlives_many_kills_and_another_process_is_refused_until_the_first_is_killed(tmp_path):
    num_paths = 0
    for _ in range(5):
        child, pipe = recording_child(tmp_path)
        with pipe:
            pipe.read(REPORT.size * 20)
            with pytest.raises(ArgumentError, match="another recorder"):
                LogRecorder(tmp_path)
            assert set(read_logs(tmp_path).paths["cause"].dropna()) <= {"still-running", "crash"}
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
        there = recovered(tmp_path)
        assert len(there) > num_paths
        num_paths = len(there)
    with LogRecorder(tmp_path) as recorder:
        assert recorder.begin_path().name > num_paths


# Ctrl-C.

FOLDER = str(Path(halfseen.logs.__file__).parent)


class Interrupter:
    """Raises KeyboardInterrupt at one of the lines that the package of logs runs, counted from 0."""

    def __init__(self, at):
        self.at, self.count = at, 0

    def __enter__(self):
        sys.settrace(self._of_call)

    def __exit__(self, *_):
        sys.settrace(None)

    def _of_call(self, frame, kind, _):
        return self._of_line if frame.f_code.co_filename.startswith(FOLDER) else None

    def _of_line(self, frame, kind, _):
        if kind == "line":
            self.count += 1
            if self.count - 1 == self.at:
                sys.settrace(None)
                raise KeyboardInterrupt
        return self._of_line


CHOICE = ([{"object": 1, "y": 0.5}], "PICK", 1, 0.5)


def record_stages(recorder, elapsed_s):
    """Record a path of two stages."""
    path = recorder.begin_path("a", scene=1)
    for stage in (1, 2):
        path.begin_stage({"x": stage}, *CHOICE)
        path.still_running(elapsed_s=elapsed_s and stage - 0.5)
        path.complete_stage(1.0, elapsed_s=elapsed_s and float(stage))
    path.finish()


def interrupted(folder, at, elapsed_s):
    """Record with Ctrl-C at one line, and go on; False where there is no such line."""
    interrupter = Interrupter(at)
    with LogRecorder(folder, part_bytes=PART_BYTES if elapsed_s else 1) as recorder:
        try:
            with interrupter:
                record_stages(recorder, elapsed_s)
            return False
        except KeyboardInterrupt:
            pass
        path = recorder.path
        if path is not None and not path.is_ended:
            if path.is_in_stage:
                with pytest.raises(LogError, match="it is in progress"):
                    path.begin_stage({"x": 9}, *CHOICE)
            path.cut("operator")
        path = recorder.begin_path("b")
        path.begin_stage({"x": 3}, *CHOICE)
        path.complete_stage(1.0)
        path.finish()
    return True


def check_interrupt(folder, at, elapsed_s):
    is_there = interrupted(folder, at, elapsed_s)
    logs = read_logs(folder)
    if is_there:
        assert logs.path_ids.tolist() in (["b"], ["a", "b"])
        assert set(logs.paths["cause"].dropna()) <= {"operator"}
        stages = logs.stages[logs.stages["path"] == "a"]
        assert stages["x"].tolist() == stages["stage"].tolist()
    with LogRecorder(folder) as recorder, pytest.raises(LogError, match="it is in the folder already"):
        recorder.begin_path(logs.path_ids[-1])
    return is_there


@pytest.mark.parametrize("elapsed_s", [None, 1.0])
@pytest.mark.parametrize("lines_apart", [37, pytest.param(1, marks=pytest.mark.slow)])
def test_ctrl_c_at_any_line_leaves_recorder_and_folder_at_one(tmp_path, lines_apart, elapsed_s):
    last = 0
    while check_interrupt(tmp_path / str(last), last, elapsed_s):
        last += lines_apart
    assert last > 200


def test_ctrl_c_in_a_with_block_cuts_the_path_where_the_recorder_knows_it(tmp_path):
    at = 0
    for at in range(0, 1000, 37):
        try:
            with LogRecorder(tmp_path / str(at)) as recorder, Interrupter(at):
                record_stages(recorder, None)
            break
        except KeyboardInterrupt:
            pass
        logs = logs_or_none(tmp_path / str(at))
        assert logs is None or logs.paths["cause"].dropna().tolist() in ([], ["operator"])
    assert at > 200


if __name__ == "__main__":
    print(check_kills(Path(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]), int(sys.argv[4])))
