"""What stands for missing covariates: medians by hand, values carried forward by a loop, streams, states and forms."""

from contextlib import closing
from functools import partial

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bags import number as number_of
from bags import tables_of, text, write_bag
from event_files import WIDE
from foreign import LAST as LAST_STEP
from foreign import (
    NO,
    arrays,
    episodes,
    last_of,
    rows_of,
    write_arrays,
    write_lerobot,
    write_minari_episodes,
    write_rows,
)
from halfseen.errors import ArgumentError, HalfseenWarning, LogError
from halfseen.learning import CensoredQLearner
from halfseen.logs import Logs, LogStream, compact, read_logs
from halfseen.logs.formats import (
    StepRules,
    losses,
    read_bag,
    read_csv,
    read_event_table,
    read_lerobot,
    read_minari,
    read_sql,
    read_step_arrays,
    read_steps,
    write_csv,
    write_minari,
)
from halfseen.logs.formats.sql_rows import Queries
from halfseen.logs.missing import KEEP, LAST, MEDIAN, Fill, Filling, share_of
from holes import holed, holed_log
from refusals import refused
from small_logs import flat_log, table_log
from text_logs import text_log

ENDS = {"trajectory": [0, 1], "end_s": [4.0, 2.5], "ending": ["finished", "cut"], "cause": [None, "battery"]}
STAGES = {
    "trajectory": [0, 0, 0, 1, 1],
    "stage": [1, 2, 3, 1, 2],
    "elapsed_s": [1.0, 2.0, 4.0, 1.5, None],
    "action": ["A", "B", "A", "A", "B"],
    "reward": [0.0, 1.0, 0.0, 2.0, None],
    "x": [None, 5.0, None, 1.0, 2.0],
    "n": [1, 2, None, 9, 3],
    "on": [True, None, False, True, None],
    "colour": [None, "red", None, "blue", None],
    "whole": [1, 2, 3, 4, 5],
}


def log(missing, **columns):
    return Logs({**STAGES, **columns}, ENDS, missing=missing)


def values(logs, *names):
    return {name: logs.stages[name].tolist() for name in names}


def test_medians_and_flags_by_hand():
    found = log(MEDIAN)
    # Of x 1, 2, 5; of n 1, 2, 3, 9; of on 0, 1, 1.
    assert values(found, "x", "n", "on", "colour", "whole") == {
        "x": [2.0, 5.0, 2.0, 1.0, 2.0],
        "n": [1.0, 2.0, 2.5, 9.0, 3.0],
        "on": [1.0, 1.0, 0.0, 1.0, 1.0],
        "colour": ["missing", "red", "missing", "blue", "missing"],
        "whole": [1, 2, 3, 4, 5],
    }
    assert values(found, "x_missing", "n_missing", "on_missing") == {
        "x_missing": [1, 0, 1, 0, 0],
        "n_missing": [0, 0, 1, 0, 0],
        "on_missing": [0, 1, 0, 0, 1],
    }
    assert found.stage_covariates == ["x", "n", "on", "colour", "whole", "x_missing", "n_missing", "on_missing"]
    assert found.filling.fills["x"] == Fill(MEDIAN, 2.0, num_missing=2, has_flag=True)
    assert found.filling.lines()[0] == "x is missing in 2 of 5 stages (40 %); it is replaced by the median 2"


def test_last_values_by_hand_and_the_median_before_the_first():
    found = log({"x": LAST, "colour": LAST, "*": MEDIAN})
    assert values(found, "x", "colour") == {
        "x": [2.0, 5.0, 5.0, 1.0, 2.0],
        "colour": ["missing", "red", "red", "blue", "blue"],
    }
    assert [name for name in found.stage_covariates if name.endswith("_missing")] == ["n_missing", "on_missing"]


def carried_forward(logs, name, value):
    """A naive loop."""
    found, last = [], {}
    for _, row in logs.stages.iterrows():
        if not pd.isna(row[name]):
            last[row["trajectory"]] = row[name]
        found.append(last.get(row["trajectory"], value))
    return found


@pytest.mark.parametrize("seed", range(3))
def test_values_are_carried_forward_as_a_loop_does(seed):
    logs = holed_log(0.4, seed)
    found = Logs(logs.stages, logs.trajectories, missing=LAST)
    for name in ("x", "colour", "is_heavy"):
        there = logs.stages[name].dropna()
        value = "missing" if name == "colour" else float(np.median(there.astype(float)))
        assert found.stages[name].tolist() == carried_forward(logs, name, value)


