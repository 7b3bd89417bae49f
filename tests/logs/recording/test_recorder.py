"""What a recorder writes is what is read, whatever happens in between."""

import json
import os
import signal
import time
from itertools import cycle

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from test_logs import assert_same
from valid_logs import small_tables, valid_tables

from halfseen.errors import ArgumentError, LogError
from halfseen.logs import LogRecorder, Logs, read_logs
from halfseen.logs.journal.parts import JOURNAL

# JAX warns of forks where other tests have loaded it; the children here do not touch it.
pytestmark = pytest.mark.filterwarnings("ignore:os.fork:RuntimeWarning")


class HandClock:
    """Stands in for `time.monotonic`, and moves when told."""

    def __init__(self):
        self.now_s = 1000.0

    def __call__(self):
        return self.now_s


@pytest.fixture
def clock(monkeypatch):
    clock = HandClock()
    monkeypatch.setattr("halfseen.logs.journal.clock.time.monotonic", clock)
    return clock


@pytest.fixture
def recorder(tmp_path):
    with LogRecorder(tmp_path / "logs") as recorder:
        yield recorder


def record(path, num_stages, clocks=None):
    """Complete some stages, with the number of the stage for a covariate and ten times that for a reward."""
    for stage in range(1, num_stages + 1):
        path.begin_stage({"x": float(stage)}, action="PICK")
        path.complete_stage(10.0 * stage, elapsed_s=None if clocks is None else clocks[stage - 1])


def record_tables(folder, stages, paths, objects):
    """Record what tables say, on their clocks."""
    stages = stages.astype({"object": object if stages["object"].dtype == object else "Int64"})
    with LogRecorder(folder) as recorder:
        for end in paths.itertuples():
            known = {
                name: getattr(end, name) for name in paths.columns.difference(["path", "end_s", "ending", "cause"])
            }
            path = recorder.begin_path(end.path, **known)
            for row in stages[stages["path"] == end.path].sort_values("stage").to_dict("records"):
                there = None
                if objects is not None:
                    is_there = (objects["path"] == end.path) & (objects["stage"] == row["stage"])
                    there = objects[is_there].drop(columns=["path", "stage"]).to_dict("records")
                choice = {name: row.pop(name) for name in ("action", "object", "probability") if name in row}
                choice = {name: value for name, value in choice.items() if not pd.isna(value)}
                _, _, elapsed_s, reward = (row.pop(name) for name in ("path", "stage", "elapsed_s", "reward"))
                path.begin_stage(row, there, **choice)
                if not pd.isna(elapsed_s):
                    path.complete_stage(reward, elapsed_s=elapsed_s)
            if end.ending == "finished":
                path.finish(elapsed_s=end.end_s)
            else:
                path.cut(end.cause, elapsed_s=end.end_s)


def assert_recorded(folder, tables):
    """Compare the logs of a recorder with those of the tables, whose narrower types it does not keep."""
    back, logs = read_logs(folder), Logs(**tables)
    for name in ("stages", "paths", "objects"):
        there, wanted = getattr(back, name), getattr(logs, name)
        if wanted is not None:
            pd.testing.assert_frame_equal(there[wanted.columns], wanted, check_dtype=False)
    return back


def test_any_table_comes_back_as_logs_would_hold_it(tmp_path):
    record_tables(tmp_path / "logs", **small_tables())
    back = assert_recorded(tmp_path / "logs", small_tables())
    back.write(tmp_path / "parquet")
    assert_same(read_logs(tmp_path / "parquet"), back)


@given(valid_tables())
def test_whatever_logs_take_a_recorder_takes(tmp_path_factory, tables):
    folder = tmp_path_factory.mktemp("logs")
    record_tables(folder, **tables)
    assert_recorded(folder, tables)


def test_on_its_own_clock_a_stage_lasts_until_the_next_begins(recorder, clock, tmp_path):
    path = recorder.begin_path()
    clock.now_s += 50.0
    path.begin_stage({"x": 0.0}, action="A")
    clock.now_s += 2.0
    path.complete_stage(1.0)
    clock.now_s += 0.5
    path.begin_stage({"x": 1.0}, action="A")
    clock.now_s += 3.0
    path.complete_stage(2.0)
    clock.now_s += 0.25
    path.finish()
    logs = read_logs(tmp_path / "logs")
    assert logs.elapsed_s().tolist() == [[2.5, 5.75]]
    assert logs.end_s.tolist() == [5.75]


