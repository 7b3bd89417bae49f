"""Several logs as one, and the later part of one: nothing is lost or half-written, and what does not fit is named."""

import json

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

from halfseen.cli.convert import convert
from halfseen.errors import ArgumentError, LogError
from halfseen.evaluation.specification import with_second_order
from halfseen.learning import CensoredQLearner
from halfseen.learning.named_task import NamedActions
from halfseen.logs import LogRecorder, Logs, LogStream, compact, joining, read_logs, write_stream
from halfseen.logs.formats import read_csv, write_csv
from halfseen.logs.joining import joined
from refusals import refused
from small_logs import flat_log, log_of, table_log

OWN = ["trajectory", "run", "run_trajectory"]


def halves(logs):
    middle = logs.num_trajectories // 2
    return logs.select(logs.trajectory_ids[:middle]), logs.select(logs.trajectory_ids[middle:])


def written(logs, folder):
    logs.write(folder)
    return folder


def log(trajectory, cause=None, **objects):
    """A log of one trajectory of one stage."""
    table = {"trajectory": [trajectory], "stage": [1], "object": [0], **objects} if objects else None
    clock = [1.0 if cause is None else np.nan]
    return log_of({"end_s": 1.5, "cause": cause}, table, trajectory=trajectory, elapsed_s=clock, reward=2.0, x=0.5)


def one_trajectory(folder, name="p", **columns):
    stages = log(name).stages.drop(columns=[column for column, value in columns.items() if value is ...])
    kept = {column: value for column, value in columns.items() if value is not ...}
    return written(Logs(stages.assign(**kept), log(name).trajectories), folder)


@pytest.mark.slow
@pytest.mark.parametrize("trajectories_at_once", [3, 2_000])
def test_nothing_is_lost(trajectories_at_once, tmp_path, monkeypatch):
    monkeypatch.setattr(joining, "TRAJECTORIES_AT_ONCE", trajectories_at_once)
    for whole in (flat_log(24), table_log(12)):
        place = tmp_path / str(whole.num_trajectories)
        folders = [written(half, place / name) for half, name in zip(halves(whole), "ab", strict=True)]
        done, found = compact(folders, place / "all"), read_logs(place / "all")
        counted = (whole.num_trajectories, whole.num_stages, 0)
        assert (done.num_trajectories, done.num_stages, done.num_running) == counted
        assert found.trajectories["trajectory"].tolist() == list(range(whole.num_trajectories))
        assert found.trajectories["run_trajectory"].tolist() == [str(name) for name in whole.trajectory_ids]
        assert found.trajectories["run"].tolist()[0] == str(place / "a")
        for name, table in whole.tables.items():
            ours = found.tables[name].drop(columns=OWN, errors="ignore")
            pd.testing.assert_frame_equal(ours, table.drop(columns="trajectory"), check_dtype=False)


def test_folders_of_other_forms_go_along_and_what_is_learned_is_the_same(tmp_path):
    first, second = halves(flat_log())
    write_csv(second, tmp_path / "b")
    compact([written(first, tmp_path / "a"), tmp_path / "b"], tmp_path / "all")
    learners = [
        CensoredQLearner.of_paper(2, ["A", "B", "C"], ["x1"], reg=0.1).fit(logs)
        for logs in (flat_log(), read_logs(tmp_path / "all"))
    ]
    np.testing.assert_array_equal(*(learner.q_functions_.coefficients for learner in learners))


@pytest.mark.slow
def test_what_was_compacted_goes_along_and_keeps_where_it_came_from(tmp_path):
    compact([one_trajectory(tmp_path / "a"), one_trajectory(tmp_path / "b")], tmp_path / "ab")
    compact([tmp_path / "ab", one_trajectory(tmp_path / "c", "q")], tmp_path / "abc")
    trajectories = read_logs(tmp_path / "abc").trajectories
    assert trajectories["run"].tolist() == [str(tmp_path / name) for name in "abc"]
    assert trajectories["run_trajectory"].tolist() == ["p", "p", "q"]


