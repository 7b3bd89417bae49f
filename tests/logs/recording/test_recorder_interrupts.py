"""Ctrl-C at each line that a recorder runs: what is on disk and what the recorder knows stay one."""

import sys
from pathlib import Path

import pytest
from recordings import logs_or_none

import halfseen.logs
from halfseen.errors import LogError
from halfseen.logs import LogRecorder, read_logs
from halfseen.logs.journal.parts import PART_BYTES

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


def record(recorder, elapsed_s):
    """Record a path of two stages."""
    path = recorder.begin_path("a", scene=1)
    for stage in (1, 2):
        path.begin_stage({"x": stage}, [{"object": 1, "y": 0.5}], action="PICK", object=1, probability=0.5)
        path.still_running(elapsed_s=elapsed_s and stage - 0.5)
        path.complete_stage(1.0, elapsed_s=elapsed_s and float(stage))
    path.finish()


def interrupted(folder, at, elapsed_s):
    """Record with Ctrl-C at one line, and go on; False where there is no such line."""
    interrupter = Interrupter(at)
    with LogRecorder(folder, part_bytes=PART_BYTES if elapsed_s else 1) as recorder:
        try:
            with interrupter:
                record(recorder, elapsed_s)
            return False
        except KeyboardInterrupt:
            pass
        path = recorder.path
        if path is not None and not path.is_ended:
            if path.is_in_stage:
                with pytest.raises(LogError, match="it is in progress"):
                    path.begin_stage({"x": 9}, [{"object": 1, "y": 0.5}], "PICK", 1, 0.5)
            path.cut("operator")
        path = recorder.begin_path("b")
        path.begin_stage({"x": 3}, [{"object": 1, "y": 0.5}], "PICK", 1, 0.5)
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
                record(recorder, None)
            break
        except KeyboardInterrupt:
            pass
        logs = logs_or_none(tmp_path / str(at))
        assert logs is None or logs.paths["cause"].dropna().tolist() in ([], ["operator"])
    assert at > 200