def test_a_cut_between_stages_falls_into_the_stage_before(recorder, clock, tmp_path):
    path = recorder.begin_path()
    path.begin_stage({"x": 0.0}, action="A")
    clock.now_s += 2.0
    path.complete_stage(1.0)
    clock.now_s += 0.5
    path.cut("emergency-stop")
    logs = read_logs(tmp_path / "logs")
    assert logs.end_s.tolist() == [2.5]
    assert logs.stages["elapsed_s"].isna().tolist() == [True]
    assert logs.paths["cause"].tolist() == ["emergency-stop"]


def test_on_a_given_clock_a_cut_between_stages_stands_just_before_the_completion_that_it_takes_back(recorder, tmp_path):
    path = recorder.begin_path()
    record(path, 2, [1.0, 2.0])
    path.cut("battery", elapsed_s=2.5)
    logs = read_logs(tmp_path / "logs")
    assert logs.elapsed_s()[0, 0] == 1.0
    assert np.isnan(logs.elapsed_s()[0, 1])
    assert logs.end_s[0] == np.nextafter(2.0, 0.0)


def test_weights_of_tied_clocks_add_up_although_paths_end_between_stages(tmp_path):
    from halfseen.censoring import stage_weights

    rng = np.random.default_rng(3)
    with LogRecorder(tmp_path / "logs") as recorder:
        for _ in range(300):
            path = recorder.begin_path()
            for stage in (1, 2, 3):
                path.begin_stage({"x": 1.0}, action="A")
                path.complete_stage(1.0, elapsed_s=float(stage))
                if rng.random() < 0.2:
                    path.cut("operator")
                    break
            else:
                path.finish()
    logs = read_logs(tmp_path / "logs")
    weights = stage_weights(logs.elapsed_s(), logs.end_s, logs.is_finished)
    assert logs.cut_share > 0.3
    np.testing.assert_allclose(weights.mean(axis=0), 1.0, rtol=1e-12)


def test_a_path_in_progress_is_still_running_and_a_torn_one_crashed(recorder, clock, tmp_path):
    path = recorder.begin_path()
    record(path, 1)
    clock.now_s += 4.0
    path.begin_stage({"x": 2.0}, action="PICK")
    assert read_logs(tmp_path / "logs").paths["cause"].tolist() == ["still-running"]
    clock.now_s += 3.0
    path.still_running()
    path.still_running()
    recorder._journal.close()
    logs = read_logs(tmp_path / "logs")
    assert logs.paths[["end_s", "ending", "cause"]].values.tolist() == [[7.0, "cut", "crash"]]
    assert logs.elapsed_s()[0].tolist()[:1] == [4.0]
    assert (tmp_path / "logs" / JOURNAL).read_text().count("running") == 1


def test_a_path_torn_before_its_clock_moved_has_an_end(recorder, tmp_path):
    recorder.begin_path().begin_stage({"x": 2.0}, action="PICK")
    recorder._journal.close()
    logs = read_logs(tmp_path / "logs")
    assert logs.end_s.tolist() == [1e-9]


def test_a_folder_is_gone_on_with_after_a_crash(tmp_path):
    first = LogRecorder(tmp_path)
    record(first.begin_path(scene="a"), 3, [1.0, 2.0, 3.0])
    first._journal.close()
    with (tmp_path / JOURNAL).open("ab") as journal:
        journal.write(b'["0badf00d",{"event":"sta')
    with LogRecorder(tmp_path) as second:
        path = second.begin_path(weather="wet")
        assert path.name == 2
        record(path, 1, [1.5])
        path.finish()
        with pytest.raises(LogError, match="path 1: it is in the folder already"):
            second.begin_path(1)
        with pytest.raises(LogError, match="covariate x is missing"):
            second.begin_path().begin_stage({"y": 1.0}, action="PICK")
    logs = read_logs(tmp_path)
    assert logs.paths[["path", "ending"]].values.tolist() == [[1, "cut"], [2, "finished"]]
    assert logs.paths["cause"].iloc[0] == "crash"
    assert logs.paths["weather"].tolist() == [None, "wet"]


