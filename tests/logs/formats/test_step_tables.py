import csv
import json

import numpy as np
import pyarrow as pa
import pyarrow.feather
import pyarrow.parquet as pq
import pytest
from foreign import assert_is, episodes, expected

from halfseen.errors import HalfseenError, HalfseenWarning
from halfseen.logs.formats import StepRules, read_steps

SEEN = ["observation_0", "observation_1"]
FINISHED, CUT = ("finished", None), ("cut", "truncated")


def rows_of(found, terminal, *, last=None, clocks=None):
    """Steps of RLDS: one more row than there are steps, in which nothing was done any more."""
    rows = []
    for number, each in enumerate(found):
        num_steps = len(each["actions"])
        for k in range(num_steps + 1):
            is_over = k == num_steps
            row = {
                "episode_id": f"e{number}",
                "is_first": k == 0,
                "is_last": is_over if last is None else is_over and last[number],
                "is_terminal": is_over and terminal[number],
                "observation": each["observed"][k],
                "action": each["actions"][0 if is_over else k],
                "reward": 0.0 if is_over else each["rewards"][k],
            }
            rows.append(row if clocks is None else {**row, "t": clocks[number][k]})
    return rows


def write(path, rows, *, kind="parquet", compression="zstd"):
    path = path.with_suffix(f".{kind}")
    names = list(rows[0])
    if kind == "csv":
        with path.open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(names)
            for row in rows:
                cells = (row[name] for name in names)
                writer.writerow([json.dumps(cell) if isinstance(cell, list | bool) else cell for cell in cells])
        return path
    table = pa.Table.from_pylist(rows)
    if kind == "parquet":
        pq.write_table(table, path)
    elif kind == "feather":
        pyarrow.feather.write_feather(table, path, compression=compression)
    else:
        with pa.OSFile(str(path), "wb") as sink, pa.ipc.new_stream(sink, table.schema) as stream:
            stream.write_table(table)
    return path


def ends(found, step_s=1.0):
    return [[step_s * (k + 1) for k in range(len(each["actions"]))] for each in found]


@pytest.mark.parametrize("kind", ["parquet", "csv", "feather", "arrow"])
@pytest.mark.parametrize("is_text", [False, True])
def test_each_form_of_table_is_the_same_log(tmp_path, kind, is_text):
    found = episodes(is_text=is_text)
    file = write(tmp_path / "steps", rows_of(found, [True, False, True]), kind=kind)
    with pytest.warns(HalfseenWarning, match="every step counts as 1 s"):
        logs = read_steps(file)
    names = ["e0", "e1", "e2"]
    assert_is(logs, expected(found, [FINISHED, CUT, FINISHED], ends(found), SEEN, names=names))


def test_an_action_may_be_called_as_others_write_null(tmp_path):
    found = episodes(lengths=(3,))
    found[0]["actions"] = ["NA", "null", "nan"]
    logs = read_steps(write(tmp_path / "steps", rows_of(found, [True]), kind="csv"), StepRules(step_s=1.0))
    assert logs.stages["action"].tolist() == ["NA", "null", "nan"]


def test_several_files_follow_one_another_and_must_be_of_one_table(tmp_path):
    found = episodes()
    rows = rows_of(found, [True, False, True])
    files = [write(tmp_path / "a", rows[:5]), write(tmp_path / "b", rows[5:])]
    logs = read_steps(files, StepRules(step_s=0.5))
    wanted = expected(found, [FINISHED, CUT, FINISHED], ends(found, 0.5), SEEN, names=["e0", "e1", "e2"])
    assert_is(logs, wanted)
    other = write(tmp_path / "c", [{**row, "note": 1} for row in rows])
    with pytest.raises(HalfseenError, match=r"c\.parquet: its columns are not those of .*a\.parquet \(note\)"):
        read_steps([files[0], other])


def test_without_names_episodes_begin_where_is_first_says_so(tmp_path):
    found = episodes()
    rows = [{key: value for key, value in row.items() if key != "episode_id"} for row in rows_of(found, [True] * 3)]
    logs = read_steps(write(tmp_path / "steps", rows), StepRules(step_s=1.0))
    assert_is(logs, expected(found, [FINISHED] * 3, ends(found), SEEN))


