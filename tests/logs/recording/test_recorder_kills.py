"""A recorder that is killed at random moments, and what is left of what it recorded."""

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

from halfseen.errors import ArgumentError
from halfseen.logs import LogRecorder, read_logs

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


@pytest.mark.slow
def test_one_folder_outlives_many_kills(tmp_path):
    rng = random.Random(3)
    num_paths = 0
    for _ in range(15):
        child, pipe = recording_child(tmp_path)
        with pipe:
            pipe.read(REPORT.size * 20)
            time.sleep(rng.uniform(0.0, 0.005))
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
        there = recovered(tmp_path)
        assert len(there) > num_paths
        num_paths = len(there)
    assert 5 <= sum(not is_finished for _, is_finished in there.values()) <= 15


def test_another_process_is_refused_until_the_first_is_killed(tmp_path):
    child, pipe = recording_child(tmp_path)
    with pipe:
        pipe.read(REPORT.size * 20)
        with pytest.raises(ArgumentError, match="another recorder"):
            LogRecorder(tmp_path)
        assert read_logs(tmp_path).paths["cause"].dropna().isin(["still-running"]).all()
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
    with LogRecorder(tmp_path) as recorder:
        assert recorder.begin_path().name > 1


if __name__ == "__main__":
    print(check_kills(Path(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]), int(sys.argv[4])))
