"""What a recorder writes is what is read, in one file or several, of one robot or several."""

import json
import os
import warnings

import numpy as np
import pandas as pd
import pytest
from hypothesis import example, given
from recordings import THREE, begin, of_robot, record_path, step

from halfseen.censoring import stage_weights
from halfseen.errors import ArgumentError, HalfseenWarning, LogError
from halfseen.logs import LogRecorder, Logs, read_logs
from halfseen.logs.journal.parts import JOURNAL, PART_BYTES, journal_parts, part_after
from refusals import refused
from valid_logs import assert_same, small_tables, valid_tables

# JAX warns of forks where other tests have loaded it; the children here do not touch it.
pytestmark = pytest.mark.filterwarnings("ignore:os.fork:RuntimeWarning")

OF_THE_END, CHOICE = ("path", "end_s", "ending", "cause"), ("action", "object", "probability")
in_parts = pytest.mark.parametrize("part_bytes", [1, PART_BYTES], ids=["parts", "one file"])


def record_tables(folder, stages, paths, objects):
    """Record what tables say, on their clocks."""
    own = ("path", "stage", "elapsed_s", "reward")
    stages = stages.astype({"object": object if stages["object"].dtype == object else "Int64"})
    with LogRecorder(folder) as recorder:
        for end in paths.to_dict("records"):
            path = recorder.begin_path(end["path"], **{name: end[name] for name in end.keys() - set(OF_THE_END)})
            for row in stages[stages["path"] == end["path"]].sort_values("stage").to_dict("records"):
                there = None
                if objects is not None:
                    is_there = (objects["path"] == end["path"]) & (objects["stage"] == row["stage"])
                    there = objects[is_there].drop(columns=["path", "stage"]).to_dict("records")
                choice = {name: row[name] for name in CHOICE if name in row and not pd.isna(row[name])}
                seen = {name: value for name, value in row.items() if name not in (*own, *CHOICE)}
                path.begin_stage(seen, there, **choice)
                if not pd.isna(row["elapsed_s"]):
                    path.complete_stage(row["reward"], elapsed_s=row["elapsed_s"])
            if end["ending"] == "finished":
                path.finish(elapsed_s=end["end_s"])
            else:
                path.cut(end["cause"], elapsed_s=end["end_s"])


@given(valid_tables())
@example(small_tables())
def test_whatever_logs_take_a_recorder_takes(tmp_path_factory, tables):
    folder = tmp_path_factory.mktemp("logs") / "logs"
    record_tables(folder, **tables)
    back, logs = read_logs(folder), Logs(**tables)
    for name, wanted in logs.tables.items():  # whose narrower types a recorder does not keep
        pd.testing.assert_frame_equal(back.tables[name][wanted.columns], wanted, check_dtype=False)


# Clocks.


def done(path):
    path.complete_stage(1.0)


def finish(path):
    path.finish()


def completed(elapsed_s):
    return lambda path: step(path, elapsed_s)


def cut(cause, elapsed_s=None):
    return lambda path: path.cut(cause, elapsed_s=elapsed_s)


@pytest.mark.parametrize(
    ("events", "elapsed_s", "end_s", "cause"),
    [
        # A stage lasts until the next begins,
        ([50.0, begin, 2.0, done, 0.5, begin, 3.0, done, 0.25, finish], [2.5, 5.75], 5.75, None),
        # and a clock that falls back stands.
        ([begin, 0.5, done, 0.5, begin, -11.0, done, begin, 5.0, done, finish], [1.0, 1.0, 1.0], 1.0, None),
        # A cut falls into the stage before,
        ([begin, 2.0, done, 0.5, cut("e-stop")], [np.nan], 2.5, "e-stop"),
        # and takes its completion back.
        ([completed(1.0), completed(2.0), cut("battery", 2.5)], [1.0, np.nan], np.nextafter(2.0, 0.0), "battery"),
    ],
)
def test_stages_last_until_the_next_begins_or_the_path_ends(recorder, wait, tmp_path, events, elapsed_s, end_s, cause):
    path = recorder.begin_path()
    for event in events:
        event(path) if callable(event) else wait(event)
    logs = read_logs(tmp_path / "logs")
    assert logs.elapsed_s()[0] == pytest.approx(elapsed_s, rel=0.0, abs=1e-7, nan_ok=True)
    assert logs.stages["elapsed_s"].diff().dropna().gt(0.0).all()
    assert logs.end_s[0] == (end_s if cause else pytest.approx(end_s, abs=1e-7))
    assert logs.paths["cause"].tolist() == [cause]