def test_two_recorders_of_one_process_are_refused(recorder, tmp_path):
    with pytest.raises(ArgumentError, match=r"another recorder.*there is nothing to remove after a crash"):
        LogRecorder(tmp_path / "logs")
    recorder.close()
    LogRecorder(tmp_path / "logs").close()


def test_a_fork_neither_records_nor_lets_the_lock_go(recorder, tmp_path):
    path = recorder.begin_path()
    child = os.fork()
    if child == 0:
        status = 1
        try:
            path.begin_stage({"x": 1.0}, action="A")
        except LogError as error:
            recorder.close()
            status = 0 if "is its fork" in str(error) else 2
        finally:
            os._exit(status)
    assert os.waitpid(child, 0)[1] == 0
    with pytest.raises(ArgumentError, match="another recorder"):
        LogRecorder(tmp_path / "logs")
    record(path, 1)


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
            recorder.begin_path().begin_stage({"x": 1.0}, action="A")
            raise error

    with pytest.raises(error):
        fail()
    assert read_logs(tmp_path).paths["cause"].tolist() == [cause]


def test_a_path_that_ends_before_its_first_stage_leaves_no_trace(recorder, tmp_path):
    recorder.begin_path().cut("operator")
    with pytest.raises(LogError, match="no stage is recorded yet"):
        read_logs(tmp_path / "logs")
    assert recorder.begin_path().name == 1


def begin(path, **seen):
    path.begin_stage(**({"covariates": {"x": 1.0}, "action": "A"} | seen))


STEPS = {
    "reward is nan": lambda path: (begin(path), path.complete_stage(float("nan"))),
    "reward is 'one'": lambda path: (begin(path), path.complete_stage("one")),
    "reward is None": lambda path: (begin(path), path.complete_stage(None)),
    "elapsed_s 0.5 is before the 1.0": lambda path: (begin(path), path.complete_stage(0.0, elapsed_s=0.5)),
    "elapsed_s 1.0 is still the 1.0": lambda path: (begin(path), path.complete_stage(0.0, elapsed_s=1.0)),
    "elapsed_s is inf": lambda path: (begin(path), path.complete_stage(0.0, elapsed_s=np.inf)),
    "elapsed_s is missing": lambda path: (begin(path), path.complete_stage(0.0)),
    "stage 1 is completed already": lambda path: path.complete_stage(0.0, elapsed_s=2.0),
    "stage 2: it is in progress": lambda path: (begin(path), begin(path)),
    "stage 2 is in progress; complete it before finish": lambda path: (begin(path), path.finish()),
    "it began without an action": lambda path: (begin(path, action=None), path.complete_stage(0.0, elapsed_s=2.0)),
    "object or probability is given without action": lambda path: begin(path, action=None, probability=0.5),
    "probability is given, unlike": lambda path: begin(path, probability=0.5),
    "covariate x is nan": lambda path: begin(path, covariates={"x": np.float32("nan")}),
    "covariate x is inf": lambda path: begin(path, covariates={"x": np.inf}),
    "covariate x is None": lambda path: begin(path, covariates={"x": None}),
    "covariate x is a text": lambda path: begin(path, covariates={"x": "far"}),
    "covariate x is no flat list": lambda path: begin(path, covariates={"x": np.zeros((2, 2))}),
    "covariate x is missing": lambda path: begin(path, covariates={}),
    "covariate y was not there": lambda path: begin(path, covariates={"x": 1.0, "y": 1.0}),
    "'reward' is a name of the log's own": lambda path: begin(path, covariates={"x": 1.0, "reward": 1.0}),
    "' Cause' is a name of the log's own": lambda path: begin(path, covariates={"x": 1.0, " Cause": 1.0}),
    "is a date or no seconds": lambda path: (begin(path), path.complete_stage(0.0, elapsed_s=1.7e9)),
    "covariates are a list": lambda path: begin(path, covariates=[1.0]),
    "it has objects, though": lambda path: begin(path, objects=[{"object": 1}]),
    "objects is empty": lambda path: begin(path, objects=[]),
    "action 1 is a number": lambda path: begin(path, action=1),
    "action True is no name": lambda path: begin(path, action=True),
    "as if units were mixed": lambda path: path.finish(elapsed_s=1000.0),
    "cause '' is no cause": lambda path: path.cut(""),
    "is no Unicode": lambda path: begin(path, action="\ud800"),
}


