"""What a recorder writes is what is read, in one file or several, of one robot or several."""

import json
import os
import warnings

import numpy as np
import pandas as pd
import pytest
from hypothesis import example, given
from recordings import THREE, begin, of_robot, record_trajectory, step

from halfseen.censoring import stage_weights
from halfseen.errors import ArgumentError, HalfseenWarning, LogError
from halfseen.logs import LogRecorder, Logs, read_logs
from halfseen.logs.journal import JOURNAL, PART_BYTES, journal_parts
from halfseen.logs.recorded import followed
from refusals import refused
from valid_logs import assert_same, small_tables, valid_tables

# JAX warns of forks where other tests have loaded it; the children here do not touch it.
pytestmark = pytest.mark.filterwarnings("ignore:os.fork:RuntimeWarning")

OF_THE_END, CHOICE = ("trajectory", "end_s", "ending", "cause"), ("action", "object", "probability")
in_parts = pytest.mark.parametrize("part_bytes", [1, PART_BYTES], ids=["parts", "one file"])


def record_tables(folder, stages, trajectories, objects):
    """Record what tables say, on their clocks."""
    own = ("trajectory", "stage", "elapsed_s", "reward")
    stages = stages.astype({"object": object if stages["object"].dtype == object else "Int64"})
    by_stage = [] if objects is None else objects.groupby(["trajectory", "stage"])
    seen_then = {at: rows.drop(columns=["trajectory", "stage"]).to_dict("records") for at, rows in by_stage}
    with LogRecorder(folder) as recorder:
        for end in trajectories.to_dict("records"):
            trajectory = recorder.begin_trajectory(
                end["trajectory"], **{name: end[name] for name in end.keys() - set(OF_THE_END)}
            )
            for row in stages[stages["trajectory"] == end["trajectory"]].sort_values("stage").to_dict("records"):
                there = seen_then.get((end["trajectory"], row["stage"]))
                choice = {name: row[name] for name in CHOICE if name in row and not pd.isna(row[name])}
                seen = {name: value for name, value in row.items() if name not in (*own, *CHOICE)}
                trajectory.begin_stage(seen, there, **choice)
                if not pd.isna(row["elapsed_s"]):
                    trajectory.complete_stage(row["reward"], elapsed_s=row["elapsed_s"])
            if end["ending"] == "finished":
                trajectory.finish(elapsed_s=end["end_s"])
            else:
                trajectory.cut(end["cause"], elapsed_s=end["end_s"])


@pytest.mark.slow
@given(valid_tables())
@example(small_tables())
def test_whatever_logs_take_a_recorder_takes(tmp_path_factory, tables):
    folder = tmp_path_factory.mktemp("logs") / "logs"
    record_tables(folder, **tables)
    back, logs = read_logs(folder), Logs(**tables)
    for name, wanted in logs.tables.items():  # whose narrower types a recorder does not keep
        pd.testing.assert_frame_equal(back.tables[name][wanted.columns], wanted, check_dtype=False)


# Clocks.


def done(trajectory):
    trajectory.complete_stage(1.0)


def finish(trajectory):
    trajectory.finish()


def completed(elapsed_s):
    return lambda trajectory: step(trajectory, elapsed_s)


def cut(cause, elapsed_s=None):
    return lambda trajectory: trajectory.cut(cause, elapsed_s=elapsed_s)


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
        ([completed(1.0), completed(2.0), cut("battery", 2.5)], [1.0, np.nan], 1.99, "battery"),
    ],
)
def test_stages_last_until_the_next_begins_or_the_trajectory_ends(
    recorder, wait, tmp_path, events, elapsed_s, end_s, cause
):
    trajectory = recorder.begin_trajectory()
    for event in events:
        event(trajectory) if callable(event) else wait(event)
    logs = read_logs(tmp_path / "logs")
    assert logs.elapsed_s()[0] == pytest.approx(elapsed_s, rel=0.0, abs=1e-7, nan_ok=True)
    assert logs.stages["elapsed_s"].diff().dropna().gt(0.0).all()
    assert logs.end_s[0] == (end_s if cause else pytest.approx(end_s, abs=1e-7))
    assert logs.trajectories["cause"].tolist() == [cause]


def test_weights_of_tied_clocks_add_up_although_trajectories_end_between_stages(tmp_path):
    rng = np.random.default_rng(3)
    with LogRecorder(tmp_path) as recorder:
        for _ in range(100):
            trajectory = recorder.begin_trajectory()
            for stage in (1, 2, 3):
                step(trajectory, float(stage))
                if rng.random() < 0.2:
                    trajectory.cut("operator")
                    break
            else:
                trajectory.finish()
    logs = read_logs(tmp_path)
    assert logs.cut_share > 0.3
    weights = stage_weights(logs.elapsed_s(), logs.end_s, logs.is_finished)
    np.testing.assert_allclose(weights.mean(axis=0), 1.0, rtol=1e-12)