def test_weights_of_tied_clocks_add_up_although_paths_end_between_stages(tmp_path):
    rng = np.random.default_rng(3)
    with LogRecorder(tmp_path) as recorder:
        for _ in range(100):
            path = recorder.begin_path()
            for stage in (1, 2, 3):
                step(path, float(stage))
                if rng.random() < 0.2:
                    path.cut("operator")
                    break
            else:
                path.finish()
    logs = read_logs(tmp_path)
    assert logs.cut_share > 0.3
    weights = stage_weights(logs.elapsed_s(), logs.end_s, logs.is_finished)
    np.testing.assert_allclose(weights.mean(axis=0), 1.0, rtol=1e-12)


def test_a_path_in_progress_is_still_running_and_a_torn_one_crashed(recorder, wait, tmp_path):
    path = recorder.begin_path()
    path.still_running()
    begin(path)
    assert read_logs(tmp_path / "logs").paths["cause"].tolist() == ["still-running"]
    path.complete_stage(1.0)
    wait(4.0)
    begin(path)
    wait(3.0)
    path.still_running()
    path.still_running()
    recorder._journal.close()
    logs = read_logs(tmp_path / "logs")
    assert logs.paths[["end_s", "ending", "cause"]].values.tolist() == [[7.0, "cut", "crash"]]
    assert logs.elapsed_s()[0].tolist()[:1] == [4.0]
    assert (tmp_path / "logs" / JOURNAL).read_text().count("running") == 1
    # Before its clock moved, a path has an end, too.
    other = LogRecorder(tmp_path / "other")
    begin(other.begin_path())
    other._journal.close()
    assert read_logs(tmp_path / "other").end_s.tolist() == [1e-9]


@pytest.mark.parametrize(("error", "cause"), [(KeyboardInterrupt, "operator"), (ZeroDivisionError, "crash")])
def test_leaving_by_an_error_cuts_the_path(tmp_path, error, cause):
    with pytest.raises(error), LogRecorder(tmp_path) as recorder:  # noqa: PT012
        begin(recorder.begin_path())
        raise error
    assert read_logs(tmp_path).paths["cause"].tolist() == [cause]


def test_what_each_robot_brought_is_read_back_and_is_null_where_a_stage_was_cut(tmp_path):
    with LogRecorder(tmp_path) as recorder:
        path = recorder.begin_path()
        for stage in (1, 2):
            begin(path)
            path.complete_stage(3.0, elapsed_s=float(stage), own_rewards=[1.0, 2.0 * stage])
        begin(path)
        path.cut("operator", elapsed_s=2.5)
    with LogRecorder(tmp_path) as recorder:
        path = recorder.begin_path()
        begin(path)
        # It is told when it is given, and the stage may still be completed.
        with pytest.raises(LogError, match="own_rewards has 0 numbers, and the stages before it have 2"):
            path.complete_stage(3.0, elapsed_s=1.0)
        with pytest.raises(LogError, match="1_reward is nan"):
            path.complete_stage(3.0, elapsed_s=1.0, own_rewards=[1.0, float("nan")])
        path.complete_stage(3.0, elapsed_s=1.0, own_rewards=[1.0, 5.0])
        path.finish(elapsed_s=1.0)
    stages = read_logs(tmp_path).stages
    np.testing.assert_array_equal(stages["0_reward"], [1.0, 1.0, np.nan, 1.0])
    np.testing.assert_array_equal(stages["1_reward"], [2.0, 4.0, np.nan, 5.0])


# One recorder after the other.


