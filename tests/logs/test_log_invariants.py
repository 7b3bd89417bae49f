"""Each invariant is broken alone, in a log that is otherwise sound."""

from functools import partial

import numpy as np
import pandas as pd
import pytest
from valid_logs import small_tables

from halfseen.errors import LogError
from halfseen.logs import Logs, read_logs
from halfseen.logs.frames import as_frame


def put(table, column, row, value):
    """Break one cell."""

    def break_it(tables):
        values = tables[table][column].tolist()
        values[row] = value
        tables[table][column] = values

    return break_it


stages, paths, objects = (partial(put, name) for name in ("stages", "paths", "objects"))


def taken(table, rows):
    """Take some rows, by number."""
    return lambda tables: tables.update({table: tables[table].iloc[rows]})


BREAKS = [
    (stages("action", slice(None), [{"a": 1}] * 5), "stages: column 'action' holds mixed, not names; give whole"),
    (stages("action", slice(None), [b"x"] * 5), "stages: column 'action' holds bytes, not names; give whole"),
    (taken("objects", []), "path 1, stage 1: it has no row in objects"),
    (taken("stages", [0, 1, 2, 3]), "path 3: it has no stage; even a path cut in its first"),
    (taken("paths", [0, 1]), "path 3, stage 1: paths has no such path; add its row"),
    (stages("path", slice(None), list("11223")), "path '1', stage 1: paths has no such path"),
    (taken("paths", [0, 1, 2, 1]), "path 2: it is in paths twice"),
    (stages("path", 1, None), "stages, row 1: path is null"),
    (paths("path", 1, 2.5), "paths, row 1: path 2.5 is no name"),
    (taken("stages", [0, 1, 2, 3, 4, 2]), "path 2, stage 1: the stage is there twice"),
    (stages("stage", 1, 3), "path 1, stage 3: stage 2 is missing before it; number the stages"),
    (stages("stage", 0, 0), "path 1, stage 0: stage 1 is missing before it"),
    (stages("stage", 1, 1.5), "stages, row 1, path 1: stage 1.5 is no whole number"),
    (stages("stage", 1, None), "stages, row 1, path 1: stage nan is no whole number"),
    (
        stages("elapsed_s", 1, 1.2),
        "path 1, stage 2: elapsed_s 1.2 is before the 1.5 of stage 1; sort the stages or fix the clock",
    ),
    (stages("elapsed_s", 1, 1.5), "path 1, stage 2: elapsed_s 1.5 is also the 1.5 of stage 1"),
    (stages("elapsed_s", 0, 0.0), "path 1, stage 1: elapsed_s 0.0 is no time after"),
    (stages("elapsed_s", 1, np.inf), "path 1, stage 2: elapsed_s inf is no time after"),
    (stages("elapsed_s", 2, 3.6), "path 2, stage 1: elapsed_s 3.6 is after the path's end_s 3.5"),
    (
        stages("elapsed_s", 1, None),
        "path 1, stage 2: elapsed_s is null, yet only the last stage of a cut path is not completed",
    ),
    (stages("elapsed_s", 2, None), "path 2, stage 1: elapsed_s is null, yet only"),
    (
        stages("elapsed_s", 3, 3.0),
        "path 2, stage 2: elapsed_s 3.0 completes the last stage of a cut path; add the stage in which the cut fell",
    ),
    (stages("action", 0, None), "path 1, stage 1: the stage is completed, yet its action is null"),
    (stages("reward", 1, None), "path 1, stage 2: the stage is completed, yet its reward is nan"),
    (stages("reward", 1, np.inf), "path 1, stage 2: the stage is completed, yet its reward is inf"),
    (stages("reward", 3, 1.0), "path 2, stage 2: reward 1.0 is given, yet the stage was not"),
    (stages("reward", slice(None), ["1"] * 5), "stages: column 'reward' holds string, not numbers"),
    (stages("probability", 0, 0.0), "path 1, stage 1: probability 0.0 of the logged action"),
    (stages("probability", 3, 1.1), "path 2, stage 2: probability 1.1 of the logged action"),
    (stages("probability", 2, None), "path 2, stage 1: probability nan of the logged action"),
    (stages("steps_to_go", 4, None), "path 3, stage 1: covariate steps_to_go is null; give the number"),
    (paths("end_s", 0, 0.0), "path 1: end_s 0.0 is no end"),
    (paths("end_s", 1, None), "path 2: end_s nan is no end"),
    (paths("end_s", 1, np.inf), "path 2: end_s inf is no end"),
    (paths("ending", 1, "done"), "path 2: ending 'done' is unknown; say 'finished'"),
    (paths("ending", 0, None), "path 1: ending null is unknown"),
    (paths("cause", 0, "battery"), "path 1: it finished, yet has the cause 'battery'"),
    (objects("path", 0, 9), "path 9, stage 1, object 'cup': paths has no such path"),
    (objects("stage", 9, 2), "path 3, stage 2, object 'mug': the path has stages 1 to 1; add the stage"),
    (objects("object", 3, "cup"), "path 1, stage 2, object 'cup': the object is there twice"),
    (objects("object", 3, None), "objects, row 3: object is null"),
    (
        stages("object", 2, "jug"),
        r"path 2, stage 1: object 'jug' of the action is not among the objects of that stage ('cup', 'mug')",
    ),
    (
        taken("objects", [0, 1, 2, 3, 4, 6, 7, 8, 9]),
        "path 2, stage 1: object 'mug' of the action is not among the objects of that stage ('cup')",
    ),
    (taken("objects", [0, 1, 4, 5, 6, 7, 8, 9]), "path 1, stage 2: it has no row in objects"),
    (objects("occlusion", 4, np.nan), "path 2, stage 1, object 'cup': covariate occlusion is null"),
    (objects("hidden_by", 7, [0.1, np.nan]), "path 2, stage 2, object 'mug': covariate hidden_by is array([0.1, nan])"),
    (objects("hidden_by", 7, None), "path 2, stage 2, object 'mug': covariate hidden_by is null"),
]


