"""Each invariant is broken alone, in a log that is otherwise sound."""

import numpy as np
import pandas as pd
import pytest
from valid_logs import small_tables

from halfseen.errors import LogError
from halfseen.logs import Logs
from halfseen.logs.frames import as_frame


def put(table, column, row, value):
    """Break one cell."""

    def break_it(tables):
        values = tables[table][column].tolist()
        values[row] = value
        tables[table][column] = values

    return break_it


def drop(table, row):
    """Take one row away."""

    def break_it(tables):
        tables[table] = tables[table].drop(index=row)

    return break_it


def double(table, row):
    """Give one row twice."""

    def break_it(tables):
        tables[table] = tables[table].iloc[[*range(len(tables[table])), row]]

    return break_it


BREAKS = {
    "path without a stage": (drop("stages", 4), "path 3: it has no stage; even a path cut in its first"),
    "stages of an unknown path": (drop("paths", 2), "path 3, stage 1: paths has no such path; add its row"),
    "text is not a number": (
        put("stages", "path", slice(None), list("11223")),
        "path '1', stage 1: paths has no such path",
    ),
    "path twice": (double("paths", 1), "path 2: it is in paths twice"),
    "path null": (put("stages", "path", 1, None), "stages, row 1: path is null"),
    "path a fraction": (put("paths", "path", 1, 2.5), "paths, row 1: path 2.5 is no name"),
    "stage twice": (double("stages", 2), "path 2, stage 1: the stage is there twice"),
    "stage missing": (put("stages", "stage", 1, 3), "path 1, stage 3: stage 2 is missing before it; number the stages"),
    "stage from zero": (put("stages", "stage", 0, 0), "path 1, stage 0: stage 1 is missing before it"),
    "stage a fraction": (put("stages", "stage", 1, 1.5), "stages, row 1, path 1: stage 1.5 is no whole number"),
    "stage null": (put("stages", "stage", 1, None), "stages, row 1, path 1: stage nan is no whole number"),
    "clock goes back": (
        put("stages", "elapsed_s", 1, 1.2),
        "path 1, stage 2: elapsed_s 1.2 is before the 1.5 of stage 1; sort the stages or fix the clock",
    ),
    "clock stands": (put("stages", "elapsed_s", 1, 1.5), "path 1, stage 2: elapsed_s 1.5 is also the 1.5 of stage 1"),
    "clock starts at zero": (put("stages", "elapsed_s", 0, 0.0), "path 1, stage 1: elapsed_s 0.0 is no time after"),
    "clock infinite": (put("stages", "elapsed_s", 1, np.inf), "path 1, stage 2: elapsed_s inf is no time after"),
    "clock beyond the end": (
        put("stages", "elapsed_s", 2, 3.6),
        "path 2, stage 1: elapsed_s 3.6 is after the path's end_s 3.5",
    ),
    "finished, not completed": (
        put("stages", "elapsed_s", 1, None),
        "path 1, stage 2: elapsed_s is null, yet only the last stage of a cut path is not completed",
    ),
    "cut, early stage not completed": (
        put("stages", "elapsed_s", 2, None),
        "path 2, stage 1: elapsed_s is null, yet only",
    ),
    "cut, all completed": (
        put("stages", "elapsed_s", 3, 3.0),
        "path 2, stage 2: elapsed_s 3.0 completes the last stage of a cut path; add the stage in which the cut fell",
    ),
    "action null": (
        put("stages", "action", 0, None),
        "path 1, stage 1: the stage is completed, yet its action is null",
    ),
    "reward null": (put("stages", "reward", 1, None), "path 1, stage 2: the stage is completed, yet its reward is nan"),
    "reward infinite": (
        put("stages", "reward", 1, np.inf),
        "path 1, stage 2: the stage is completed, yet its reward is inf",
    ),
    "reward too early": (
        put("stages", "reward", 3, 1.0),
        "path 2, stage 2: reward 1.0 is given, yet the stage was not",
    ),
    "reward text": (
        put("stages", "reward", slice(None), ["1"] * 5),
        "stages: column 'reward' holds string, not numbers",
    ),
    "probability zero": (put("stages", "probability", 0, 0.0), "path 1, stage 1: probability 0.0 of the logged action"),
    "probability above one": (
        put("stages", "probability", 3, 1.1),
        "path 2, stage 2: probability 1.1 of the logged action",
    ),
    "probability null": (
        put("stages", "probability", 2, None),
        "path 2, stage 1: probability nan of the logged action",
    ),
    "covariate null": (
        put("stages", "steps_to_go", 4, None),
        "path 3, stage 1: covariate steps_to_go is null; give the number",
    ),
    "end zero": (put("paths", "end_s", 0, 0.0), "path 1: end_s 0.0 is no end"),
    "end null": (put("paths", "end_s", 1, None), "path 2: end_s nan is no end"),
    "end infinite": (put("paths", "end_s", 1, np.inf), "path 2: end_s inf is no end"),
    "ending unknown": (put("paths", "ending", 1, "done"), "path 2: ending 'done' is unknown; say 'finished'"),
    "ending null": (put("paths", "ending", 0, None), "path 1: ending null is unknown"),
    "cause of a finish": (put("paths", "cause", 0, "battery"), "path 1: it finished, yet has the cause 'battery'"),
    "object of an unknown path": (
        put("objects", "path", 0, 9),
        "path 9, stage 1, object 'cup': paths has no such path",
    ),
    "object of an unknown stage": (
        put("objects", "stage", 9, 2),
        "path 3, stage 2, object 'mug': the path has stages 1 to 1; add the stage",
    ),
    "object twice": (put("objects", "object", 3, "cup"), "path 1, stage 2, object 'cup': the object is there twice"),
    "object null": (put("objects", "object", 3, None), "objects, row 3: object is null"),
    "object acted on is not there": (
        put("stages", "object", 2, "jug"),
        r"path 2, stage 1: object 'jug' of the action is not among the objects of that stage ('cup', 'mug')",
    ),
    "object acted on is gone": (
        drop("objects", 5),
        "path 2, stage 1: object 'mug' of the action is not among the objects of that stage ('cup')",
    ),
    "stage without objects": (drop("objects", [2, 3]), "path 1, stage 2: it has no row in objects"),
    "object's covariate null": (
        put("objects", "occlusion", 4, np.nan),
        "path 2, stage 1, object 'cup': covariate occlusion is null",
    ),
    "NaN in a list": (
        put("objects", "hidden_by", 7, [0.1, np.nan]),
        "path 2, stage 2, object 'mug': covariate hidden_by is array([0.1, nan])",
    ),
    "list null": (put("objects", "hidden_by", 7, None), "path 2, stage 2, object 'mug': covariate hidden_by is null"),
}


def test_the_unbroken_log_is_sound():
    assert Logs(**small_tables()).num_paths == 3


@pytest.mark.parametrize("name", BREAKS)
def test_broken_invariant_is_named_with_place_value_and_remedy(name):
    break_it, message = BREAKS[name]
    tables = small_tables()
    break_it(tables)
    with pytest.raises(LogError) as refusal:
        Logs(**tables)
    assert str(refusal.value).startswith(message)
    assert len(str(refusal.value).splitlines()) == 1


@pytest.mark.parametrize("table", ["stages", "paths", "objects"])
def test_rows_out_of_order_are_no_fault_but_the_broken_place_is_still_named(table):
    tables = small_tables()
    put("stages", "elapsed_s", 1, 1.2)(tables)
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


def test_objects_without_rows_are_refused():
    tables = small_tables()
    tables["objects"] = tables["objects"][:0]
    with pytest.raises(LogError, match="path 1, stage 1: it has no row in objects"):
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
