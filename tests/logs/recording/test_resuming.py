"""A trajectory that was torn goes on where somebody resumes it, and is read as if nothing had happened."""

import pandas as pd
import pytest

from halfseen.logs import LogRecorder, read_logs

STEPS = [
    lambda one: one.begin_stage({"x": 0.5}, action="A", probability=0.5),
    lambda one: one.complete_stage(1.0, elapsed_s=2.0),
    lambda one: one.begin_stage({"x": 0.7}, action="B", probability=0.25),
    lambda one: one.complete_stage(-1.0, elapsed_s=5.0),
    lambda one: one.finish(elapsed_s=6.0),
]


def record(folder, *, breaks=()):
    """Record one trajectory before, one that is left and resumed before these steps, and one after."""
    recorder = LogRecorder(folder)
    for name, left in (("before", ()), ("this", breaks), ("after", ())):
        trajectory = recorder.begin_trajectory(name, cell="left")
        for k, step in enumerate(STEPS):
            for _ in range(left.count(k)):
                recorder.close(None)
                recorder = LogRecorder(folder, keeps_events=True)
                if (resumed := recorder.resume()) is not None:
                    trajectory = resumed
                assert recorder.resume() is None
            step(trajectory)
    recorder.close()
    return read_logs(folder)


@pytest.mark.parametrize("breaks", [(1,), (2,), (3,), (4,), (1, 2, 3, 4), (2, 2)])
def test_what_is_left_anywhere_and_resumed_is_read_as_if_it_never_was(tmp_path, breaks):
    whole, mended = record(tmp_path / "whole"), record(tmp_path / "mended", breaks=breaks)
    for name, table in whole.tables.items():
        pd.testing.assert_frame_equal(mended.tables[name], table)


def test_what_is_not_resumed_is_cut_by_a_crash_and_what_has_ended_is_not_resumed(tmp_path):
    recorder = LogRecorder(tmp_path / "logs")
    trajectory = recorder.begin_trajectory()
    for step in STEPS[:3]:
        step(trajectory)
    recorder.close(None)
    with LogRecorder(tmp_path / "logs") as recorder:
        assert read_logs(tmp_path / "logs").trajectories["cause"].tolist() == ["crash"]
        trajectory = recorder.begin_trajectory()
        assert recorder.resume() is None
        for step in STEPS:
            step(trajectory)
    with LogRecorder(tmp_path / "logs") as recorder:
        assert recorder.resume() is None
    logs = read_logs(tmp_path / "logs")
    assert logs.trajectories[["ending", "end_s"]].to_numpy().tolist() == [["cut", 2.0], ["finished", 6.0]]


def test_a_trajectory_on_the_clock_of_a_process_that_has_gone_is_not_resumed(tmp_path):
    recorder = LogRecorder(tmp_path / "logs")
    trajectory = recorder.begin_trajectory()
    STEPS[0](trajectory)
    trajectory.complete_stage(1.0)
    recorder.close(None)
    with LogRecorder(tmp_path / "logs") as recorder:
        assert recorder.resume() is None
