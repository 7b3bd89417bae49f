"""What a recorder writes is what is read, whatever happens in between."""

import json
import os
import time
from itertools import chain, repeat

import numpy as np
import pandas as pd
import pytest
from hypothesis import example, given
from recordings import begin, record_path, step
from test_logs import assert_same
from valid_logs import small_tables, valid_tables

from halfseen.errors import ArgumentError, LogError
from halfseen.logs import LogRecorder, Logs, read_logs
from halfseen.logs.journal.parts import JOURNAL

# JAX warns of forks where other tests have loaded it; the children here do not touch it.
pytestmark = pytest.mark.filterwarnings("ignore:os.fork:RuntimeWarning")

OF_THE_END = ["path", "end_s", "ending", "cause"]


@pytest.fixture
def recorder(tmp_path):
    with LogRecorder(tmp_path / "logs") as recorder:
        yield recorder


@pytest.fixture
def wait(monkeypatch):
    """Moves the recorder's own clock."""
    now_s = [1000.0]
    monkeypatch.setattr("halfseen.logs.journal.clock.time.monotonic", lambda: now_s[0])
    return lambda seconds: now_s.append(now_s.pop() + seconds)


def record_tables(folder, stages, paths, objects):
    """Record what tables say, on their clocks."""
    stages = stages.astype({"object": object if stages["object"].dtype == object else "Int64"})
    with LogRecorder(folder) as recorder:
        for end in paths.to_dict("records"):
            path = recorder.begin_path(end["path"], **{name: end[name] for name in end.keys() - set(OF_THE_END)})
            for row in stages[stages["path"] == end["path"]].sort_values("stage").to_dict("records"):
                there = None
                if objects is not None:
                    is_there = (objects["path"] == end["path"]) & (objects["stage"] == row["stage"])
                    there = objects[is_there].drop(columns=["path", "stage"]).to_dict("records")
                choice = {name: row.pop(name) for name in ("action", "object", "probability") if name in row}
                choice = {name: value for name, value in choice.items() if not pd.isna(value)}
                _, _, elapsed_s, reward = (row.pop(name) for name in ("path", "stage", "elapsed_s", "reward"))
                path.begin_stage(row, there, **choice)
                if not pd.isna(elapsed_s):
                    path.complete_stage(reward, elapsed_s=elapsed_s)
            if end["ending"] == "finished":
                path.finish(elapsed_s=end["end_s"])
            else:
                path.cut(end["cause"], elapsed_s=end["end_s"])


@given(valid_tables())
@example(small_tables())
def test_whatever_logs_take_a_recorder_takes(tmp_path_factory, tables):
    folder = tmp_path_factory.mktemp("logs")
    record_tables(folder / "logs", **tables)
    back, logs = read_logs(folder / "logs"), Logs(**tables)
    for name, wanted in logs.tables.items():  # whose narrower types a recorder does not keep
        pd.testing.assert_frame_equal(back.tables[name][wanted.columns], wanted, check_dtype=False)
    back.write(folder / "parquet")
    assert_same(read_logs(folder / "parquet"), back)


def own_clock(path, wait):
    wait(50.0)
    begin(path)
    wait(2.0)
    path.complete_stage(1.0)
    wait(0.5)
    begin(path)
    wait(3.0)
    path.complete_stage(2.0)
    wait(0.25)
    path.finish()


def cut_between_stages(path, wait):
    begin(path)
    wait(2.0)
    path.complete_stage(1.0)
    wait(0.5)
    path.cut("emergency-stop")


def cut_on_a_given_clock(path, wait):
    step(path, 1.0)
    step(path, 2.0)
    path.cut("battery", elapsed_s=2.5)