def test_the_unbroken_log_is_sound():
    assert Logs(**small_tables()).num_paths == 3


@pytest.mark.parametrize(("break_it", "message"), BREAKS, ids=[message[:40] for _, message in BREAKS])
def test_broken_invariant_is_named_with_place_value_and_remedy(break_it, message):
    tables = small_tables()
    break_it(tables)
    with pytest.raises(LogError) as refusal:
        Logs(**tables)
    assert str(refusal.value).startswith(message)
    assert len(str(refusal.value).splitlines()) == 1


@pytest.mark.parametrize("table", ["stages", "paths", "objects"])
def test_rows_out_of_order_are_no_fault_but_the_broken_place_is_still_named(table):
    tables = small_tables()
    stages("elapsed_s", 1, 1.2)(tables)
    tables[table] = tables[table][::-1]
    with pytest.raises(LogError, match=r"path 1, stage 2: elapsed_s 1.2 is before"):
        Logs(**tables)


@pytest.mark.parametrize(
    ("table", "column"),
    [("stages", c) for c in ("path", "stage", "elapsed_s", "action", "reward")]
    + [("paths", c) for c in ("path", "end_s", "ending")]
    + [("objects", c) for c in ("path", "stage", "object")],
)
def test_missing_column_is_named_with_those_there_and_the_closest(table, column):
    tables = small_tables()
    tables[table] = tables[table].rename(columns={column: column + "x"})
    with pytest.raises(LogError) as refusal:
        Logs(**tables)
    assert str(refusal.value).startswith(f"{table}: there is no column {column!r} among ")
    assert str(refusal.value).endswith(f"; rename {column + 'x'!r}?")


def test_column_with_no_like_is_to_be_added():
    tables = small_tables()
    tables["stages"] = tables["stages"].drop(columns="reward")
    with pytest.raises(LogError, match=r"no column 'reward' among path, stage, .*; add it"):
        Logs(**tables)


def test_empty_log_is_refused():
    tables = {name: frame[:0] for name, frame in small_tables().items()}
    with pytest.raises(LogError, match="paths: there are none"):
        Logs(**tables)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"path": [1, 2], "end_s": [1.0]}, "paths: not a table"),
        ({"path": np.ones((2, 2))}, "paths: not a table"),
        (pd.DataFrame([[1, 2]], columns=["path", "path"]), "paths: there are two columns 'path'"),
        (pd.DataFrame([[1]]), "paths: column 0 has a name that is not text"),
        ({"path": [1, "a"]}, "paths: a column cannot be stored .*path.*give each column one type"),
        (3, r"paths: not a table \(it is a int\)"),
    ],
)
def test_what_is_no_table_is_refused(table, message):
    with pytest.raises(LogError, match=message):
        as_frame("paths", table)


# Logs of several robots: a clock that may stand, and no two at one object.


def log_of_robots(objects=(0, 1, 2), robots=("left", "right", "left"), elapsed_s=(0.0, 2.0, 5.0)):
    done = {"path": 0, "stage": range(1, 4), "elapsed_s": elapsed_s, "action": "WASH", "reward": 1.0}
    ends = {"path": [0], "end_s": [elapsed_s[-1]], "ending": ["finished"]}
    return Logs(pd.DataFrame(done | {"object": objects, "robot": robots}), ends)


def test_a_clock_may_stand_where_two_robots_are_free_at_once(tmp_path):
    logs = log_of_robots()
    assert logs.elapsed_s().tolist() == [[0.0, 2.0, 5.0]]
    assert "robot" not in logs.stage_covariates
    logs.write(tmp_path / "log")
    assert read_logs(tmp_path / "log").stages["robot"].tolist() == ["left", "right", "left"]


def test_of_one_robot_it_runs():
    alone = log_of_robots().stages.drop(columns="robot")
    with pytest.raises(LogError, match=r"elapsed_s 0.0 is no time after the path's beginning"):
        Logs(alone, {"path": [0], "end_s": [5.0], "ending": ["finished"]})


TURNS = ("right", "left", "right")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"elapsed_s": (0.0, 2.0, 1.0)}, r"elapsed_s 1.0 is before the 2.0 of stage 2"),
        (
            {"objects": (0, 0, 2), "elapsed_s": (1.0, 2.0, 5.0)},
            "stage 2: robot 'right' begins with object 0, which robot 'left' is at since",
        ),
        (
            {"objects": (0, 0, 1), "robots": TURNS, "elapsed_s": (2.0, 3.0, 5.0)},
            "stage 2: robot 'left' begins with object 0",
        ),
        ({"robots": ("left", None, "left")}, "robot is null"),
    ],
)
def test_clocks_that_fall_two_at_one_object_and_stages_of_nobody_are_refused(given, message):
    with pytest.raises(LogError, match=message):
        log_of_robots(**given)


@pytest.mark.parametrize(
    "given",
    [
        # At 2 s both are free; left decides first, and takes what right has just let go of.
        {"objects": (0, 0, 1), "robots": TURNS, "elapsed_s": (2.0, 2.0, 5.0)},
        {"objects": (0, 1, 1), "robots": ("left", "right", "right")},
        {"objects": (0, 1, 0), "robots": ("left", "left", "right")},
    ],
)
def test_one_after_the_other_is_well(given):
    assert log_of_robots(**given).num_paths == 1