@pytest.mark.parametrize("trouble", STEPS)
def test_what_no_log_takes_is_refused_in_one_line_and_harms_nothing(recorder, tmp_path, trouble):
    path = recorder.begin_path()
    record(path, 1, [1.0])
    with pytest.raises(LogError, match=trouble) as told:
        STEPS[trouble](path)
    assert str(told.value).startswith("path 1")
    assert len(str(told.value).splitlines()) == 1
    if not path.is_in_stage:
        begin(path)
    path.cut("operator", elapsed_s=3.0)
    assert read_logs(tmp_path / "logs").elapsed_s()[0, 0] == 1.0


def test_objects_that_no_log_takes_are_refused(recorder, tmp_path):
    path = recorder.begin_path()
    cup = {"object": "cup", "occlusion": np.float32(0.5), "hidden_by": np.array([])}
    begin(path, objects=[cup], object="cup")
    path.complete_stage(1.0)
    for trouble, objects in {
        "object 'cup': it is there twice": [cup, cup],
        "has no name": [{"occlusion": 0.5}],
        "object 1 is a number, those before are text": [cup | {"object": 1}],
        "object 'cup': covariate occlusion is missing": [{"object": "cup"}],
        "it has no objects, though": None,
        "object 'cup' of the action is not among the objects of the stage": [cup | {"object": "mug"}],
        "hidden_by is a text": [cup | {"hidden_by": "mug"}],
    }.items():
        with pytest.raises(LogError, match=trouble):
            begin(path, objects=objects, object="cup")
    begin(path, objects=[cup | {"hidden_by": [0.5, 1]}], object="cup")
    path.complete_stage(1.0)
    with pytest.raises(LogError, match="hidden_by is a list of texts, before it was a list of numbers"):
        begin(path, objects=[cup | {"hidden_by": ["mug"]}], object="cup")
    path.finish()
    assert [entry.tolist() for entry in read_logs(tmp_path / "logs").objects["hidden_by"]] == [[], [0.5, 1.0]]


def test_paths_that_no_log_takes_are_refused(recorder):
    with pytest.raises(LogError, match="'Object' is a name of the log's own"):
        recorder.begin_path(Object="cup")
    path = recorder.begin_path("a")
    with pytest.raises(LogError, match="it has no stage"):
        path.finish()
    with pytest.raises(LogError, match="path 'a': it is in progress"):
        recorder.begin_path()
    record(path, 1)
    path.finish()
    with pytest.raises(LogError, match="path 'a': it has ended"):
        path.cut("operator")
    with pytest.raises(LogError, match="path 7 is a number, those before are text"):
        recorder.begin_path(7)
    assert recorder.begin_path().name == "2"
    recorder.close()
    with pytest.raises(LogError, match="the recorder is closed"):
        record(recorder.begin_path(), 1)


def test_a_journal_of_another_version_is_refused(tmp_path):
    from halfseen.logs.journal.lines import HEADER, journal_line

    (tmp_path / JOURNAL).write_bytes(journal_line(HEADER | {"version": 9}, 0)[0])
    with pytest.raises(LogError, match=r"line 1:.*read it with the halfseen that wrote it"):
        read_logs(tmp_path)


def test_every_torn_end_is_read(tmp_path):
    with LogRecorder(tmp_path / "whole") as recorder:
        for _ in range(2):
            path = recorder.begin_path()
            record(path, 2)
            path.finish()
    whole = (tmp_path / "whole" / JOURNAL).read_bytes()
    (tmp_path / "torn").mkdir()
    first = len(b"".join(whole.splitlines(keepends=True)[:3]))
    num_stages = []
    for size in range(first, len(whole), 7):
        (tmp_path / "torn" / JOURNAL).write_bytes(whole[:size])
        logs = read_logs(tmp_path / "torn")
        num_stages.append(logs.num_stages)
        assert set(logs.paths["cause"].dropna()) <= {"crash"}
    assert sorted(num_stages) == num_stages
    assert set(num_stages) == {1, 2, 3, 4}


def test_lines_are_json_that_other_programs_read(recorder, tmp_path):
    record(recorder.begin_path(), 1)
    events = [json.loads(line)[1]["event"] for line in (tmp_path / "logs" / JOURNAL).read_text().splitlines()]
    assert events == ["journal", "session", "stage", "done"]