def test_columns_take_the_type_that_serves_all(tmp_path):
    given = {"a": ("p", {"x": 1}), "b": ("p", {"x": 0.5, "object": 3}), "c": (7, {"x": 2})}
    folders = [one_trajectory(tmp_path / name, trajectory, **columns) for name, (trajectory, columns) in given.items()]
    compact(folders, tmp_path / "all")
    stages = read_logs(tmp_path / "all").stages
    assert stages["x"].tolist() == [1.0, 0.5, 2.0]
    assert stages["object"].isna().tolist() == [True, False, True]


def test_only_some_have_stepped_back(tmp_path):
    tables = flat_log(20).tables
    stages = tables["stages"].assign(stepped_back=["late", *[None] * (len(tables["stages"]) - 1)])
    Logs(**tables).write(tmp_path / "one")
    Logs(**tables | {"stages": stages}).write(tmp_path / "other")
    compact([tmp_path / "one", tmp_path / "other"], tmp_path / "all")
    found = read_logs(tmp_path / "all").stages["stepped_back"]
    assert (found.notna().sum(), found[len(stages)]) == (1, "late")


def test_trajectories_that_are_being_recorded_are_left_out(tmp_path):
    with LogRecorder(tmp_path / "live") as recorder:
        recorder.begin_trajectory("p").begin_stage(covariates={"x": 0.5}, action="A")
        done = compact([tmp_path / "live", one_trajectory(tmp_path / "a")], tmp_path / "all")
        assert (done.num_trajectories, done.num_running) == (1, 1)
        with refused("none of the 1 folders has a trajectory that ended", LogError):
            compact([tmp_path / "live"], tmp_path / "none")


@pytest.mark.slow
def test_folders_that_do_not_go_together_are_refused(tmp_path):
    a, tables = one_trajectory(tmp_path / "a"), written(table_log(4), tmp_path / "t")
    for number, (columns, message) in enumerate(
        [
            ({"action": 3}, "stages: column 'action' is int64 in B, and string in those before it; give it one type"),
            ({"x": "red"}, "stages: column 'x' is string in B, and double in those before it; give it one type"),
            ({"x": ...}, "stages: A has column 'x', but B does not; drop it, or add its values"),
            ({"probability": 0.5}, "stages: B has column 'probability', but A does not; drop it, or add its values"),
            ({"y": 1.0}, "stages: B has column 'y', but A does not; drop it, or add its values"),
        ]
    ):
        b = one_trajectory(tmp_path / f"b{number}", **columns)
        with refused() as caught:
            compact([a, b], tmp_path / "all")
        words = str(caught.value).replace(str(a), "A").replace(str(b), "B").replace("large_string", "string")
        assert words == message
    for folders, out, message, kind in (
        ([a, tables], "all", r"t has objects and .*a has none", LogError),
        ([a, tmp_path / "t" / ".." / "a"], "all", "are the same folder; give it once", ArgumentError),
        ([a], "t", "it already exists", ArgumentError),
        ([a, tmp_path / "nowhere"], "all", "no such folder", LogError),
        ([], "all", "no folder is given", ArgumentError),
    ):
        with refused(message, kind):
            compact(folders, tmp_path / out)
    assert not (tmp_path / "all").exists()


def test_a_fault_in_the_middle_leaves_nothing(tmp_path):
    folders, calls = [one_trajectory(tmp_path / name) for name in "abc"], iter(range(5))

    def fails():
        if next(calls) == 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        compact(folders, tmp_path / "all", on_progress=fails)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b", "c"]


@pytest.mark.slow
def test_the_command_line_tells_how_many(tmp_path):
    folders = [str(one_trajectory(tmp_path / name)) for name in "abc"]
    output = CliRunner().invoke(convert, [*folders, "--out", str(tmp_path / "all")], catch_exceptions=False).stdout
    assert output == f"{tmp_path / 'all'}: 3 trajectories with 3 stages from 3 folders\n"
    output = CliRunner().invoke(convert, [*folders, "--out", str(tmp_path / "again"), "--json"]).stdout
    assert json.loads(output)["num_trajectories"] == 3
    assert isinstance(CliRunner().invoke(convert, [*folders, "--out", "csv:x"]).exception, ArgumentError)
    output = str(CliRunner().invoke(convert, [*folders, "--out", "x", "--step-s", "1"]).exception)
    assert "--step-s is for a source of kind minari" in output