def test_a_trajectory_in_progress_is_still_running_and_a_torn_one_crashed(recorder, wait, tmp_path):
    trajectory = recorder.begin_trajectory()
    trajectory.still_running()
    begin(trajectory)
    assert read_logs(tmp_path / "logs").trajectories["cause"].tolist() == ["still-running"]
    trajectory.complete_stage(1.0)
    wait(4.0)
    begin(trajectory)
    wait(3.0)
    trajectory.still_running()
    trajectory.still_running()
    recorder._journal.close()
    logs = read_logs(tmp_path / "logs")
    assert logs.trajectories[["end_s", "ending", "cause"]].values.tolist() == [[7.0, "cut", "crash"]]
    assert logs.elapsed_s()[0].tolist()[:1] == [4.0]
    assert (tmp_path / "logs" / JOURNAL).read_text().count("running") == 1
    # Before its clock moved, a trajectory has an end, too.
    other = LogRecorder(tmp_path / "other")
    begin(other.begin_trajectory())
    other._journal.close()
    assert read_logs(tmp_path / "other").end_s.tolist() == [1e-9]


@pytest.mark.parametrize(("error", "cause"), [(KeyboardInterrupt, "operator"), (ZeroDivisionError, "crash")])
def test_leaving_by_an_error_cuts_the_trajectory(tmp_path, error, cause):
    with pytest.raises(error), LogRecorder(tmp_path) as recorder:  # noqa: PT012
        begin(recorder.begin_trajectory())
        raise error
    assert read_logs(tmp_path).trajectories["cause"].tolist() == [cause]


def test_what_each_robot_brought_is_read_back_and_is_null_where_a_stage_was_cut(tmp_path):
    with LogRecorder(tmp_path) as recorder:
        trajectory = recorder.begin_trajectory()
        for stage in (1, 2):
            begin(trajectory)
            trajectory.complete_stage(3.0, elapsed_s=float(stage), own_rewards=[1.0, 2.0 * stage])
        begin(trajectory)
        trajectory.cut("operator", elapsed_s=2.5)
    with LogRecorder(tmp_path) as recorder:
        trajectory = recorder.begin_trajectory()
        begin(trajectory)
        # It is refused when it is given, and the stage may still be completed.
        with pytest.raises(LogError, match="own_rewards has 0 numbers, but the stages before it have 2"):
            trajectory.complete_stage(3.0, elapsed_s=1.0)
        with pytest.raises(LogError, match="1_reward is nan"):
            trajectory.complete_stage(3.0, elapsed_s=1.0, own_rewards=[1.0, float("nan")])
        trajectory.complete_stage(3.0, elapsed_s=1.0, own_rewards=[1.0, 5.0])
        trajectory.finish(elapsed_s=1.0)
    stages = read_logs(tmp_path).stages
    np.testing.assert_array_equal(stages["0_reward"], [1.0, 1.0, np.nan, 1.0])
    np.testing.assert_array_equal(stages["1_reward"], [2.0, 4.0, np.nan, 5.0])


# One recorder after the other.


@pytest.mark.slow
@in_parts
@pytest.mark.parametrize("given", [{}, THREE], ids=["one robot", "robots"])
def test_a_folder_is_gone_on_with_after_a_crash(tmp_path, part_bytes, given):
    first = LogRecorder(tmp_path, part_bytes=part_bytes, reward_unit="parts")
    record_trajectory(first, given=given, scene="a")
    trajectory = first.begin_trajectory(scene="a")
    for stage in (1.0, 2.0, 3.0):
        step(trajectory, stage, **given)
    first._journal.close()
    with journal_parts(tmp_path)[-1].open("ab") as journal:
        journal.write(b'["0badf00d",{"event":"sta')
    with LogRecorder(tmp_path, part_bytes=part_bytes) as second:
        trajectory = second.begin_trajectory(weather="wet")
        assert trajectory.name == 3
        if given:
            with pytest.raises(LogError, match="trajectory 3, stage 1: robot is missing, unlike in stages before"):
                begin(trajectory, **given | {"robot": None})
        step(trajectory, 1.5, **given)
        trajectory.finish()
        for name in (1, 2, 3):
            with pytest.raises(LogError, match=f"trajectory {name}: it is in the folder already"):
                second.begin_trajectory(name)
        with pytest.raises(LogError, match="covariate x is missing"):
            begin(second.begin_trajectory(), covariates={"y": 1.0}, **given)
    logs = read_logs(tmp_path)
    assert logs.trajectories[["trajectory", "cause"]].values.tolist() == [[1, None], [2, "crash"], [3, None]]
    assert logs.trajectories["weather"].tolist() == [None, None, "wet"]
    assert logs.reward_unit == "parts"
    assert [part for part in journal_parts(tmp_path) if '"reward_unit":"parts"' not in part.read_text()] == []
    with pytest.raises(LogError, match="rewards are in 'parts' and in 'cups'"):
        LogRecorder(tmp_path, reward_unit="cups")


