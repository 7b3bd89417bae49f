"""Lines that do not check, as after a loss of power: all others are kept, by the reader and by the recorder."""

import os
import random
import warnings
import zlib
from contextlib import contextmanager, nullcontext, suppress

import numpy as np
import pytest
from recordings import finished, logs_or_none, record_path

from halfseen.errors import ArgumentError, HalfseenWarning, LogError
from halfseen.logs import LogRecorder, read_logs
from halfseen.logs.journal.parts import JOURNAL

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
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", HalfseenWarning)
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
    with pytest.raises(LogError, match="no stage is recorded yet"):
        read_logs(folder)
    with LogRecorder(folder) as recorder:
        record_path(recorder)
    assert finished(read_logs(folder)) == {1}


def test_what_is_no_journal_is_left_alone(tmp_path):
    folder = harmed_folder(tmp_path / "notes", b"milk\neggs\n")
    with pytest.raises(LogError, match="none of its lines checks"):
        read_logs(folder)
    with pytest.raises(LogError, match="none of its lines checks"):
        LogRecorder(folder)
    assert (folder / JOURNAL).read_bytes() == b"milk\neggs\n"


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


def test_another_word_for_when_to_wait_is_refused(tmp_path):
    with pytest.raises(ArgumentError, match=r"fsync is 'often'; give one of 'never', 'path', 'stage', 'event'"):
        LogRecorder(tmp_path / "logs", fsync="often")
    assert not (tmp_path / "logs").exists()
