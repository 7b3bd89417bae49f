from types import SimpleNamespace

import pytest

from halfseen.logs import LogRecorder


@pytest.fixture
def recorder(tmp_path):
    with LogRecorder(tmp_path / "logs") as recorder:
        yield recorder


@pytest.fixture
def wait(monkeypatch):
    """Moves the recorder's own clock, forward or back; there is no time of day that it could read."""
    now_s = [1000.0]
    monkeypatch.setattr("halfseen.logs.recording_state.time", SimpleNamespace(monotonic=lambda: now_s[0]))
    return lambda seconds: now_s.append(now_s.pop() + seconds)
