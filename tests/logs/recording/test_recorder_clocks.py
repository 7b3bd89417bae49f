"""Clocks that jump: the time of day may go where it likes, and a clock that falls back leaves paths in order."""

import time
from itertools import chain, repeat

import pytest

from halfseen.logs import LogRecorder, read_logs


class Clock:
    """Stands in for `time`: each reading is the next of a list and then its last, and the time of day jumps."""

    def __init__(self, readings_s):
        self._readings_s = chain(readings_s, repeat(readings_s[-1]))
        self._days = iter([10**9, -(10**9)] * 10**3)

    def __getattr__(self, name):
        return getattr(time, name)

    def monotonic(self):
        return next(self._readings_s)

    def time(self):
        return next(self._days)


def recorded(folder, monkeypatch, readings_s):
    monkeypatch.setattr("halfseen.logs.journal.clock.time", Clock(readings_s))
    with LogRecorder(folder) as recorder:
        path = recorder.begin_path()
        for stage in (1, 2, 3):
            path.begin_stage({"x": stage}, action="PICK")
            path.complete_stage(1.0)
        path.finish()
    return read_logs(folder)


def test_the_time_of_day_is_never_read(tmp_path, monkeypatch):
    monkeypatch.setattr(time, "time", lambda: pytest.fail("the time of day was read"))
    monkeypatch.setattr(time, "time_ns", lambda: pytest.fail("the time of day was read"))
    logs = recorded(tmp_path, monkeypatch, [100.0, 100.5, 101.0, 101.5, 102.0, 102.5, 103.0])
    assert logs.stages["elapsed_s"].tolist() == [1.0, 2.0, 3.0]
    assert logs.paths["end_s"].tolist() == [3.0]


def test_a_clock_that_falls_back_or_stands_leaves_stages_in_order(tmp_path, monkeypatch):
    logs = recorded(tmp_path, monkeypatch, [100.0, 100.5, 101.0, 90.0, 90.0, 95.0, 95.0])
    assert logs.stages["elapsed_s"].is_monotonic_increasing
    assert logs.stages["elapsed_s"].diff().dropna().gt(0.0).all()
    assert logs.paths["end_s"].tolist() == [pytest.approx(1.0, abs=1e-6)]
