"""A disk that is full, fails or loses power: what was taken is kept, and the recorder says so and goes on."""

import errno
import os
import random
import re
import resource
import zlib
from contextlib import contextmanager, nullcontext, suppress
from warnings import catch_warnings, simplefilter

import numpy as np
import pytest
from recordings import finished, logs_or_none, record_path

from halfseen.errors import HalfseenWarning, LogError
from halfseen.logs import LogRecorder, read_logs
from halfseen.logs.journal.parts import JOURNAL


class FailingDisk:
    """Stands in for `os`: some calls write a part and fail, or fail altogether."""

    def __init__(self, rng, share):
        self._rng, self._share = rng, share
        self.is_broken = False

    def __getattr__(self, name):
        return getattr(os, name)

    def _fails(self):
        return self.is_broken or self._rng.random() < self._share

    def write(self, descriptor, line):
        if not self._fails():
            return os.write(descriptor, line)
        num_bytes = os.write(descriptor, line[: self._rng.randrange(len(line))])
        if self._rng.random() < 0.5:
            return num_bytes
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def fsync(self, descriptor):
        if self._fails():
            raise OSError(errno.EIO, os.strerror(errno.EIO))

    def ftruncate(self, descriptor, num_bytes):
        if self._fails():
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        os.ftruncate(descriptor, num_bytes)


def until_it_is_taken(call, *given, **named):
    """Give an event again until it is taken; returns how often it was refused."""
    num_refused = 0
    while True:
        try:
            call(*given, **named)
        except LogError as error:
            assert re.search("cannot be written .* give it again; all before it is kept", str(error))  # noqa: PT017
            num_refused += 1
        else:
            return num_refused


@pytest.mark.parametrize(
    ("num_paths", "seed", "fewest_refused"), [(6, 1, 5), pytest.param(120, 2, 200, marks=pytest.mark.slow)]
)
def test_faults_of_writing_lose_nothing_that_was_taken(tmp_path, monkeypatch, num_paths, seed, fewest_refused):
    disk = FailingDisk(random.Random(seed), 0.3)
    num_refused = 0
    with LogRecorder(tmp_path, fsync="stage", part_bytes=1) as recorder:
        monkeypatch.setattr("halfseen.logs.journal.writer.os", disk)
        monkeypatch.setattr("halfseen.logs.journal.durability.os", disk)
        for number in range(1, num_paths + 1):
            path = recorder.begin_path()
            for stage in (1, 2):
                num_refused += until_it_is_taken(path.begin_stage, {"x": stage}, action="PICK")
                num_refused += until_it_is_taken(path.complete_stage, 1.0, elapsed_s=float(stage))
            num_refused += until_it_is_taken(path.finish)
            assert read_logs(tmp_path).num_paths == number
        monkeypatch.undo()
    logs = read_logs(tmp_path)
    assert logs.is_finished.all()
    assert logs.stages["x"].tolist() == [1, 2] * num_paths
    assert num_refused > fewest_refused


@contextmanager
def files_may_have(num_bytes):
    """As a disk that is full; other processes have room."""
    hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
    resource.setrlimit(resource.RLIMIT_FSIZE, (num_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))


def test_a_disk_that_is_full_for_a_while_loses_nothing_that_was_taken(tmp_path):
    with LogRecorder(tmp_path, fsync="stage") as recorder:
        path, num_stages, told = recorder.begin_path(), 0, ""
        with files_may_have(20_000):
            while not told:
                try:
                    path.begin_stage({"x": num_stages, "seen": "z" * 600}, action="PICK")
                    num_stages += 1
                    path.complete_stage(1.0, elapsed_s=float(num_stages))
                except LogError as error:
                    told = str(error)
        assert re.search(r"\((File too large|.*bytes fitted)\); make room and give it again", told)
        assert num_stages > 10
        assert read_logs(tmp_path).num_stages == num_stages
        if not path.is_in_stage:
            path.begin_stage({"x": num_stages, "seen": ""}, action="PICK")
            num_stages += 1
        path.complete_stage(1.0, elapsed_s=float(num_stages))
        path.finish()
    logs = read_logs(tmp_path)
    assert logs.is_finished.all()
    assert logs.stages["x"].tolist() == list(range(num_stages))