@pytest.mark.parametrize("rule", [MEDIAN, LAST, {"x": LAST, "*": MEDIAN}])
@pytest.mark.parametrize("trajectories_at_once", [1, 3, 1000])
def test_a_stream_gives_what_the_whole_gives(rule, trajectories_at_once, tmp_path):
    holed_log(0.2, num_trajectories=8).write(tmp_path / "logs")
    whole, stream = (
        read_logs(tmp_path / "logs", missing=rule),
        LogStream(tmp_path / "logs", trajectories_at_once, missing=rule),
    )
    parts = pd.concat([part.stages for part in stream], ignore_index=True)
    pd.testing.assert_frame_equal(parts, whole.stages)
    assert stream.filling == whole.filling
    assert stream.stage_covariates == whole.stage_covariates


@pytest.mark.slow
@given(seed=st.integers(0, 2**32 - 1), rule=st.sampled_from([MEDIAN, LAST, "refuse", {"x": MEDIAN}]))
@settings(max_examples=10, deadline=None)
def test_with_nothing_missing_a_rule_changes_nothing(seed, rule):
    logs = text_log(num_trajectories=5, seed=seed)
    same = Logs(logs.stages, logs.trajectories, missing=rule)
    pd.testing.assert_frame_equal(same.stages, logs.stages)


@pytest.mark.slow
@given(seed=st.integers(0, 2**32 - 1), share=st.floats(0.0, 0.9), rule=st.sampled_from([MEDIAN, LAST]))
@settings(max_examples=10, deadline=None)
def test_what_is_there_stays_and_what_was_filled_in_is_so_only_once(seed, share, rule):
    whole = text_log(num_trajectories=8, seed=seed)
    logs = holed(whole, share, seed, columns=["x", "is_heavy"])
    if logs.stages[["x", "is_heavy"]].isna().all().any():
        return
    found = Logs(logs.stages, logs.trajectories, missing=rule)
    is_there = logs.stages["x"].notna()
    np.testing.assert_array_equal(found.stages["x"][is_there], whole.stages["x"][is_there])
    assert found.stages[found.stage_covariates].notna().all(axis=None)
    if rule == MEDIAN and not is_there.all():
        np.testing.assert_array_equal(found.stages["x_missing"], ~is_there)
    for again in (rule, found.filling):
        same = Logs(found.stages, found.trajectories, missing=again)
        pd.testing.assert_frame_equal(same.stages, found.stages)
    # A log that was filled in before says by its flags what was missing.
    if rule == MEDIAN:
        assert Logs(found.stages, found.trajectories, missing=rule).filling == found.filling


def test_a_column_that_is_called_like_a_flag_is_none_where_nothing_is_missing():
    parts = {"parts": [3, 4, 5, 6, 7], "parts_missing": [0, 2, 1, 0, 0]}
    found = Logs(pd.DataFrame({**STAGES, **parts}).drop(columns=["x", "n", "on", "colour"]), ENDS, missing=MEDIAN)
    assert values(found, *parts) == parts
    assert found.filling is not None
    assert not found.filling.flags


def test_a_part_of_a_log_keeps_what_the_whole_taught():
    found = log(MEDIAN)
    part = found.select([1])
    assert part.filling == found.filling
    pd.testing.assert_frame_equal(part.stages, found.stages[3:].reset_index(drop=True))
    assert log(KEEP).select([1]).stages["colour"].isna().tolist() == [False, True]


@pytest.mark.parametrize("rule", [MEDIAN, LAST, {"x": LAST, "*": MEDIAN}])
def test_a_state_is_filled_in_as_its_row_of_a_log(rule):
    logs = holed_log(0.4)
    found = Logs(logs.stages, logs.trajectories, missing=rule)
    columns, last, trajectory = found.stage_covariates, None, None
    for raw, full in zip(logs.stages.to_dict("records"), found.stages.to_dict("records"), strict=True):
        last = last if raw["trajectory"] == trajectory else None
        state = {name: None if pd.isna(raw[name]) else raw[name] for name in logs.stage_covariates}
        filled, said = found.filling.of_state(state, columns, last)
        assert {name: filled[name] for name in columns} == {name: full[name] for name in columns}
        assert list(said) == [name for name, value in state.items() if value is None]
        last, trajectory = filled, raw["trajectory"]


@pytest.mark.parametrize("rule", [MEDIAN, LAST])
def test_a_column_that_is_not_there_is_filled_in_as_one_of_null(tmp_path, rule):
    logs = holed_log(0.4)
    filling = Logs(logs.stages, logs.trajectories, missing=rule).filling
    lacking = Logs(logs.stages.drop(columns=["x", "colour"]), logs.trajectories, missing="keep")
    lacking.write(tmp_path / "lacking")
    null = Logs(logs.stages.assign(x=None, colour=None), logs.trajectories, missing=filling)
    message = r"stages: there is no column '(x|colour)'; it is replaced by the .* in every stage"
    with pytest.warns(HalfseenWarning, match=message):
        found = Logs(lacking.stages, logs.trajectories, missing=filling)
    pd.testing.assert_frame_equal(found.stages[list(null.stages)], null.stages)
    stream = LogStream(tmp_path / "lacking", missing=filling, trajectories_at_once=10**6)
    with pytest.warns(HalfseenWarning, match=message):
        (part,) = stream
    assert stream.stage_covariates == part.stage_covariates == found.stage_covariates


