"""Disks that are full, fail or lose power: what was taken is kept, and the recorder says so and goes on."""

import errno
import os
import random
import re
import resource
import zlib
from contextlib import contextmanager, nullcontext
from shutil import rmtree
from warnings import catch_warnings, simplefilter

import pytest
from recordings import begin, finished, logs_or_none, record_trajectory

from halfseen.errors import HalfseenWarning, LogError
from halfseen.logs import LogRecorder, read_logs
from halfseen.logs.journal import JOURNAL

# A disk that does not take what is written.


class FailingDisk:
    """Stands in for `os`: some calls write a part and fail, or fail altogether."""

    def __init__(self, seed, share):
        self._rng, self.share = random.Random(seed), share

    def __getattr__(self, name):
        return getattr(os, name)

    def _fail(self, code):
        if self._rng.random() < self.share:
            raise OSError(code, os.strerror(code))

    def write(self, descriptor, line):
        if self._rng.random() >= self.share:
            return os.write(descriptor, line)
        num_bytes = os.write(descriptor, line[: self._rng.randrange(len(line))])
        if self._rng.random() < 0.5:
            return num_bytes
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def fsync(self, descriptor):
        self._fail(errno.EIO)

    def ftruncate(self, descriptor, num_bytes):
        self._fail(errno.EIO)
        os.ftruncate(descriptor, num_bytes)


def failing(monkeypatch, seed, share=0.3):
    disk = FailingDisk(seed, share)
    monkeypatch.setattr("halfseen.logs.journal_writer.os", disk)
    return disk


@contextmanager
def full(num_bytes=20_000):
    """As a disk that is full until room is made; other processes have room."""
    hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
    resource.setrlimit(resource.RLIMIT_FSIZE, (num_bytes, hard))
    try:
        yield lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))


def until_it_is_taken(on_refusal, call, *given, **named):
    """Give an event again until it is taken; returns what was said each time."""
    result = []
    while True:
        try:
            call(*given, **named)
        except LogError as error:
            assert re.search(r"cannot be written \(.* give it again; all earlier events are kept", str(error))  # noqa: PT017
            result.append(str(error))
            on_refusal()
        else:
            return result


def record_all(recorder, num_trajectories, num_stages, on_refusal=lambda: None, **seen):
    result = []
    for _ in range(num_trajectories):
        trajectory = recorder.begin_trajectory()
        for stage in range(1, num_stages + 1):
            result += until_it_is_taken(on_refusal, trajectory.begin_stage, {"x": stage, **seen}, action="PICK")
            result += until_it_is_taken(on_refusal, trajectory.complete_stage, 1.0, elapsed_s=float(stage))
        result += until_it_is_taken(on_refusal, trajectory.finish)
    return result


def check_all(folder, num_trajectories, num_stages):
    logs = read_logs(folder)
    assert logs.is_finished.tolist() == [True] * num_trajectories
    assert logs.stages["x"].tolist() == list(range(1, num_stages + 1)) * num_trajectories


@pytest.mark.parametrize(
    ("num_trajectories", "seed", "fewest_refused"), [(6, 1, 5), pytest.param(120, 2, 200, marks=pytest.mark.slow)]
)
def test_faults_of_writing_lose_nothing_that_was_taken(tmp_path, monkeypatch, num_trajectories, seed, fewest_refused):
    with LogRecorder(tmp_path, fsync="stage", part_bytes=1) as recorder:
        failing(monkeypatch, seed)
        result = record_all(recorder, num_trajectories, 2)
        assert read_logs(tmp_path).num_trajectories == num_trajectories
        monkeypatch.undo()
    check_all(tmp_path, num_trajectories, 2)
    assert len(result) > fewest_refused


def test_a_disk_that_is_full_for_a_while_loses_nothing_that_was_taken(tmp_path):
    with full() as make_room, LogRecorder(tmp_path, fsync="stage") as recorder:
        num_kept = []

        def on_refusal():
            num_kept.append(read_logs(tmp_path).num_stages)
            make_room()

        (message,) = record_all(recorder, 1, 40, on_refusal, seen="z" * 600)
    assert re.search(r"\((File too large|.*bytes were written)\); make room and give it again", message)
    assert 10 < num_kept[0] < 40
    check_all(tmp_path, 1, 40)


