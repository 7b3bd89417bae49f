"""A journal that goes on in another file: the log is the same, and what holds of one file holds of several."""

import warnings

import pandas as pd
import pytest

from halfseen.errors import ArgumentError, HalfseenWarning, LogError
from halfseen.logs import LogRecorder, read_logs
from halfseen.logs.journal.parts import JOURNAL, journal_parts, part_after

NUM_PATHS = 12


def record(recorder, num_paths=NUM_PATHS):
    for number in range(num_paths):
        path = recorder.begin_path(scene=number)
        for stage in (1, 2):
            path.begin_stage({"x": path.name + stage / 10}, [{"object": 1, "y": 0.5}], "PICK", 1, 0.5)
            path.complete_stage(1.0, elapsed_s=float(stage))
        path.finish() if number % 3 else path.cut("operator")


def recorded(folder, part_bytes, num_paths=NUM_PATHS, **chosen):
    with LogRecorder(folder, part_bytes=part_bytes, **chosen) as recorder:
        record(recorder, num_paths)
    return folder


def check_same(logs, others):
    assert logs.tables.keys() == others.tables.keys()
    for name, table in logs.tables.items():
        pd.testing.assert_frame_equal(table, others.tables[name])


@pytest.mark.parametrize(("part_bytes", "num_parts"), [(1, NUM_PATHS + 1), (1500, 4), (10**6, 1)])
def test_the_log_is_that_of_one_file(tmp_path, part_bytes, num_parts):
    folder = recorded(tmp_path / "parts", part_bytes)
    assert len(journal_parts(folder)) == num_parts
    check_same(read_logs(folder), read_logs(recorded(tmp_path / "one", 10**9)))


def test_parts_come_in_the_order_of_their_numbers(tmp_path):
    names = ["journal.jsonl", "journal-2.jsonl", "journal-9.jsonl", "journal-10.jsonl"]
    for name in (*names, "journal-0.jsonl", "journal-1a.jsonl", "ajournal.jsonl"):
        (tmp_path / name).touch()
    (tmp_path / "journal-3.jsonl").mkdir()
    parts = journal_parts(tmp_path)
    assert [part.name for part in parts] == names
    assert [part_after(part).name for part in parts[:2]] == ["journal-2.jsonl", "journal-3.jsonl"]
    assert journal_parts(tmp_path / "none") == []


def test_a_path_stays_in_the_part_in_which_it_began(tmp_path):
    recorded(tmp_path, 1)
    for number, part in enumerate(journal_parts(tmp_path)[1:], 1):
        text = part.read_text()
        assert text.count('"event":"stage"') == 2
        assert f'"path":{number},' in text


def test_a_recorder_goes_on_in_the_last_part_and_knows_the_names_and_columns_of_all(tmp_path):
    recorded(tmp_path, 1, 3)
    with LogRecorder(tmp_path, part_bytes=10**6) as recorder:
        for name in (1, 2, 3):
            with pytest.raises(LogError, match="it is in the folder already"):
                recorder.begin_path(name)
        path = recorder.begin_path()
        with pytest.raises(LogError, match="x"):
            path.begin_stage({"z": 1.0}, [{"object": 1, "y": 0.5}], "PICK", 1, 0.5)
        path.cut("operator")
        record(recorder, 1)
    assert len(journal_parts(tmp_path)) == 4
    assert read_logs(tmp_path).path_ids.tolist() == [1, 2, 3, 4]


def test_nobody_else_records_whichever_part_is_written(tmp_path):
    with LogRecorder(tmp_path, part_bytes=1) as recorder:
        record(recorder, 3)
        with pytest.raises(ArgumentError, match="another recorder"):
            LogRecorder(tmp_path)
        recorder.begin_path().begin_stage({"x": 0.5}, [{"object": 1, "y": 0.5}], "PICK", 1, 0.5)
        assert read_logs(tmp_path).paths["cause"].tolist()[-1] == "still-running"
    with LogRecorder(tmp_path):
        pass


def test_a_torn_path_of_an_earlier_part_counts_as_a_crash(tmp_path):
    recorded(tmp_path, 1, 3)
    second = journal_parts(tmp_path)[1]
    second.write_bytes(b"".join(second.read_bytes().splitlines(keepends=True)[:4]))
    with LogRecorder(tmp_path):
        logs = read_logs(tmp_path)
    assert logs.paths["cause"].tolist() == ["crash", None, None]


def test_a_missing_part_is_told_and_parts_moved_away_are_not_missed(tmp_path):
    recorded(tmp_path, 1, 4)
    parts = journal_parts(tmp_path)
    parts[2].unlink()
    with pytest.warns(HalfseenWarning, match="the journal has no journal-3.jsonl"):
        logs = read_logs(tmp_path)
    assert logs.path_ids.tolist() == [1, 3, 4]
    with pytest.warns(HalfseenWarning, match="the journal has no journal-3.jsonl"):
        LogRecorder(tmp_path).close()
    for part in parts[:2]:
        part.unlink()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read_logs(tmp_path).path_ids.tolist() == [3, 4]
        with LogRecorder(tmp_path) as recorder:
            assert recorder.begin_path().name not in (3, 4)
        assert (tmp_path / JOURNAL).stat().st_size == 0
        assert read_logs(tmp_path).path_ids.tolist() == [3, 4]


def test_each_part_says_what_rewards_are_counted_in(tmp_path):
    recorded(tmp_path, 1, 2, reward_unit="parts")
    assert all('"reward_unit":"parts"' in part.read_text() for part in journal_parts(tmp_path))
    recorded(tmp_path, 1, 1)
    assert '"reward_unit":"parts"' in journal_parts(tmp_path)[-1].read_text()
    assert read_logs(tmp_path).reward_unit == "parts"
    with pytest.raises(LogError, match="rewards are in 'parts' and in 'cups'"):
        LogRecorder(tmp_path, reward_unit="cups")


def test_a_part_begins_whole_where_another_was_left_behind_in_its_place(tmp_path):
    with LogRecorder(tmp_path, part_bytes=1) as recorder:
        (tmp_path / "journal-2.jsonl").write_text("what Ctrl-C left")
        record(recorder, 1)
    assert read_logs(tmp_path).num_paths == 1


@pytest.mark.parametrize("part_bytes", [0, -1])
def test_a_size_that_is_none_is_refused(tmp_path, part_bytes):
    with pytest.raises(ArgumentError, match=r"part_bytes is .*; give a whole number of bytes"):
        LogRecorder(tmp_path / "logs", part_bytes=part_bytes)
    assert not (tmp_path / "logs").exists()