def test_a_state_may_lack_what_is_looked_at_and_nothing_else_is_added():
    fills = {"x": Fill(LAST, 0.5), "y": Fill(MEDIAN, 2.0, 1, True), "z": Fill(MEDIAN, None)}
    filling = Filling(fills, 10)
    state, said = filling.of_state({"x": np.nan, "other": 1}, ["x", "z"])
    assert state == {"x": 0.5, "other": 1}
    assert said == {"x": "x is missing and is replaced by 0.5, the median of the logs"}
    assert filling.of_state({}, ["y_missing"], {"x": 3.0})[0] == {"y": 2.0, "y_missing": 1}
    assert filling.of_state({"x": None}, [], {"x": 3.0})[1] == {
        "x": "x is missing and is replaced by 3, its last value"
    }
    assert filling.of_state({"y": 1.0, "y_missing": 1}, ["y"])[0] == {"y": 1.0, "y_missing": 1}
    # Beside a median, truth values are numbers, as in a log.
    assert type(filling.of_state({"y": True}, ["y"])[0]["y"]) is float


@pytest.mark.parametrize(
    ("missing", "columns", "kind", "message"),
    [
        (
            None,
            {},
            LogError,
            r"^trajectory 0, stage 1: covariate x is null, as in 2 of 5 stages \(40 %\) .*--missing x=",
        ),
        ({"x": LAST}, {}, LogError, "^trajectory 0, stage 3: covariate n is null, as in 1 of 5"),
        (MEDIAN, {"x": [None] * 5}, LogError, "^covariate x is null in every one of the 5 stages"),
        (LAST, {"colour": [None] * 5}, LogError, "^covariate colour is null in every"),
        (MEDIAN, {"x": [1.0, np.inf, None, 2.0, 3.0]}, LogError, "covariate x is inf; give the number"),
        ("mean", {}, ArgumentError, "^missing is 'mean'; choose among median.flag, last, refuse"),
        ({"x": "lst"}, {}, ArgumentError, "^missing of 'x' is 'lst'.* did you mean 'last'"),
        (MEDIAN, {"x": [np.inf, np.inf, None, np.inf, 3.0]}, LogError, "covariate x is inf; give the number"),
        (MEDIAN, {"x": [1.7e308, 1.7e308, None, None, None], "n": [1, None, np.inf, 1, 1]}, LogError, "n is inf; give"),
        ({"colr": LAST}, {}, ArgumentError, "^missing names 'colr'; .* did you mean 'colour'"),
        (MEDIAN, {"x_missing": [0, 1, 2, 0, 0]}, LogError, "^covariate x_missing has values other than 0 and 1"),
        ({"lists": LAST}, {"lists": [[1.0]] * 5}, LogError, "^covariate lists holds neither numbers nor text"),
        (MEDIAN, {"lists": [[1.0], None, [1.0], [1.0], [1.0]]}, LogError, "covariate lists is null, as in 1 of 5"),
        (
            Filling({"x": Fill(MEDIAN, "missing", 1)}, 5),
            {},
            LogError,
            "^covariate x holds number, but missing values are filled with a text",
        ),
    ],
)
def test_what_cannot_be_filled_in_is_refused_in_one_line(missing, columns, kind, message):
    with refused(message, kind):
        log(missing, **columns)


def test_objects_lack_nothing():
    logs = table_log()
    objects = logs.objects.assign(occlusion=logs.objects["occlusion"].where(logs.objects.index != 3))
    with refused("covariate occlusion is null; give the number that the policy saw"):
        Logs(logs.stages, logs.trajectories, objects, missing=MEDIAN)


def test_nothing_is_learned_from_what_is_still_missing():
    logs = holed(flat_log(), columns=["x1"])
    with refused("covariate 'x1' is nan"):
        CensoredQLearner.of_paper(2, {1: ["A", "B"], 2: ["A", "C"]}, ["x1", "x2"], reg=0.1).fit(logs)


def test_forms_hold_what_is_missing(tmp_path):
    logs = holed_log(0.2)
    logs.write(tmp_path / "logs")
    write_csv(logs, tmp_path / "csv")
    for found in (read_logs(tmp_path / "logs", missing=KEEP), read_csv(tmp_path / "csv", missing=KEEP)):
        pd.testing.assert_frame_equal(found.stages, logs.stages)
    assert read_logs(tmp_path / "csv", missing=MEDIAN).filling == read_logs(tmp_path / "logs", missing=MEDIAN).filling
    with refused("column 'x' is null in .* fill it in"):
        write_minari(logs, "holes-v0")
    assert [loss.column for loss in losses(logs, "minari")] == ["x"]