def test_a_disk_that_stays_broken_leaves_what_was_taken(tmp_path, monkeypatch):
    disk, recorder = FailingDisk(random.Random(1), 0.0), LogRecorder(tmp_path)
    path = recorder.begin_path()
    path.begin_stage({"x": 1.0}, action="PICK")
    monkeypatch.setattr("halfseen.logs.journal.writer.os", disk)
    disk.is_broken = True
    with pytest.raises(LogError, match="cannot be written"):
        path.complete_stage(1.0)
    with pytest.raises(LogError, match="cannot be written"):
        recorder.close()
    monkeypatch.undo()
    assert read_logs(tmp_path).paths["cause"].tolist() == ["crash"]
    with LogRecorder(tmp_path) as recorder:
        assert recorder.begin_path().name == 2


# Lines that do not check, as after a loss of power.

NUM_PATHS, NUM_STAGES, LINES_A_PATH = 6, 3, 7
LINES_BEFORE = 2
"""The header and the session."""


@pytest.fixture
def whole(tmp_path):
    """Lines of a journal of some finished paths."""
    with LogRecorder(tmp_path / "whole") as recorder:
        for _ in range(NUM_PATHS):
            record_path(recorder)
    return (tmp_path / "whole" / JOURNAL).read_bytes().splitlines(keepends=True)


@contextmanager
def quiet():
    """No warning of lines that do not check is an error."""
    with catch_warnings():
        simplefilter("ignore", HalfseenWarning)
        yield


def harmed_folder(folder, content):
    folder.mkdir(exist_ok=True)
    (folder / JOURNAL).write_bytes(content)
    return folder


def path_of(line):
    """Name of the path that a line of the whole journal is of, all counted from 1."""
    return (line - LINES_BEFORE - 1) // LINES_A_PATH + 1


@pytest.mark.parametrize("line", [1, 2, 3, 5, 9, 16])
@pytest.mark.parametrize("harm", ["flip", "drop", "double", "zeros"])
def test_one_bad_line_costs_at_most_the_paths_at_it(whole, tmp_path, line, harm):
    bad = whole[line - 1]
    put = {"flip": [bad.replace(b":", b";", 1)], "drop": [], "double": [bad, bad], "zeros": [bytes(len(bad))]}[harm]
    folder = harmed_folder(tmp_path / "harmed", b"".join(whole[: line - 1] + put + whole[line:]))
    with pytest.warns(HalfseenWarning, match=r"lines do not check and are left out") as told:
        logs = read_logs(folder)
    assert len(told) == 1
    assert len(str(told[0].message).splitlines()) == 1
    # Zeros swallow the line below them, and the one after that has nothing to go on from.
    hit = {path_of(each) for each in range(line, line + {"zeros": 3}.get(harm, 2))}
    assert set(range(1, NUM_PATHS + 1)) - hit <= finished(logs)
    with pytest.warns(HalfseenWarning), LogRecorder(folder) as recorder:
        record_path(recorder, 99)
    with pytest.warns(HalfseenWarning):
        assert finished(read_logs(folder)) == finished(logs) | {99}


def test_a_path_that_lines_are_missing_of_counts_as_cut_where_it_was_last_known(whole, tmp_path):
    # The beginning of stage 2 of path 2, which lines of stages 2 and 3 follow.
    line = LINES_BEFORE + LINES_A_PATH + 3
    folder = harmed_folder(tmp_path / "harmed", b"".join([*whole[: line - 1], *whole[line:]]))
    with pytest.warns(HalfseenWarning, match=rf"1 of {len(whole) - 1} lines .*\({line}\)"):
        logs = read_logs(folder)
    second = logs.paths[logs.paths["path"] == 2].iloc[0]
    assert (second["ending"], second["cause"], second["end_s"]) == ("cut", "crash", np.nextafter(1.0, 0.0))
    assert (logs.stages["path"] == 2).sum() == 1


@pytest.mark.parametrize("tail", [b"\0" * 4096, b"\0" * 50 + b"\n", b'["deadbeef",{"eve\0\0"}]\n', b'["dead\n\n'])
def test_a_recorder_goes_on_after_a_broken_end(whole, tmp_path, tail):
    folder = harmed_folder(tmp_path / "harmed", b"".join(whole) + tail)
    is_whole_line = tail.endswith(b"\n")
    with pytest.warns(HalfseenWarning) if is_whole_line else nullcontext(), LogRecorder(folder) as recorder:
        record_path(recorder)
    with pytest.warns(HalfseenWarning) if is_whole_line else nullcontext():
        logs = read_logs(folder)
    assert finished(logs) == set(range(1, NUM_PATHS + 2))