# In memory, and whichever way.


def test_trajectories_keep_all_that_is_known_of_them_and_parts_equal_the_whole_that_they_were_taken_from():
    whole = joined([log(3, tried=[[]]), log(1, "battery", tried=[[0.5, 1.0]]), log(5, tried=[[]])])
    assert whole.trajectory_ids.tolist() == [1, 3, 5]
    assert whole.trajectories["cause"].isna().tolist() == [False, True, True]
    assert [list(each) for each in whole.objects["tried"]] == [[0.5, 1.0], [], []]
    again = joined([whole.select([5]), whole.select([1, 3])])
    for name, table in whole.tables.items():
        assert table.equals(again.tables[name])
    with refused("trajectory 1", LogError):
        joined([log(1), log(1)])


def whole(trajectory, x):
    return log_of({"end_s": 1.5}, trajectory=trajectory, elapsed_s=[1.0], reward=2.0, x=[x])


def in_a_stream(logs, folder):
    write_stream(logs, folder / "all")


def in_a_folder(logs, folder):
    compact([written(each, folder / str(k)) for k, each in enumerate(logs)], folder / "all")


@pytest.mark.parametrize("join", [lambda logs, folder: joined(logs), in_a_stream, in_a_folder])
@pytest.mark.parametrize(
    ("logs", "message"),
    [
        ([], "no log to join|there are no parts|no folder is given"),
        ([log(1), log(2, size=[1.0])], "only some of the|has objects and"),
        ([whole(1, 2**53 + 1), whole(2, 0.5)], "incompatible types|does not have the types of those before"),
        ([log(1).in_unit("Körbe"), log(2).in_unit("parts")], "rewards are in 'Körbe' and in 'parts'"),
    ],
)
def test_what_does_not_fit_together_is_refused(join, logs, message, tmp_path):
    with refused(message):
        join(logs, tmp_path)
    assert not (tmp_path / "all").exists()


# What rewards are counted in.


def test_the_unit_goes_where_the_log_goes(tmp_path):
    logs = flat_log(num_trajectories=8).in_unit("Körbe")
    logs.write(tmp_path / "logs")
    write_csv(logs, tmp_path / "csv")
    write_stream([logs], tmp_path / "stream")
    task = NamedActions({1: ["A", "B"], 2: ["A", "C"]}, ["x1"])
    same = [
        *(read_logs(tmp_path / name) for name in ("logs", "csv", "stream")),
        read_csv(tmp_path / "csv"),
        *LogStream(tmp_path / "logs"),
        logs.select([0, 3]),
        joined([log(1).in_unit("Körbe"), log(2)]),
        with_second_order(task, logs)[1],
    ]
    assert {one.reward_unit for one in same} == {"Körbe"}
    assert json.loads((tmp_path / "logs" / "logs.json").read_text(encoding="utf-8"))["reward_unit"] == "Körbe"


def test_a_log_without_a_unit_is_what_it_was(tmp_path):
    logs = log(1)
    manifest = written(logs, tmp_path / "logs") / "logs.json"
    assert set(json.loads(manifest.read_text())) == {"format", "version", "rows"}
    assert read_logs(tmp_path / "logs").reward_unit is logs.reward_unit is None
    assert logs.in_unit(" parts ").reward_unit == "parts"
    assert logs.in_unit(" parts ").in_unit(None).reward_unit is None
    for unit in ("", "  ", "two\nlines", "x" * 25):
        with refused(r"reward_unit is .*; give a text of one line", LogError):
            logs.in_unit(unit)
    for unit in (3, ["parts"]):
        manifest.write_text(json.dumps(json.loads(manifest.read_text()) | {"reward_unit": unit}))
        with refused(r"logs.json: reward_unit is", LogError):
            read_logs(tmp_path / "logs")