def test_many_folders_with_something_missing_become_one(tmp_path):
    logs = holed_log(0.2)
    halves = np.array_split(logs.trajectory_ids, 2)
    for number, half in enumerate(halves):
        logs.select(half).write(tmp_path / str(number))
    compact([tmp_path / "0", tmp_path / "1"], tmp_path / "both")
    pd.testing.assert_frame_equal(read_logs(tmp_path / "both", missing=KEEP).stages, logs.stages)


MAPPING = """
clock = {field = "ms", unit = "ms", since = "trajectory"}
trajectory = {field = "run"}
action = {field = "tool"}
reward = {field = "worth"}
ending = {field = "stop", finished = [""]}
covariates.left = {field = "seconds left"}
covariates.kind = {field = "kind"}
"""


def test_an_empty_cell_of_a_covariate_is_missing_in_a_table_of_stages(tmp_path):
    rows = [line.split(",") for line in WIDE.splitlines()]
    kinds = ["kind", "soft", "", "hard", "soft"]
    rows = [[*row, kind] for row, kind in zip(rows, kinds, strict=True)]
    rows[2][2] = ""
    (tmp_path / "wide.csv").write_text("\n".join(",".join(row) for row in rows) + "\n")
    (tmp_path / "wide.toml").write_text(MAPPING)
    found = read_event_table(tmp_path / "wide.csv", tmp_path / "wide.toml", missing=MEDIAN)
    assert found.stages["left"].tolist() == [9.5, 9.5, 9.5, 6.25]
    assert found.stages["left_missing"].tolist() == [0, 1, 0, 0]
    assert found.stages["kind"].tolist() == ["soft", "missing", "hard", "soft"]
    with refused("trajectory 'a', stage 2: covariate left is null"):
        read_event_table(tmp_path / "wide.csv", tmp_path / "wide.toml")


def test_a_database_may_hold_null(tmp_path):
    pytest.importorskip("sqlalchemy")
    import sqlite3

    logs = holed_log(0.2)
    with closing(sqlite3.connect(tmp_path / "cell.db")) as database:
        for name, table in logs.tables.items():
            table.to_sql(name, database, index=False)
    queries = Queries("SELECT * FROM stages", "SELECT * FROM trajectories")
    found = read_sql(f"sqlite:///{tmp_path}/cell.db", queries, missing=MEDIAN)
    expected = Logs(logs.stages, logs.trajectories, missing=MEDIAN)
    assert found.filling == expected.filling
    np.testing.assert_array_equal(found.stages["x"], expected.stages["x"])


def test_steps_and_bags_may_lack_what_was_seen(tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    found = episodes(lengths=(2,))
    found[0]["observed"][0][0] = np.nan
    seen, rules = np.array([[np.nan, 1.0], [2.0, 3.0], [4.0, 5.0], [6.0, 7.0]]), StepRules(step_s=1.0)
    messages = [number_of(1.0, "/c", np.nan), text(1.0, "/a", "A"), number_of(2.0, "/r", 1.0), text(3.0, "/e", "stop")]
    (tmp_path / "cell.toml").write_text(
        tables_of({key: f"/{key[0]} data" for key in ("action", "reward", "ending", "covariates.c")})
    )
    readers = [
        partial(read_steps, write_rows(tmp_path / "rows", rows_of(found, [True])), rules),
        partial(read_step_arrays, write_arrays(tmp_path / "a.hdf5", arrays(found, [0])), rules),
        partial(read_lerobot, write_lerobot(tmp_path, found, extra={"next.terminated": last_of(found, [True])}), rules),
        partial(read_minari, write_minari_episodes("holes-v0", [(LAST_STEP, NO)], observations=seen), step_s=1.0),
        partial(read_bag, write_bag(tmp_path / "bag", messages, "mcap"), tmp_path / "cell.toml"),
    ]
    for read in readers:
        logs = read(missing=KEEP)
        assert np.isnan(logs.stages[logs.stage_covariates[0]].tolist()[:2]).tolist() in ([True, False], [True, True])
        with refused(r"trajectory .*, stage 1: covariate .* is null, as in [12] of .* fill it in by --missing"):
            read()


@pytest.mark.parametrize(("count", "said"), [(3, "3 of 400 stages (0.75 %)"), (400, "400 of 400 stages (100 %)")])
def test_a_share_is_said_in_plain_digits(count, said):
    assert share_of(count, 400) == said