@in_parts
def test_one_recorder_at_a_time_and_a_fork_neither_records_nor_lets_the_lock_go(tmp_path, part_bytes):
    recorder = LogRecorder(tmp_path, part_bytes=part_bytes)
    for _ in range(2):
        record_trajectory(recorder)
    trajectory = recorder.begin_trajectory()
    child = os.fork()
    if child == 0:
        status = 1
        try:
            begin(trajectory)
        except LogError as error:
            recorder.close()
            status = 0 if "is its fork" in str(error) else 2
        finally:
            os._exit(status)
    assert os.waitpid(child, 0)[1] == 0
    with pytest.raises(ArgumentError, match=r"another recorder.*nothing needs removing after a crash"):
        LogRecorder(tmp_path)
    step(trajectory)
    recorder.close()
    LogRecorder(tmp_path).close()


def test_lines_are_json_that_other_programs_read_and_every_torn_end_is_read(tmp_path):
    with LogRecorder(tmp_path) as recorder:
        for _ in range(2):
            record_trajectory(recorder, num_stages=2)
    whole = (tmp_path / JOURNAL).read_bytes()
    lines = whole.splitlines(keepends=True)
    events = [json.loads(line)[1]["event"] for line in lines]
    assert events == ["journal", "session", *(["stage", "done"] * 2 + ["finished"]) * 2]
    num_stages = []
    for size in range(sum(map(len, lines[:3])), len(whole), 29):
        (tmp_path / JOURNAL).write_bytes(whole[:size])
        logs = read_logs(tmp_path)
        num_stages.append(logs.num_stages)
        assert set(logs.trajectories["cause"].dropna()) <= {"crash"}
    assert sorted(num_stages) == num_stages
    assert set(num_stages) == {1, 2, 3, 4}


# A journal that goes on in another file.

NUM_TRAJECTORIES = 12


def recorded(folder, part_bytes, num_trajectories=NUM_TRAJECTORIES):
    with LogRecorder(folder, part_bytes=part_bytes) as recorder:
        for number in range(num_trajectories):
            cause = None if number % 3 else "operator"
            record_trajectory(
                recorder, num_stages=2, cause=cause, given={"objects": [{"object": 1, "y": 0.5}]}, scene=number
            )
    return folder


@pytest.mark.parametrize(("part_bytes", "num_parts"), [(1, NUM_TRAJECTORIES + 1), (1500, 4), (10**6, 1)])
def test_the_log_of_several_files_is_that_of_one(tmp_path, part_bytes, num_parts):
    parts = journal_parts(recorded(tmp_path / "parts", part_bytes))
    assert [part.name for part in parts] == ["journal.jsonl", *(f"journal-{k}.jsonl" for k in range(2, num_parts + 1))]
    for name in ("journal-0.jsonl", "journal-1a.jsonl", "ajournal.jsonl"):  # of others
        (tmp_path / "parts" / name).touch()
    assert_same(read_logs(tmp_path / "parts"), read_logs(recorded(tmp_path / "one", 10**9)))
    # A trajectory stays in the part in which it began.
    assert sum(part.read_text().count('"event":"stage"') % 2 for part in parts) == 0


def test_a_torn_or_missing_part_is_reported_and_parts_moved_away_are_not_missed(tmp_path):
    parts = journal_parts(recorded(tmp_path, 1, 4))
    parts[1].write_bytes(b"".join(parts[1].read_bytes().splitlines(keepends=True)[:4]))
    with LogRecorder(tmp_path):
        assert read_logs(tmp_path).trajectories["cause"].tolist() == ["crash", None, None, "operator"]
    parts[2].unlink()
    for take in (read_logs, lambda folder: LogRecorder(folder).close()):
        with pytest.warns(HalfseenWarning, match="the journal has no journal-3.jsonl"):
            take(tmp_path)
    for part in parts[:2]:
        part.unlink()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read_logs(tmp_path).trajectory_ids.tolist() == [3, 4]
        with LogRecorder(tmp_path) as recorder:
            assert recorder.begin_trajectory().name not in (3, 4)
        assert (tmp_path / JOURNAL).stat().st_size == 0
        assert read_logs(tmp_path).trajectory_ids.tolist() == [3, 4]


def test_a_part_begins_whole_where_another_was_left_behind_in_its_place(tmp_path):
    with LogRecorder(tmp_path, part_bytes=1) as recorder:
        (tmp_path / "journal-2.jsonl").write_text("what Ctrl-C left")
        record_trajectory(recorder)
    assert read_logs(tmp_path).num_trajectories == 1