@in_parts
@pytest.mark.parametrize("given", [{}, THREE], ids=["one robot", "robots"])
def test_a_folder_is_gone_on_with_after_a_crash(tmp_path, part_bytes, given):
    first = LogRecorder(tmp_path, part_bytes=part_bytes, reward_unit="parts")
    record_path(first, given=given, scene="a")
    path = first.begin_path(scene="a")
    for stage in (1.0, 2.0, 3.0):
        step(path, stage, **given)
    first._journal.close()
    with journal_parts(tmp_path)[-1].open("ab") as journal:
        journal.write(b'["0badf00d",{"event":"sta')
    with LogRecorder(tmp_path, part_bytes=part_bytes) as second:
        path = second.begin_path(weather="wet")
        assert path.name == 3
        if given:
            with pytest.raises(LogError, match="path 3, stage 1: robot is missing, unlike in stages before"):
                begin(path, **given | {"robot": None})
        step(path, 1.5, **given)
        path.finish()
        for name in (1, 2, 3):
            with pytest.raises(LogError, match=f"path {name}: it is in the folder already"):
                second.begin_path(name)
        with pytest.raises(LogError, match="covariate x is missing"):
            begin(second.begin_path(), covariates={"y": 1.0}, **given)
    logs = read_logs(tmp_path)
    assert logs.paths[["path", "cause"]].values.tolist() == [[1, None], [2, "crash"], [3, None]]
    assert logs.paths["weather"].tolist() == [None, None, "wet"]
    assert logs.reward_unit == "parts"
    assert [part for part in journal_parts(tmp_path) if '"reward_unit":"parts"' not in part.read_text()] == []
    with pytest.raises(LogError, match="rewards are in 'parts' and in 'cups'"):
        LogRecorder(tmp_path, reward_unit="cups")


@in_parts
def test_one_recorder_at_a_time_and_a_fork_neither_records_nor_lets_the_lock_go(tmp_path, part_bytes):
    recorder = LogRecorder(tmp_path, part_bytes=part_bytes)
    for _ in range(2):
        record_path(recorder)
    path = recorder.begin_path()
    child = os.fork()
    if child == 0:
        status = 1
        try:
            begin(path)
        except LogError as error:
            recorder.close()
            status = 0 if "is its fork" in str(error) else 2
        finally:
            os._exit(status)
    assert os.waitpid(child, 0)[1] == 0
    with pytest.raises(ArgumentError, match=r"another recorder.*there is nothing to remove after a crash"):
        LogRecorder(tmp_path)
    step(path)
    recorder.close()
    LogRecorder(tmp_path).close()


def test_lines_are_json_that_other_programs_read_and_every_torn_end_is_read(tmp_path):
    with LogRecorder(tmp_path) as recorder:
        for _ in range(2):
            record_path(recorder, num_stages=2)
    whole = (tmp_path / JOURNAL).read_bytes()
    lines = whole.splitlines(keepends=True)
    events = [json.loads(line)[1]["event"] for line in lines]
    assert events == ["journal", "session", *(["stage", "done"] * 2 + ["finished"]) * 2]
    num_stages = []
    for size in range(sum(map(len, lines[:3])), len(whole), 29):
        (tmp_path / JOURNAL).write_bytes(whole[:size])
        logs = read_logs(tmp_path)
        num_stages.append(logs.num_stages)
        assert set(logs.paths["cause"].dropna()) <= {"crash"}
    assert sorted(num_stages) == num_stages
    assert set(num_stages) == {1, 2, 3, 4}


# A journal that goes on in another file.

NUM_PATHS = 12


def recorded(folder, part_bytes, num_paths=NUM_PATHS):
    with LogRecorder(folder, part_bytes=part_bytes) as recorder:
        for number in range(num_paths):
            cause = None if number % 3 else "operator"
            record_path(recorder, num_stages=2, cause=cause, given={"objects": [{"object": 1, "y": 0.5}]}, scene=number)
    return folder


@pytest.mark.parametrize(("part_bytes", "num_parts"), [(1, NUM_PATHS + 1), (1500, 4), (10**6, 1)])
def test_the_log_of_several_files_is_that_of_one(tmp_path, part_bytes, num_parts):
    parts = journal_parts(recorded(tmp_path / "parts", part_bytes))
    assert len(parts) == num_parts
    assert_same(read_logs(tmp_path / "parts"), read_logs(recorded(tmp_path / "one", 10**9)))
    # A path stays in the part in which it began.
    assert sum(part.read_text().count('"event":"stage"') % 2 for part in parts) == 0