@pytest.mark.parametrize(
    ("happens", "elapsed_s", "end_s", "cause"),
    [
        (own_clock, [2.5, 5.75], 5.75, None),  # a stage lasts until the next begins
        (cut_between_stages, [np.nan], 2.5, "emergency-stop"),  # a cut falls into the stage before
        (cut_on_a_given_clock, [1.0, np.nan], np.nextafter(2.0, 0.0), "battery"),  # and takes its completion back
    ],
)
def test_stages_last_until_the_next_begins_or_the_path_ends(recorder, wait, tmp_path, happens, elapsed_s, end_s, cause):
    happens(recorder.begin_path(), wait)
    logs = read_logs(tmp_path / "logs")
    np.testing.assert_array_equal(logs.elapsed_s(), [elapsed_s])
    assert (logs.end_s.tolist(), logs.paths["cause"].tolist()) == ([end_s], [cause])


def test_weights_of_tied_clocks_add_up_although_paths_end_between_stages(tmp_path):
    from halfseen.censoring import stage_weights

    rng = np.random.default_rng(3)
    with LogRecorder(tmp_path / "logs") as recorder:
        for _ in range(300):
            path = recorder.begin_path()
            for stage in (1, 2, 3):
                step(path, float(stage))
                if rng.random() < 0.2:
                    path.cut("operator")
                    break
            else:
                path.finish()
    logs = read_logs(tmp_path / "logs")
    weights = stage_weights(logs.elapsed_s(), logs.end_s, logs.is_finished)
    assert logs.cut_share > 0.3
    np.testing.assert_allclose(weights.mean(axis=0), 1.0, rtol=1e-12)


def test_a_path_in_progress_is_still_running_and_a_torn_one_crashed(recorder, wait, tmp_path):
    path = recorder.begin_path()
    step(path)
    wait(4.0)
    begin(path)
    assert read_logs(tmp_path / "logs").paths["cause"].tolist() == ["still-running"]
    wait(3.0)
    path.still_running()
    path.still_running()
    recorder._journal.close()
    logs = read_logs(tmp_path / "logs")
    assert logs.paths[["end_s", "ending", "cause"]].values.tolist() == [[7.0, "cut", "crash"]]
    assert logs.elapsed_s()[0].tolist()[:1] == [4.0]
    assert (tmp_path / "logs" / JOURNAL).read_text().count("running") == 1


def test_a_path_torn_before_its_clock_moved_has_an_end(recorder, tmp_path):
    begin(recorder.begin_path())
    recorder._journal.close()
    assert read_logs(tmp_path / "logs").end_s.tolist() == [1e-9]


class JumpingClock:
    """Stands in for `time`: each reading is the next of a list and then its last."""

    def __init__(self, readings_s):
        self._readings_s = chain(readings_s, repeat(readings_s[-1]))

    def __getattr__(self, name):
        return {"time": self.fail, "time_ns": self.fail}.get(name) or getattr(time, name)

    def fail(self):
        pytest.fail("the time of day was read")

    def monotonic(self):
        return next(self._readings_s)


@pytest.mark.parametrize("readings_s", [[100.5, 101.0, 101.5, 102.0, 102.5, 103.0], [100.5, 101.0, 90.0, 90.0, 95.0]])
def test_a_clock_that_falls_back_leaves_stages_in_order_and_no_time_of_day_is_read(tmp_path, monkeypatch, readings_s):
    monkeypatch.setattr("halfseen.logs.journal.clock.time", JumpingClock([100.0, *readings_s]))
    with LogRecorder(tmp_path) as recorder:
        path = recorder.begin_path()
        for _ in range(3):
            step(path)
        path.finish()
    logs = read_logs(tmp_path)
    falls = 90.0 in readings_s
    np.testing.assert_allclose(logs.end_s, 1.0 if falls else 3.0, atol=1e-6 if falls else 0.0)
    assert logs.stages["elapsed_s"].diff().dropna().gt(0.0).all()
    assert falls or logs.stages["elapsed_s"].tolist() == [1.0, 2.0, 3.0]