def test_a_file_of_zeros_is_begun_anew(tmp_path):
    folder = harmed_folder(tmp_path / "zeros", b"\0" * 4096)
    assert logs_or_none(folder) is None
    with LogRecorder(folder) as recorder:
        record_path(recorder)
    assert finished(read_logs(folder)) == {1}


@pytest.mark.parametrize(
    "body", ['{"event":"stage"}', '{"event":"stage","stage":1,"path":1}', "[1]", "[" * 100_000, '{"event":["done"]}']
)
def test_a_line_that_checks_and_tells_nonsense_is_no_traceback(whole, tmp_path, body):
    checksum = zlib.crc32(body.encode(), int(whole[-1][2:10], 16))
    folder = harmed_folder(tmp_path / "odd", b"".join(whole) + b'["%08x",%b]\n' % (checksum, body.encode()))
    for take in (read_logs, lambda folder: LogRecorder(folder).close()):
        with quiet(), suppress(LogError):
            take(folder)


def zeroed_pages(content, rng, page):
    """Zero some pages of a file, and perhaps tear its end."""
    content = bytearray(content)
    for _ in range(rng.randint(1, 3)):
        first = rng.randrange(0, len(content) // page + 1) * page
        content[first : first + page] = bytes(len(content[first : first + page]))
    return bytes(content[: rng.randint(len(content) // 2, len(content))]) if rng.random() < 0.3 else bytes(content)


def intact_paths(content, harmed):
    """Paths whose lines, and the two lines above them, are as they were."""
    begins = [0]
    for line in content.splitlines(keepends=True):
        begins.append(begins[-1] + len(line))
    intact = set()
    for path in range(1, NUM_PATHS + 1):
        first = LINES_BEFORE + (path - 1) * LINES_A_PATH
        span = slice(begins[first - 2], begins[first + LINES_A_PATH])
        if content[span] == harmed[span]:
            intact.add(path)
    return intact


@pytest.mark.parametrize(
    ("num_faults", "seed", "fewest_read"), [(12, 1, 4), pytest.param(500, 2, 200, marks=pytest.mark.slow)]
)
def test_zeroed_pages_cost_only_the_paths_at_them(whole, tmp_path, num_faults, seed, fewest_read):
    rng, content = random.Random(seed), b"".join(whole)
    num_read = 0
    for fault in range(num_faults):
        harmed = harmed_folder(tmp_path / str(fault), zeroed_pages(content, rng, rng.choice([64, 128, 512])))
        intact = intact_paths(content, (harmed / JOURNAL).read_bytes())
        with quiet():
            logs = logs_or_none(harmed, "none of its lines checks")
            if logs is None:
                continue
            assert intact <= finished(logs)
            with LogRecorder(harmed) as recorder:
                record_path(recorder, 99)
            assert intact | {99} <= finished(read_logs(harmed))
        num_read += 1
    assert num_read > fewest_read


FSYNCED = {"never": 0, "path": 1, "stage": NUM_STAGES + 1, "event": LINES_A_PATH}


@pytest.mark.parametrize("fsync", [*FSYNCED, True, False])
def test_the_disk_is_waited_for_as_often_as_was_said(tmp_path, monkeypatch, fsync):
    synced = []

    def note(descriptor):
        synced.append(os.readlink(f"/proc/self/fd/{descriptor}"))

    monkeypatch.setattr(os, "fsync", note)
    with LogRecorder(tmp_path / "a" / "b", fsync=fsync) as recorder:
        at_first = list(synced)
        synced.clear()
        record_path(recorder)
    name = {True: "event", False: "never"}.get(fsync, fsync)
    assert len(synced) == FSYNCED[name]
    journal = str(tmp_path / "a" / "b" / JOURNAL)
    folders = [str(tmp_path / "a" / "b"), str(tmp_path / "a"), str(tmp_path)]
    assert at_first == ([] if name == "never" else [journal, *folders])