def test_parts_come_in_the_order_of_their_numbers(tmp_path):
    names = ["journal.jsonl", "journal-2.jsonl", "journal-9.jsonl", "journal-10.jsonl"]
    for name in (*names, "journal-0.jsonl", "journal-1a.jsonl", "ajournal.jsonl"):
        (tmp_path / name).touch()
    (tmp_path / "journal-3.jsonl").mkdir()
    parts = journal_parts(tmp_path)
    assert [part.name for part in parts] == names
    assert [part_after(part).name for part in parts[:2]] == ["journal-2.jsonl", "journal-3.jsonl"]
    assert journal_parts(tmp_path / "none") == []


def test_a_torn_or_missing_part_is_told_and_parts_moved_away_are_not_missed(tmp_path):
    parts = journal_parts(recorded(tmp_path, 1, 4))
    parts[1].write_bytes(b"".join(parts[1].read_bytes().splitlines(keepends=True)[:4]))
    with LogRecorder(tmp_path):
        assert read_logs(tmp_path).paths["cause"].tolist() == ["crash", None, None, "operator"]
    parts[2].unlink()
    for take in (read_logs, lambda folder: LogRecorder(folder).close()):
        with pytest.warns(HalfseenWarning, match="the journal has no journal-3.jsonl"):
            take(tmp_path)
    for part in parts[:2]:
        part.unlink()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read_logs(tmp_path).path_ids.tolist() == [3, 4]
        with LogRecorder(tmp_path) as recorder:
            assert recorder.begin_path().name not in (3, 4)
        assert (tmp_path / JOURNAL).stat().st_size == 0
        assert read_logs(tmp_path).path_ids.tolist() == [3, 4]


def test_a_part_begins_whole_where_another_was_left_behind_in_its_place(tmp_path):
    with LogRecorder(tmp_path, part_bytes=1) as recorder:
        (tmp_path / "journal-2.jsonl").write_text("what Ctrl-C left")
        record_path(recorder)
    assert read_logs(tmp_path).num_paths == 1


# Several robots.


def do(path, robot, target, elapsed_s, reward=0.0):
    step(path, elapsed_s, reward, **THREE | {"robot": robot, "object": target})


def test_who_drops_out_is_gone_and_the_others_take_what_it_was_at(recorder, wait, tmp_path):
    path = recorder.begin_path()
    do(path, 0, 0, 1.0)
    of_robot(path, 1, 1)
    path.drop_out(np.int64(0), "battery", elapsed_s=1.5)
    path.complete_stage(0.0, elapsed_s=2.0)
    do(path, 1, 0, 3.0)
    path.finish()
    path = recorder.begin_path()
    of_robot(path, 0, 0)
    with refused(r"0_out_s 0\.0 lies outside the path", LogError):
        path.drop_out(0, "battery", elapsed_s=0.0)
    # On its own clock, too, a drop-out has its time.
    wait(2.0)
    path.drop_out(1, "e-stop")
    wait(1.0)
    path.complete_stage(1.0)
    path.finish()
    ends = read_logs(tmp_path / "logs").paths
    assert ends[["0_out_s", "0_out_cause"]].values.tolist()[0] == [1.5, "battery"]
    assert ends["0_out_s"].isna().tolist() == [False, True]
    assert ends[["1_out_s", "end_s"]].values.tolist()[1] == [2.0, pytest.approx(3.0)]


def test_a_cut_between_stages_takes_back_all_that_was_completed_just_then(recorder, tmp_path):
    path = recorder.begin_path()
    do(path, 0, 0, 1.0, reward=5.0)
    do(path, 1, 1, 2.0)
    do(path, 0, 2, 2.0)
    of_robot(path, 1)
    path.drop_out(0, "battery", elapsed_s=2.0)
    path.complete_stage(0.0, elapsed_s=2.0)
    path.cut("operator", elapsed_s=2.5)
    logs = read_logs(tmp_path / "logs")
    assert logs.end_s.tolist() == [np.nextafter(2.0, 0.0)]
    assert logs.stages["reward"].tolist()[:1] == [5.0]
    assert logs.stages["elapsed_s"].isna().tolist() == [False, True]
    assert logs.objects["stage"].max() == 2
    assert "0_out_s" not in logs.paths