def test_a_folder_is_gone_on_with_after_a_crash(tmp_path):
    first = LogRecorder(tmp_path)
    path = first.begin_path(scene="a")
    for stage in (1.0, 2.0, 3.0):
        step(path, stage)
    first._journal.close()
    with (tmp_path / JOURNAL).open("ab") as journal:
        journal.write(b'["0badf00d",{"event":"sta')
    with LogRecorder(tmp_path) as second:
        path = second.begin_path(weather="wet")
        assert path.name == 2
        step(path, 1.5)
        path.finish()
        with pytest.raises(LogError, match="path 1: it is in the folder already"):
            second.begin_path(1)
        with pytest.raises(LogError, match="covariate x is missing"):
            begin(second.begin_path(), covariates={"y": 1.0})
    paths = read_logs(tmp_path).paths
    assert paths[["path", "ending"]].values.tolist() == [[1, "cut"], [2, "finished"]]
    assert paths["cause"].tolist() == ["crash", None]
    assert paths["weather"].tolist() == [None, "wet"]


def test_one_recorder_at_a_time_and_a_fork_neither_records_nor_lets_the_lock_go(recorder, tmp_path):
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
        LogRecorder(tmp_path / "logs")
    step(path)
    recorder.close()
    LogRecorder(tmp_path / "logs").close()


def test_finished_logs_are_not_recorded_over(tmp_path):
    Logs(**small_tables()).write(tmp_path / "logs")
    with pytest.raises(ArgumentError, match="record into another folder"):
        LogRecorder(tmp_path / "logs")
    (tmp_path / "file").touch()
    with pytest.raises(ArgumentError, match="cannot be written"):
        LogRecorder(tmp_path / "file")


@pytest.mark.parametrize(("error", "cause"), [(KeyboardInterrupt, "operator"), (ZeroDivisionError, "crash")])
def test_leaving_by_an_error_cuts_the_path(tmp_path, error, cause):
    def fail():
        with LogRecorder(tmp_path) as recorder:
            begin(recorder.begin_path())
            raise error

    with pytest.raises(error):
        fail()
    assert read_logs(tmp_path).paths["cause"].tolist() == [cause]


def test_a_path_that_ends_before_its_first_stage_leaves_no_trace(recorder, tmp_path):
    recorder.begin_path().cut("operator")
    with pytest.raises(LogError, match="no stage is recorded yet"):
        read_logs(tmp_path / "logs")
    assert recorder.begin_path().name == 1


def test_a_journal_of_another_version_is_refused(tmp_path):
    from halfseen.logs.journal.lines import HEADER, journal_line

    (tmp_path / JOURNAL).write_bytes(journal_line(HEADER | {"version": 9}, 0)[0])
    with pytest.raises(LogError, match=r"line 1:.*read it with the halfseen that wrote it"):
        read_logs(tmp_path)


def test_lines_are_json_that_other_programs_read_and_every_torn_end_is_read(tmp_path):
    with LogRecorder(tmp_path) as recorder:
        for _ in range(2):
            record_path(recorder, num_stages=2)
    whole = (tmp_path / JOURNAL).read_bytes()
    lines = whole.splitlines(keepends=True)
    events = [json.loads(line)[1]["event"] for line in lines]
    assert events == ["journal", "session", *(["stage", "done"] * 2 + ["finished"]) * 2]
    num_stages = []
    for size in range(sum(map(len, lines[:3])), len(whole), 7):
        (tmp_path / JOURNAL).write_bytes(whole[:size])
        logs = read_logs(tmp_path)
        num_stages.append(logs.num_stages)
        assert set(logs.paths["cause"].dropna()) <= {"crash"}
    assert sorted(num_stages) == num_stages
    assert set(num_stages) == {1, 2, 3, 4}


def test_whole_numbers_and_fractions_may_mix_across_chunks(tmp_path, monkeypatch):
    monkeypatch.setattr("halfseen.logs.journal.tables.ROWS_A_CHUNK", 2)
    with LogRecorder(tmp_path) as recorder:
        for x in [1, 2, 2.5, 3]:
            path = recorder.begin_path(speed=x)
            step(path, reward=np.array(1), covariates={"x": x, "seen": [] if x == 1 else [x]}, action=7)
            path.finish()
    logs = read_logs(tmp_path)
    assert logs.stages["x"].tolist() == logs.paths["speed"].tolist() == [1.0, 2.0, 2.5, 3.0]
    assert [len(seen) for seen in logs.stages["seen"]] == [0, 1, 1, 1]


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