def test_nothing_is_recorded_into_a_journal_that_was_deleted(tmp_path):
    folder = tmp_path / "logs"
    with LogRecorder(folder) as recorder:
        record_trajectory(recorder, 0)
        # Whoever moves the folder keeps all of it.
        folder.rename(tmp_path / "kept")
        record_trajectory(recorder, 1)
        assert read_logs(tmp_path / "kept").num_trajectories == 2
        rmtree(tmp_path / "kept")
        with pytest.raises(LogError, match=r"journal.jsonl: it was deleted .* would be lost; open a new recorder"):
            record_trajectory(recorder, 2)
    with LogRecorder(folder) as recorder:
        record_trajectory(recorder, 0)
    assert read_logs(folder).num_trajectories == 1


def test_a_disk_that_stays_broken_leaves_what_was_taken(tmp_path, monkeypatch):
    recorder = LogRecorder(tmp_path)
    trajectory = recorder.begin_trajectory()
    trajectory.begin_stage({"x": 1.0}, action="PICK")
    failing(monkeypatch, 1, share=1.0)
    for call in (lambda: trajectory.complete_stage(1.0), recorder.close):
        with pytest.raises(LogError, match="cannot be written"):
            call()
    monkeypatch.undo()
    assert read_logs(tmp_path).trajectories["cause"].tolist() == ["crash"]
    with LogRecorder(tmp_path) as recorder:
        assert recorder.begin_trajectory().name == 2


FSYNCED = {"never": 0, "trajectory": 1, "stage": 4, "event": 7, True: 7, False: 0}


@pytest.mark.parametrize("fsync", FSYNCED)
def test_the_disk_is_waited_for_as_often_as_was_said(tmp_path, monkeypatch, fsync):
    synced = []
    monkeypatch.setattr(os, "fsync", lambda descriptor: synced.append(os.readlink(f"/proc/self/fd/{descriptor}")))
    folder = tmp_path / "a" / "b"
    with LogRecorder(folder, fsync=fsync) as recorder:
        at_first = list(synced)
        record_trajectory(recorder)
    assert len(synced) - len(at_first) == FSYNCED[fsync]
    places = [folder / JOURNAL, folder, tmp_path / "a", tmp_path]
    assert at_first == ([] if fsync in ("never", False) else [str(place) for place in places])


@pytest.mark.parametrize(("fsync", "num_synced"), [("event", 1), ("stage", 0)])
def test_the_disk_is_waited_for_when_a_trajectory_goes_on(tmp_path, monkeypatch, fsync, num_synced):
    with LogRecorder(tmp_path) as recorder:
        begin(recorder.begin_trajectory())
        recorder.close(None)
    with LogRecorder(tmp_path, fsync=fsync) as recorder:
        synced = []
        monkeypatch.setattr(os, "fsync", synced.append)
        recorder.resume()
        assert len(synced) == num_synced


# Lines that do not check, as after a loss of power.