@pytest.mark.parametrize(
    ("truncated", "endings"), [("cut", [CUT, ("cut", "unknown")]), ("finished", [FINISHED, ("cut", "unknown")])]
)
def test_a_last_row_that_is_no_last_one_broke_off(tmp_path, truncated, endings):
    found = episodes(lengths=(2, 3))
    file = write(tmp_path / "steps", rows_of(found, [False, False], last=[True, False]))
    logs = read_steps(file, StepRules(step_s=1.0, truncated=truncated))
    assert logs.paths[["ending", "cause"]].to_numpy().tolist() == [list(ending) for ending in endings]
    # Of what broke off the last row is a step that began: its action is known, and its reward is not.
    torn = logs.stages[logs.stages["path"] == "e1"]
    assert torn["elapsed_s"].tolist()[:3] == [1.0, 2.0, 3.0]
    assert torn["elapsed_s"].isna().tolist() == [False, False, False, True]
    assert torn["action"].tolist() == [*found[1]["actions"], found[1]["actions"][0]]
    assert logs.end_s.tolist()[1] == 4.0


def test_a_named_column_is_the_clock(tmp_path):
    found = episodes(lengths=(2, 2))
    clocks = [[10.0, 10.5, 12.0], [3.0, 4.0, 4.25]]
    file = write(tmp_path / "steps", rows_of(found, [True, False], last=[True, False], clocks=clocks))
    logs = read_steps(file, StepRules(clock="t"))
    np.testing.assert_array_equal(logs.elapsed_s(), [[0.5, 2.0, np.nan], [1.0, 1.25, np.nan]])
    assert logs.end_s.tolist() == [2.0, 1.25]


def test_structs_are_taken_apart_and_the_rest_is_left_out_and_told(tmp_path):
    found = episodes(lengths=(2,))
    rows = rows_of(found, [False])
    for k, row in enumerate(rows):
        x, y = row.pop("observation")
        row |= {"observation": {"arm": {"x": x, "q": [y, [2.0, 3.0][k % 2]]}, "lit": k == 1, "lamp": "on"}}
        row |= {"discount": 1.0, "reward": 5.0}
    with pytest.warns(HalfseenWarning) as told:
        logs = read_steps(write(tmp_path / "steps", rows), StepRules(step_s=1.0))
    assert [str(each.message).partition(": ")[2] for each in told] == [
        "left out are discount: nobody saw them before the action",
        "1 rewards other than 0 stand in rows that are is_last, in which nothing was done any more: they are not read",
    ]
    names = ["observation.arm.q_0", "observation.arm.q_1", "observation.arm.x", "observation.lamp", "observation.lit"]
    assert sorted(logs.stage_covariates) == names
    assert logs.stages["observation.arm.x"].tolist() == [row[0] for row in found[0]["observed"]]
    assert logs.stages["observation.arm.q_1"].tolist() == [2.0, 3.0, 2.0]
    assert logs.stages["observation.lit"].tolist() == [False, True, False]


@pytest.mark.parametrize("kind", [pa.list_(pa.float32(), 2), pa.large_list(pa.float64())], ids=["fixed", "large"])
def test_lists_of_any_kind_are_columns(tmp_path, kind):
    found = episodes(lengths=(2,))
    rows = rows_of(found, [False])
    lists = pa.array([row["observation"] for row in rows], kind)
    table = pa.Table.from_pylist(rows).drop_columns(["observation"]).append_column("observation", lists)
    pq.write_table(table, tmp_path / "steps.parquet")
    logs = read_steps(tmp_path / "steps.parquet", StepRules(step_s=1.0))
    assert_is(logs, expected(found, [CUT], ends(found), SEEN, names=["e0"]), rtol=1e-6)


def test_columns_of_one_name_are_refused(tmp_path):
    rows = [{**row, "observation": {"a": 1.0}, "observation.a": 2.0} for row in rows_of(episodes(lengths=(2,)), [True])]
    with pytest.raises(HalfseenError, match=r"there are two columns 'observation\.a'; drop or rename one"):
        read_steps(write(tmp_path / "steps", rows), StepRules(step_s=1.0))


def test_what_is_no_column_of_a_stage_is_passed_over(tmp_path):
    rows = [{**row, "observation.image": [0] * 1001} for row in rows_of(episodes(lengths=(1,)), [True])]
    with pytest.warns(HalfseenWarning, match=r"observation\.image \(int64 of shape \(1001,\)\): no columns"):
        logs = read_steps(write(tmp_path / "steps", rows), StepRules(step_s=1.0))
    assert logs.stage_covariates == SEEN