def test_a_full_disk_is_told_and_loses_only_the_event(tmp_path):
    child = os.fork()
    if child == 0:
        import resource

        status = 1
        try:
            path = LogRecorder(tmp_path, fsync=True).begin_path()
            record(path, 1, [1.0])
            size = (tmp_path / JOURNAL).stat().st_size
            resource.setrlimit(resource.RLIMIT_FSIZE, (size + 40, resource.RLIM_INFINITY))
            try:
                begin(path)
            except LogError as error:
                status = 0 if "make room and give it again" in str(error) else 2
            resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
            begin(path)
        except BaseException:
            status = 3
        finally:
            os._exit(status)
    assert os.waitpid(child, 0)[1] == 0
    assert read_logs(tmp_path).stages["elapsed_s"].notna().tolist() == [True, False]


def test_ctrl_c_at_any_moment_leaves_a_journal_that_reads(tmp_path):
    class Pressed(BaseException):
        pass

    def press(*_):
        raise Pressed

    # However slow the machine is, some delays are shorter than a stage takes, and some longer.
    delays_s = cycle(np.geomspace(0.0005, 0.02, 23).tolist())
    interrupted, deadline = 0, time.monotonic() + 30.0
    before = signal.signal(signal.SIGALRM, press)
    try:
        with LogRecorder(tmp_path) as recorder:
            path = recorder.begin_path()
            while interrupted < 120 and time.monotonic() < deadline:
                try:
                    signal.setitimer(signal.ITIMER_REAL, next(delays_s))
                    # What presses while a callback runs goes nowhere.
                    while time.monotonic() < deadline:
                        if not path.is_in_stage:
                            begin(path)
                        path.complete_stage(1.0)
                except Pressed:
                    interrupted += 1
            signal.setitimer(signal.ITIMER_REAL, 0)
            path.cut("operator")
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    logs = read_logs(tmp_path)
    assert interrupted > 50
    assert logs.paths["cause"].tolist() == ["operator"]
    assert logs.num_stages > 50


def test_whole_numbers_and_fractions_may_mix_across_chunks(tmp_path, monkeypatch):
    monkeypatch.setattr("halfseen.logs.journal.tables.ROWS_A_CHUNK", 2)
    with LogRecorder(tmp_path) as recorder:
        for x in [1, 2, 2.5, 3]:
            path = recorder.begin_path(speed=x)
            path.begin_stage({"x": x, "seen": []} if x == 1 else {"x": x, "seen": [x]}, action=7)
            path.complete_stage(np.array(1))
            path.finish()
    logs = read_logs(tmp_path)
    assert logs.stages["x"].tolist() == logs.paths["speed"].tolist() == [1.0, 2.0, 2.5, 3.0]
    assert [len(seen) for seen in logs.stages["seen"]] == [0, 1, 1, 1]


def test_what_each_robot_brought_is_read_back_and_is_null_where_a_stage_was_cut(tmp_path):
    with LogRecorder(tmp_path / "logs") as recorder:
        path = recorder.begin_path()
        for stage in (1, 2):
            path.begin_stage({"x": 0.0}, action="PICK")
            path.complete_stage(3.0, elapsed_s=float(stage), own_rewards=[1.0, 2.0 * stage])
        path.begin_stage({"x": 0.0}, action="PICK")
        path.cut("operator", elapsed_s=2.5)
    with LogRecorder(tmp_path / "logs") as recorder:
        path = recorder.begin_path()
        path.begin_stage({"x": 0.0}, action="PICK")
        # It is told when it is given, and the stage may still be completed.
        with pytest.raises(LogError, match="own_rewards has 0 numbers, and the stages before it have 2"):
            path.complete_stage(3.0, elapsed_s=1.0)
        with pytest.raises(LogError, match="1_reward is nan"):
            path.complete_stage(3.0, elapsed_s=1.0, own_rewards=[1.0, float("nan")])
        path.complete_stage(3.0, elapsed_s=1.0, own_rewards=[1.0, 5.0])
        path.finish(elapsed_s=1.0)
    stages = read_logs(tmp_path / "logs").stages
    np.testing.assert_array_equal(stages["0_reward"], [1.0, 1.0, np.nan, 1.0])
    np.testing.assert_array_equal(stages["1_reward"], [2.0, 4.0, np.nan, 5.0])