NUM_TRAJECTORIES, LINES_A_TRAJECTORY = 6, 7
LINES_BEFORE = 2
"""The header and the session."""


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Lines of a journal of some finished trajectories."""
    folder = tmp_path_factory.mktemp("whole")
    with LogRecorder(folder) as recorder:
        for _ in range(NUM_TRAJECTORIES):
            record_trajectory(recorder)
    return (folder / JOURNAL).read_bytes().splitlines(keepends=True)


def intact(whole, content, num_above):
    """Trajectories whose lines, and some above them, are as they were; each line has a checksum of its own."""
    begins = [LINES_BEFORE + k * LINES_A_TRAJECTORY for k in range(NUM_TRAJECTORIES)]
    spans = (whole[begin - num_above : begin + LINES_A_TRAJECTORY] for begin in begins)
    return {trajectory for trajectory, span in enumerate(spans, start=1) if b"".join(span) in content}


def goes_on(folder, whole, content, *, num_above=2, warns=catch_warnings):
    """Read a harmed journal and go on with it: nothing is lost that was not harmed. None if it is none any more."""
    (folder / JOURNAL).write_bytes(content)
    with warns():
        logs = logs_or_none(folder, "all its lines fail their checksum")
    if logs is None:
        return None
    assert intact(whole, content, num_above) <= finished(logs)
    with warns(), LogRecorder(folder) as recorder:
        record_trajectory(recorder, 99)
    with warns():
        assert finished(read_logs(folder)) >= intact(whole, content, num_above) | {99}
        assert finished(read_logs(folder)) == finished(logs) | {99}
    return logs


@contextmanager
def quiet():
    """No warning of lines that do not check is an error."""
    with catch_warnings():
        simplefilter("ignore", HalfseenWarning)
        yield


@contextmanager
def warned():
    """Each reading tells of lines that do not check once, in one line."""
    with pytest.warns(HalfseenWarning, match="lines fail their checksum and are left out") as caught:
        yield
    assert all("\n" not in str(each.message) for each in caught)


@pytest.mark.parametrize("harm", ["flip", "drop", "double", "zeros"])
def test_one_bad_line_costs_at_most_the_trajectories_at_it(whole, tmp_path, harm):
    for line in (0, 1, 2, 4, 8, 15):
        bad = whole[line]
        put = {"flip": [bad.replace(b":", b";", 1)], "drop": [], "double": [bad, bad], "zeros": [bytes(len(bad))]}[harm]
        content = b"".join(whole[:line] + put + whole[line + 1 :])
        # Zeros swallow the line below them, and the one after that has nothing to go on from.
        assert goes_on(tmp_path, whole, content, num_above=2 if harm == "zeros" else 1, warns=warned) is not None


def test_a_trajectory_that_lines_are_missing_of_counts_as_cut_where_it_was_last_known(whole, tmp_path):
    # The beginning of stage 2 of trajectory 2, which lines of stages 2 and 3 follow.
    line = LINES_BEFORE + LINES_A_TRAJECTORY + 2
    (tmp_path / JOURNAL).write_bytes(b"".join([*whole[:line], *whole[line + 1 :]]))
    with pytest.warns(HalfseenWarning, match=rf"1 of {len(whole) - 1} lines .*\({line + 1}\)") as caught:
        logs = read_logs(tmp_path)
    assert len(caught) == 1
    second = logs.trajectories[logs.trajectories["trajectory"] == 2].iloc[0]
    assert (second["ending"], second["cause"], second["end_s"]) == ("cut", "crash", 0.99)
    assert (logs.stages["trajectory"] == 2).sum() == 1


@pytest.mark.parametrize("tail", [b"\0" * 4096, b"\0" * 50 + b"\n", b'["deadbeef",{"eve\0\0"}]\n', b'["dead\n\n'])
def test_a_recorder_goes_on_after_a_broken_end(whole, tmp_path, tail):
    logs = goes_on(tmp_path, whole, b"".join(whole) + tail, warns=warned if tail.endswith(b"\n") else nullcontext)
    assert finished(logs) == set(range(1, NUM_TRAJECTORIES + 1))


def test_a_file_of_zeros_is_begun_again(tmp_path):
    (tmp_path / JOURNAL).write_bytes(b"\0" * 4096)
    assert logs_or_none(tmp_path) is None
    with LogRecorder(tmp_path) as recorder:
        record_trajectory(recorder)
    assert finished(read_logs(tmp_path)) == {1}


@pytest.mark.parametrize(
    "body",
    ['{"event":"stage"}', '{"event":"stage","stage":1,"trajectory":1}', "[1]", "[" * 100_000, '{"event":["done"]}'],
)
def test_a_line_that_checks_and_tells_nonsense_is_no_traceback(whole, tmp_path, body):
    checksum = zlib.crc32(body.encode(), int(whole[-1][2:10], 16))
    (tmp_path / JOURNAL).write_bytes(b"".join(whole) + b'["%08x",%b]\n' % (checksum, body.encode()))
    for take in (read_logs, lambda folder: LogRecorder(folder).close()):
        with quiet():
            try:
                take(tmp_path)
            except LogError as error:
                assert "\n" not in str(error)  # noqa: PT017


def zeroed_pages(content, rng, page):
    """Zero some pages of a file, and perhaps tear its end."""
    content = bytearray(content)
    for _ in range(rng.randint(1, 3)):
        first = rng.randrange(0, len(content) // page + 1) * page
        content[first : first + page] = bytes(len(content[first : first + page]))
    return bytes(content[: rng.randint(len(content) // 2, len(content))]) if rng.random() < 0.3 else bytes(content)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("num_faults", "seed", "fewest_read"), [(12, 1, 4), pytest.param(200, 2, 80, marks=pytest.mark.slow)]
)
def test_zeroed_pages_cost_only_the_trajectories_at_them(whole, tmp_path, num_faults, seed, fewest_read):
    rng, content = random.Random(seed), b"".join(whole)
    harmed = (zeroed_pages(content, rng, rng.choice([64, 128, 512])) for _ in range(num_faults))
    assert sum(goes_on(tmp_path, whole, each, warns=quiet) is not None for each in harmed) > fewest_read
