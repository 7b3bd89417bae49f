"""Kills and Ctrl-C at any moment: what is on disk is whole, and is what the recorder knows."""

import os
import random
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import pytest
from recordings import as_recorded, covariates_of, logs_or_none, reward_of

import halfseen.logs
from halfseen.errors import ArgumentError, LogError
from halfseen.logs import LogRecorder, read_logs
from halfseen.logs.journal import PART_BYTES

# JAX warns of forks where other tests have loaded it; the children here do not touch it.
pytestmark = pytest.mark.filterwarnings("ignore:os.fork:RuntimeWarning")

STAGES_A_TRAJECTORY, EVENTS_A_TRAJECTORY = 4, 9


def record_at_full_speed(folder, pipe):
    """Record without end, and report each event once it is returned from."""
    recorder = LogRecorder(folder, part_bytes=2000)
    while True:
        trajectory = recorder.begin_trajectory()
        for stage in range(1, STAGES_A_TRAJECTORY + 1):
            trajectory.begin_stage(covariates_of(trajectory.name, stage), [{"object": 1, "x": 1.0}], "PICK", 1, 0.5)
            os.write(pipe, b".")
            trajectory.complete_stage(reward_of(trajectory.name, stage))
            os.write(pipe, b".")
        trajectory.finish()
        os.write(pipe, b".")


def taken_after(num_events):
    """By trajectory: stages completed for good, as the next begins or it finishes; whether it did."""
    num_trajectories, more = divmod(num_events, EVENTS_A_TRAJECTORY)
    torn = {num_trajectories + 1: ((more - 1) // 2, False)} if more else {}
    return dict.fromkeys(range(1, num_trajectories + 1), (STAGES_A_TRAJECTORY, True)) | torn


@contextmanager
def recording_child(folder):
    """What a child reports that records, and what kills it."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            record_at_full_speed(folder, writing)
        finally:
            os._exit(1)
    os.close(writing)
    with os.fdopen(reading, "rb") as pipe:
        yield pipe, lambda: os.kill(child, signal.SIGKILL)
        assert os.WTERMSIG(os.waitpid(child, 0)[1]) == signal.SIGKILL


def recovered(folder):
    logs = logs_or_none(folder, "no such folder", "holds no logs")
    return {} if logs is None else as_recorded(logs)


def check_kills(folder, num_kills, longest_s, seed):
    """Kill children at any time; how many left a trajectory torn."""
    rng, num_torn = random.Random(seed), 0
    for kill in range(num_kills):
        with recording_child(folder / str(kill)) as (pipe, kill_it):
            # One in four may fall before anything is recorded; how slow the machine is, the others fall after it.
            result = pipe.read(1) if kill % 4 else b""
            time.sleep(rng.uniform(0.0, longest_s))
            kill_it()
            num_events = len(result + pipe.read())
        there = recovered(folder / str(kill))
        # An event may have reached the disk without being reported.
        assert there in (taken_after(num_events), taken_after(num_events + 1))
        num_torn += any(not is_finished for _, is_finished in there.values())
    return num_torn


@pytest.mark.slow
@pytest.mark.parametrize(
    ("num_kills", "longest_s", "seed", "fewest_torn"),
    [(16, 0.02, 1, 1), pytest.param(200, 0.01, 2, 100, marks=pytest.mark.slow)],
)
def test_kills_lose_at_most_the_stage_in_progress(tmp_path, num_kills, longest_s, seed, fewest_torn):
    """In a process with no more loaded than the recorder, which forks fast, whatever other tests have loaded here."""
    command = [sys.executable, __file__, str(tmp_path), str(num_kills), str(longest_s), str(seed)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > fewest_torn


@pytest.mark.slow
def test_one_folder_outlives_kills_and_another_process_is_refused_until_the_first_is_killed(tmp_path):
    num_trajectories = 0
    for _ in range(3):
        with recording_child(tmp_path) as (pipe, kill):
            pipe.read(20)
            with pytest.raises(ArgumentError, match="another recorder"):
                LogRecorder(tmp_path)
            assert set(read_logs(tmp_path).trajectories["cause"].dropna()) <= {"still-running", "crash"}
            kill()
        assert len(recovered(tmp_path)) > num_trajectories
        num_trajectories = len(recovered(tmp_path))
    with LogRecorder(tmp_path) as recorder:
        assert recorder.begin_trajectory().name > num_trajectories


# Ctrl-C.

FOLDER = str(Path(halfseen.logs.__file__).parent)
CHOICE = ([{"object": 1, "y": 0.5}], "PICK", 1, 0.5)


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


def record_stages(recorder, name, elapsed_s):
    """Record a trajectory of two stages."""
    trajectory = recorder.begin_trajectory(name, scene=1)
    for stage in (1, 2):
        trajectory.begin_stage({"x": stage}, *CHOICE)
        trajectory.still_running(elapsed_s=elapsed_s and stage - 0.5)
        trajectory.complete_stage(1.0, elapsed_s=elapsed_s and float(stage))
    trajectory.finish()


def interrupted(folder, at, elapsed_s):
    """Record with Ctrl-C at one line, and go on; False where there is no such line."""
    with LogRecorder(folder, part_bytes=PART_BYTES if elapsed_s else 1) as recorder:
        try:
            with Interrupter(at):
                record_stages(recorder, "a", elapsed_s)
            return False
        except KeyboardInterrupt:
            trajectory = recorder.trajectory
        if trajectory is not None and not trajectory.is_ended:
            if trajectory.is_in_stage:
                with pytest.raises(LogError, match="it is in progress"):
                    trajectory.begin_stage({"x": 9}, *CHOICE)
            trajectory.cut("operator")
        record_stages(recorder, "b", None)
    logs = read_logs(folder)
    assert logs.trajectory_ids.tolist() in (["b"], ["a", "b"])
    assert set(logs.trajectories["cause"].dropna()) <= {"operator"}
    assert logs.stages["x"].tolist() == logs.stages["stage"].tolist()
    with LogRecorder(folder) as recorder, pytest.raises(LogError, match="it is in the folder already"):
        recorder.begin_trajectory(logs.trajectory_ids[-1])
    return True


def left_by(folder, at, elapsed_s):
    """Leave a with block by Ctrl-C at one line; False where there is no such line."""
    try:
        with LogRecorder(folder) as recorder, Interrupter(at):
            record_stages(recorder, "a", elapsed_s)
        return False
    except KeyboardInterrupt:
        logs = logs_or_none(folder)
    assert logs is None or logs.trajectories["cause"].dropna().tolist() in ([], ["operator"])
    return True


@pytest.mark.slow
@pytest.mark.parametrize(("cut", "elapsed_s"), [(interrupted, None), (interrupted, 1.0), (left_by, None)])
@pytest.mark.parametrize("lines_apart", [61, pytest.param(2, marks=pytest.mark.slow)])
def test_ctrl_c_at_any_line_leaves_recorder_and_folder_at_one(tmp_path, lines_apart, cut, elapsed_s):
    last = 0
    while cut(tmp_path / str(last), last, elapsed_s):
        last += lines_apart
    assert last > 200


if __name__ == "__main__":
    print(check_kills(Path(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]), int(sys.argv[4])))