# Several robots.


def do(trajectory, robot, target, elapsed_s, reward=0.0):
    step(trajectory, elapsed_s, reward, **THREE | {"robot": robot, "object": target})


def test_who_drops_out_is_gone_and_the_others_take_what_it_was_at(recorder, wait, tmp_path):
    trajectory = recorder.begin_trajectory()
    do(trajectory, 0, 0, 1.0)
    of_robot(trajectory, 1, 1)
    trajectory.drop_out(np.int64(0), "battery", elapsed_s=1.5)
    trajectory.complete_stage(0.0, elapsed_s=2.0)
    do(trajectory, 1, 0, 3.0)
    trajectory.finish()
    trajectory = recorder.begin_trajectory()
    of_robot(trajectory, 0, 0)
    with refused(r"0_out_s 0\.0 lies outside the trajectory", LogError):
        trajectory.drop_out(0, "battery", elapsed_s=0.0)
    # On its own clock, too, a drop-out has its time.
    wait(2.0)
    trajectory.drop_out(1, "e-stop")
    wait(1.0)
    trajectory.complete_stage(1.0)
    trajectory.finish()
    ends = read_logs(tmp_path / "logs").trajectories
    assert ends[["0_out_s", "0_out_cause"]].values.tolist()[0] == [1.5, "battery"]
    assert ends["0_out_s"].isna().tolist() == [False, True]
    assert ends[["1_out_s", "end_s"]].values.tolist()[1] == [2.0, pytest.approx(3.0)]


def test_a_cut_between_stages_takes_back_all_that_was_completed_just_then(recorder, tmp_path):
    trajectory = recorder.begin_trajectory()
    do(trajectory, 0, 0, 1.0, reward=5.0)
    do(trajectory, 1, 1, 2.0)
    do(trajectory, 0, 2, 2.0)
    of_robot(trajectory, 1)
    trajectory.drop_out(0, "battery", elapsed_s=2.0)
    trajectory.complete_stage(0.0, elapsed_s=2.0)
    trajectory.cut("operator", elapsed_s=2.5)
    logs = read_logs(tmp_path / "logs")
    assert logs.end_s.tolist() == [1.99]
    assert logs.stages["reward"].tolist()[:1] == [5.0]
    assert logs.stages["elapsed_s"].isna().tolist() == [False, True]
    assert logs.objects["stage"].max() == 2
    assert "0_out_s" not in logs.trajectories


def test_why_a_rule_decided_is_read_back_and_is_no_covariate(tmp_path):
    with LogRecorder(tmp_path / "logs", keeps_events=True) as recorder:
        for why in (None, "out-of-range", None):
            trajectory = recorder.begin_trajectory()
            trajectory.begin_stage({"x": 1.0}, action="A", stepped_back=why)
            trajectory.complete_stage(1.0, elapsed_s=1.0)
            with pytest.raises(LogError, match="stepped_back is 3; say why the rule decided, or leave it out"):
                trajectory.begin_stage({"x": 1.0}, action="A", stepped_back=3)
            trajectory.finish(elapsed_s=1.5)
            last = followed(trajectory.events).rows
            assert last["trajectories"][0]["end_s"] == 1.5
    logs = read_logs(tmp_path / "logs")
    assert logs.stages["stepped_back"].fillna("").tolist() == ["", "out-of-range", ""]
    assert logs.stage_covariates == ["x"]
    of_log = {"stages": logs.stages[2:], "trajectories": logs.trajectories[2:]}
    for name, table in of_log.items():
        pd.testing.assert_frame_equal(
            pd.DataFrame(last[name]).dropna(axis=1, how="all"),
            table.dropna(axis=1, how="all").reset_index(drop=True),
            check_like=True,
        )


@pytest.mark.parametrize(
    ("flag", "read"), [(True, [False, True, False]), (1, [0, 1, 0]), (0.5, [0.0, 0.5, 0.0]), ("yes", None), ([1], None)]
)
def test_a_flag_of_missing_values_may_come_now_and_then_if_it_is_a_number_or_a_truth_value(tmp_path, flag, read):
    with LogRecorder(tmp_path) as recorder:
        trajectory = recorder.begin_trajectory()
        for stage in (1, 2, 3):
            seen = {"x": 0.5} | ({"x_missing": flag} if stage == 2 else {})
            if stage == 2 and read is None:
                # With nothing to stand where it is not, the log could not be read.
                with refused("covariate x_missing was not given before", LogError):
                    trajectory.begin_stage(seen, action="A")
                del seen["x_missing"]
            trajectory.begin_stage(seen, action="A")
            trajectory.complete_stage(1.0, elapsed_s=float(stage))
        trajectory.finish()
    stages = read_logs(tmp_path).stages
    assert (stages["x_missing"].tolist() if "x_missing" in stages else None) == read