def changed(**columns):
    """Rows of two episodes, of one step and of two, with other values in some columns; None drops one."""

    def rows():
        told = rows_of(episodes(lengths=(1, 2)), [True, False])
        for name, values in columns.items():
            for row, value in zip(told, values or [None] * 5, strict=True):
                row[name] = value
            if values is None:
                for row in told:
                    del row[name]
        return told

    return rows


YES, NO = True, False


@pytest.mark.parametrize(
    ("rows", "told"),
    [
        (changed(is_last=None), r"no 'is_last' for the end of an episode among .*; add it"),
        (changed(is_terminal=None), r"no 'is_terminal' for the done"),
        (changed(action=None), r"no 'action' for the action among episode_id"),
        (changed(is_first=None, episode_id=None), r"no 'is_first' for the beginning of an episode"),
        (changed(action=[[0.1, 0.2]] * 5), r"action holds float64 of shape \(2,\).*discretise"),
        (changed(action=[0.5] * 5), r"action holds float64"),
        (changed(action=[None, 1, 1, 1, 1]), r"path 'e0', stage 1: the stage is completed, yet its action is null"),
        (changed(reward=[None, 1.0, 1.0, 1.0, 1.0]), r"path 'e0', stage 1: .*reward is nan"),
        (changed(reward=[float("nan")] * 5), r"path 'e0', stage 1: .*reward is nan"),
        (changed(is_last=[NO, YES, YES, NO, YES]), r"episode 'e1': step 1 of 3 ends it; make two"),
        (changed(is_terminal=[YES, YES, NO, NO, NO]), r"episode 'e0': step 1 of 2 ends it"),
        (changed(is_last=[NO] * 5), r"episode 'e0': its last row terminates it and is not is_last"),
        (changed(is_last=[NO, YES, None, NO, YES]), r"is_last"),
        (changed(is_first=[YES, NO, NO, NO, NO]), r"row 2: is_first is False, yet episode_id is 'e1'"),
        (changed(episode_id=None, is_first=[NO, NO, YES, NO, NO]), r"row 0: is_first is false"),
        (changed(episode_id=["a", "b", "a", "a", "a"], is_first=[YES, YES, YES, NO, NO]), r"'a' do not stand"),
        (changed(episode_id=[None, "b", "b", "b", "b"]), r"episode_id holds object, or null, and not names"),
        (changed(episode_id=[0.5] * 5, is_first=[YES, NO, NO, NO, NO]), r"episode_id holds float64"),
        (changed(observation=[[1.0], [2.0], [3.0], [4.0], [5.0, 6.0]]), r"row 4: observation has 2 values"),
        (changed(observation=[[float("nan"), 1.0]] * 5), r"path 'e0', stage 1: covariate observation_0 is null"),
        (changed(observation=[[1.0, float("inf")]] * 5), r"covariate observation_1 is inf"),
        (changed(episode_id=["a", "b", "c", "c", "c"], is_first=[YES, YES, YES, NO, NO],
                 is_last=[YES, YES, NO, NO, YES], is_terminal=[YES, YES, NO, NO, NO]), r"'a': it has no step"),
    ],
)  # fmt: skip
@pytest.mark.filterwarnings("ignore:.*nothing was done any more:halfseen.errors.HalfseenWarning")
def test_what_is_wrong_is_told_in_one_line(tmp_path, rows, told):
    file = write(tmp_path / "steps", rows())
    with pytest.raises(HalfseenError, match=told) as caught:
        read_steps(file, StepRules(step_s=1.0))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
@pytest.mark.parametrize("kind", ["feather", "parquet"])
def test_a_table_of_few_bytes_and_many_values_is_refused_before_it_is_read(tmp_path, monkeypatch, kind, compression):
    monkeypatch.setattr("halfseen.reading.ALWAYS_UNPACKED", 10**5)
    file = tmp_path / f"steps.{kind}"
    table = pa.table({"observation": np.zeros(10**6)})
    if kind == "parquet":
        pq.write_table(table, file)
    else:
        pyarrow.feather.write_feather(table, file, compression=compression, chunksize=10**6)
    monkeypatch.setattr("pyarrow.ipc.open_file", None)
    with pytest.raises(HalfseenError, match="unpacked, it has 8 MB"):
        read_steps(file)


def test_a_table_without_rows_is_told(tmp_path):
    (tmp_path / "steps.csv").write_text("is_first,is_last,is_terminal,observation.x,action,reward\n")
    with pytest.raises(HalfseenError, match=r"steps\.csv: there is no row; give a table"):
        read_steps(tmp_path / "steps.csv")
