"""Each rule of a log is broken, in memory and on disk; the message is what the page of rules promises."""

import csv
import json
import re
from contextlib import suppress
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

from halfseen.cli import halfseen
from halfseen.errors import LogError
from halfseen.learning import NamedActions
from halfseen.logs import Logs, read_logs
from halfseen.logs.frames import as_frame
from halfseen.tables import TableTask
from refusals import refused
from small_logs import log_of
from valid_logs import small_tables

RULES = (Path(__file__).parents[2] / "docs" / "reference" / "log-rules.csv").read_text(encoding="utf-8")
MESSAGES = {row["id"]: row["message"].strip("`") for row in csv.DictReader(RULES.splitlines())}
PATTERNS = {rule: ".*".join(re.escape(part) for part in message.split("…")) for rule, message in MESSAGES.items()}
HORIZON = 4
TASKS = {
    "T": TableTask(),
    "A": NamedActions({1: ["LIFT", "WASH"], 2: ["FINISH", "WASH"], 3: ["FINISH"], 4: ["FINISH"]}, ["steps_to_go"]),
}


def tables():
    """Trajectory 1 finished, 2 was cut in its second stage with the mug washed, 3 in its first."""
    frames = small_tables()
    frames["objects"] = frames["objects"].assign(
        location=[*["TABLE"] * 7, "DISHWASHER", "TABLE", "TABLE"],
        occlusion=[0.0, 0.4] * 5,
        log_odds=np.linspace(-1.0, 1.0, 10),
        lifts=[0, 0, 1, 0, 0, 0, 0, 0, 0, 0],
        hidden_by=[[0.0, 0.0], [0.4, 0.0]] * 5,
        attempt_occlusions=[[], [], [0.0], [], [], [], [], [0.4], [], []],
        attempt_succeeded=[[], [], [True], [], [], [], [], [True], [], []],
    )
    return frames


def flat_tables():
    frames = tables()
    del frames["objects"]
    return frames | {"stages": frames["stages"].drop(columns="object")}


# What breaks a log.


def put(table, column, row, value):
    """Break one cell, or a whole column."""

    def broken(frames):
        values = frames[table][column].tolist()
        values[row] = value
        frames[table][column] = values

    return broken


stages, trajectories, objects = (partial(put, name) for name in ("stages", "trajectories", "objects"))
EVERY = slice(None)


def rows(table, kept):
    """Keep these rows."""
    return lambda frames: frames.update({table: frames[table].iloc[kept]})


def renamed(table, column, name):
    return lambda frames: frames.update({table: frames[table].rename(columns={column: name})})


def extra(table, column, value=0.5):
    return lambda frames: frames[table].insert(0, column, value)


def both(*breaks):
    return lambda frames: [each(frames) for each in breaks]


def longer(frames):
    """Add a trajectory of more stages than the horizon."""
    stage = {"trajectory": 4, "action": "LIFT", "object": "cup", "reward": 0.0, "probability": 1.0, "steps_to_go": 5}
    added = {
        "trajectories": [pd.DataFrame([{"trajectory": 4, "end_s": 9.0, "ending": "finished"}])],
        "stages": [pd.DataFrame([{**stage, "stage": k, "elapsed_s": float(k)} for k in range(1, HORIZON + 2)])],
        "objects": [frames["objects"].iloc[:2].assign(trajectory=4, stage=k) for k in range(1, HORIZON + 2)],
    }
    frames.update({name: pd.concat([frames[name], *parts]) for name, parts in added.items()})


class File:
    """Breaks the bytes of a file after all was written; None takes it away."""

    def __init__(self, name, content):
        self._name, self._content = name, content

    def __call__(self, folder):
        file = folder / self._name
        if self._content is None:
            file.unlink()
        else:
            file.write_bytes(self._content(file.read_bytes()))


def manifest(**changes):
    return File("logs.json", lambda old: json.dumps(json.loads(old) | changes).encode())


def whole(name, content):
    return File(name, lambda old: content)


COUNTED = {"stages": 5, "trajectories": 3, "objects": 10}
BREAKS = {
    "F02": [File("logs.json", None)],
    "F03": [*(whole("logs.json", content) for content in (b'{"format": "halfseen', b"", b"\xff\xfe", b"{"))],
    "F04": [manifest(format="other"), whole("logs.json", b"[]")],
    "F05": [(manifest(version=3), "version 3 is not the 2 that this"), (manifest(version=None), "version None is not")],
    "F06": [
        *(manifest(rows=counted) for counted in (None, 7, {"stages": 5}, COUNTED | {"../x": 1})),
        *(manifest(rows=COUNTED | odd) for odd in ({"stages": "5"}, {"stages": -1})),
        manifest(rows=COUNTED | {"stages": 5e9, "trajectories": []}),
    ],
    "F07": [File("trajectories.parquet", None), File("objects.parquet", None)],
    "F08": [
        *(File("stages.parquet", lambda old, size=size: old[:size]) for size in (0, 3, 100, -1, -9)),
        File("trajectories.parquet", lambda old: old[: len(old) // 2]),
        whole("objects.parquet", b"not Parquet at all"),
    ],
    "F09": [(manifest(rows=COUNTED | {"stages": 6}), r"stages\.parquet: it has 5 rows where logs\.json counts 6")],
    "F10": [*(manifest(reward_unit=unit) for unit in (" ", "two\nlines", "x" * 25))],
    "C01": [
        *(
            (renamed(table, name, name + "x"), f"^{table}: there is no column '{name}' among .*; rename '{name}x'\\?$")
            for table, names in (("stages", ("trajectory", "stage", "elapsed_s", "action", "reward")),
                                 ("trajectories", ("trajectory", "end_s", "ending")),
                                 ("objects", ("trajectory", "stage", "object")))
            for name in names
        ),
        (renamed("stages", "reward", "y"), r"no column 'reward' among trajectory, stage, .*; add it"),
    ],
    "C02": [renamed("stages", "steps_to_go", "reward"), renamed("trajectories", "cause", "trajectory")],
    "C03": [extra("stages", "Reward"), renamed("stages", "probability", "Probability "), extra("objects", "OBJECT")],
    "C04": [extra("stages", "ending", "cut"), extra("trajectories", "reward"), extra("objects", "probability")],
    "C05": [
        (stages("elapsed_s", EVERY, ["1.5 s", "4 s", "2 s", None, None]), "column 'elapsed_s' holds string, not"),
        stages("elapsed_s", EVERY, pd.to_datetime([15, 40, 20, None, None], unit="s")),
        stages("reward", EVERY, [True] * 5),
        trajectories("end_s", EVERY, ["4", "3", "1"]),
    ],
    "C06": [(trajectories("trajectory", 1, 2.5), "trajectories, row 1: trajectory 2.5 is not a valid name"),
            stages("action", EVERY, [0.5, 1, 1, 1, 1])],
    "C07": [
        (stages("action", EVERY, [{"a": 1}] * 5), "column 'action' holds mixed, not"),
        (stages("action", EVERY, [b"x"] * 5), "column 'action' holds bytes, not"),
        stages("action", EVERY, [[0.1, 0.2]] * 5),
        stages("action", EVERY, [True, False, True, True, None]),
        trajectories("cause", EVERY, pd.to_datetime([None, "2024-05-01", "2024-05-02"])),
    ],
    "C08": [(stages("trajectory", 1, None), "stages, row 1: trajectory"), trajectories("trajectory", 0, None),
            objects("object", 3, None)],
    "C09": [
        stages("steps_to_go", 0, np.inf),
        (objects("occlusion", 4, np.nan), "trajectory 2, stage 1, object 'cup': covariate occlusion is null"),
        (objects("hidden_by", 7, [0.1, np.nan]), "object 'mug': covariate hidden_by is array"),
        (objects("hidden_by", 7, None), "trajectory 2, stage 2, object 'mug': covariate hidden_by is null"),
        objects("hidden_by", 3, [-np.inf, 0.0]),
    ],
    "C10": [(stages("steps_to_go", 4, None), r"trajectory 3, stage 1: covariate steps_to_go is null, as in 1 of 5 ")],
    "P01": [lambda frames: frames.update({name: frame[:0] for name, frame in frames.items()})],
    "P02": [(rows("trajectories", [0, 1, 2, 1]), "trajectory 2:")],
    "P03": [*((trajectories("end_s", 0, value), f"trajectory 1: end_s {value} is") for value in (0.0, -1.0, np.inf)),
            (trajectories("end_s", 1, None), "trajectory 2: end_s nan is")],
    "P04": [trajectories("end_s", 1, 1.7e9)],
    "P05": [*((trajectories("ending", 1, value), f"trajectory 2: ending {message} is")
              for value, message in (("done", "'done'"), ("Cut", "'Cut'"), (None, "null")))],
    "P06": [(trajectories("cause", 0, "battery"), "trajectory 1: .* 'battery'")],
    "P07": [(rows("stages", [0, 1, 2, 3]), "trajectory 3: .*even a trajectory cut in its first"), rows("stages", [])],
    "S01": [(rows("trajectories", [0, 1]), "trajectory 3, stage 1:"), (stages("trajectory", EVERY, list("11223")),
            "trajectory '1', stage 1:")],
    "S02": [*((stages("stage", 1, value), f"stages, row 1, trajectory 1: stage {message} is")
              for value, message in ((1.5, "1.5"), (None, "nan"), (np.inf, "inf")))],
    "S03": [(rows("stages", [0, 1, 2, 3, 4, 2]), "trajectory 2, stage 1:")],
    "S04": [
        (stages("stage", 1, 3), "trajectory 1, stage 3: stage 2 is missing"),
        (stages("stage", 0, 0), "trajectory 1, stage 0: stage 1 is missing"),
        rows("stages", [1, 2, 3, 4]),
    ],
    "S05": [*((stages("elapsed_s", row, None), f"trajectory {at}:")
            for row, at in ((1, "1, stage 2"), (2, "2, stage 1")))],
    "S06": [(stages("elapsed_s", 3, 3.0), "trajectory 2, stage 2: elapsed_s 3.0")],
    "S07": [*((stages("elapsed_s", 0, value), f"trajectory 1, stage 1: elapsed_s {value}")
            for value in (0.0, -1.0, np.inf))],
    "S08": [
        (stages("elapsed_s", 1, 1.2), "trajectory 1, stage 2: elapsed_s 1.2 is before the 1.5 of stage 1"),
        (stages("elapsed_s", 1, 1.5), "trajectory 1, stage 2: elapsed_s 1.5 is also the 1.5 of stage 1"),
        # The place is named in whatever order rows stand.
        *((both(stages("elapsed_s", 1, 1.2), lambda frames, name=name: frames.update({name: frames[name][::-1]})),
           "trajectory 1, stage 2: elapsed_s 1.2") for name in ("stages", "trajectories")),
    ],
    "S09": [
        (stages("elapsed_s", 2, 3.6), "trajectory 2, stage 1: elapsed_s 3.6 is after the trajectory's end_s 3.5"),
        stages("elapsed_s", 2, 2000.0),
        trajectories("end_s", 1, 1.9),
    ],
    "S10": [trajectories("end_s", 0, 4000.0), trajectories("end_s", 0, 4e6)],
    "S11": [(stages("action", 0, None), "trajectory 1, stage 1:")],
    "S12": [*((stages("reward", 1, value), f"trajectory 1, stage 2: .* {message};")
              for value, message in ((None, "nan"), (np.inf, "inf")))],
    "S13": [(stages("reward", 3, 1.0), "trajectory 2, stage 2: reward 1.0")],
    "S15": [(stages("reward", 1, -1e155), "trajectory 1, stage 2: reward -1e[+]155")],
    "S14": [*((stages("probability", row, value), f"trajectory {at}: probability {message}")
              for row, value, at, message in (
               (0, 0.0, "1, stage 1", "0.0"), (3, 1.1, "2, stage 2", "1.1"), (2, None, "2, stage 1", "nan"),
               (3, -0.5, "2, stage 2", "-0.5")))],
    "O01": [(objects("trajectory", 0, 9), "trajectory 9, stage 1, object 'cup'")],
    "O02": [(objects("stage", 9, 2), "trajectory 3, .* 'mug': the trajectory has stages 1 to 1"),
            objects("stage", 0, 0)],
    "O03": [(objects("object", 3, "cup"), "trajectory 1, stage 2, object 'cup'")],
    "O04": [(rows("objects", []), "trajectory 1, stage 1"), (rows("objects", [0, 1, *range(4, 10)]),
            "trajectory 1, stage 2")],
    "O05": [
        (stages("object", 2, "jug"), r"trajectory 2, stage 1: object 'jug' .* \('cup', 'mug'\)"),
        (rows("objects", [0, 1, 2, 3, 4, 6, 7, 8, 9]), r"trajectory 2, stage 1: object 'mug' .* \('cup'\)"),
    ],
    "T01": [lambda frames: frames.pop("objects")],
    "T02": [renamed("objects", "lifts", "grips"), renamed("objects", "hidden_by", "x")],
    "T03": [longer],
    "T04": [both(stages("action", 0, "FINISH"), stages("object", 0, None))],
    "T05": [objects("location", 0, "SINK"), objects("location", 0, None)],
    "T06": [rows("objects", [0, 1, 3, *range(4, 10)])],
    "T07": [objects("object", 3, "jug")],
    "T08": [stages("object", 3, "mug")],
    "T09": [objects("location", 1, "DISHWASHER")],
    "T10": [objects("occlusion", 1, value) for value in (-0.1, 1.1, 40.0)],
    "T11": [objects("lifts", 2, value) for value in (-1, 0.5)],
    "T12": [objects("hidden_by", EVERY, [0.4] * 10), objects("attempt_succeeded", EVERY, [["yes"]] * 10)],
    "T13": [objects("attempt_succeeded", 2, [None]), objects("attempt_succeeded", 2, None)],
    "T14": [objects("hidden_by", 1, value) for value in ([0.4], [0.4, 0.0, 0.0], [])],
    "T15": [objects("hidden_by", 1, [40.0, 0.0]), objects("hidden_by", 1, [-0.4, 0.0])],
    "T16": [objects("hidden_by", 1, [0.4, 0.1])],
    "T17": [objects("attempt_occlusions", 0, [0.5]), objects("attempt_succeeded", 2, [])],
    "T18": [objects("attempt_occlusions", 2, [1.5])],
    "T19": [objects("attempt_succeeded", EVERY, [[], [], [2], [], [], [], [], [1], [], []])],
    "T20": [both(objects("attempt_occlusions", 2, [0.0] * 5), objects("attempt_succeeded", 2, [True] * 5))],
    "T21": [both(stages("action", 0, "DROP"), stages("object", 0, None))],
    "A01": [both(stages("action", 0, "DROP"), stages("action", 1, "LIFT"))],
}  # fmt: skip
"""By rule: what breaks it alone, in a log that is otherwise sound, and what is said beside what the page promises."""


def written(folder, frames):
    """Write tables as they are, unchecked."""
    folder.mkdir()
    counts = {name: len(frame) for name, frame in frames.items()}
    (folder / "logs.json").write_text(json.dumps({"format": "halfseen-logs", "version": 2, "rows": counts}))
    for name, frame in frames.items():
        columns = [pa.array(frame.iloc[:, k], from_pandas=True) for k in range(frame.shape[1])]
        pq.write_table(pa.Table.from_arrays(columns, names=list(frame.columns)), folder / f"{name}.parquet")
    return folder


def content(folder):
    return {each.name: each.read_bytes() for each in sorted(folder.iterdir())}


def checked(logs, rule):
    """What is checked of a log, and of what learns from it."""
    if rule[0] in TASKS:
        TASKS[rule[0]].encode(logs, HORIZON)
    return logs


def check_on_disk(folder, rule, message=""):
    before = content(folder)
    with refused(rf"^(.*: )?{PATTERNS[rule]}", LogError) as caught:
        checked(read_logs(folder), rule)
    assert re.search(message, str(caught.value))
    assert content(folder) == before


def check_of_tables(folder, frames, rule, message):
    with refused(f"^{PATTERNS[rule]}", LogError) as caught:
        checked(Logs(**frames), rule)
    assert re.search(message, str(caught.value))
    # How values come from files matters to columns; what is said of them does not differ.
    if rule[0] == "C" or folder.name == "0":
        check_on_disk(written(folder, frames), rule)


@pytest.mark.parametrize("rule", BREAKS)
def test_a_broken_rule_is_reported_in_one_line_and_nothing_is_lost(rule, tmp_path):
    for number, case in enumerate(BREAKS[rule]):
        break_it, result = case if isinstance(case, tuple) else (case, "")
        if isinstance(break_it, File):
            folder = written(tmp_path / str(number), tables())
            break_it(folder)
            check_on_disk(folder, rule, result)
            continue
        frames = tables()
        break_it(frames)
        check_of_tables(tmp_path / str(number), frames, rule, result)
        frames = flat_tables()
        if rule[0] in "CPS":
            with suppress(KeyError):  # where it is of objects
                break_it(frames)
                check_of_tables(tmp_path / f"{number}-flat", frames, rule, result)


def test_the_page_tells_of_every_rule_and_the_unbroken_logs_break_none(tmp_path):
    assert set(MESSAGES) == {*BREAKS, "F01"}
    assert len(MESSAGES) == len(RULES.splitlines()) - 1
    for name, frames in (("tables", tables()), ("flat", flat_tables())):
        folder = written(tmp_path / name, frames)
        for logs in (Logs(**frames), read_logs(folder)):
            for rule in "FTA" if name == "tables" else "F":
                assert checked(logs, rule).num_trajectories == 3
    with refused(f"^{PATTERNS['F01']}", LogError):
        read_logs(tmp_path / "none")


def test_what_a_file_says_that_is_whole_and_wrong_is_reported_with_the_folder(tmp_path):
    folder = written(tmp_path / "logs", tables())
    pages = (folder / "stages.parquet").read_bytes()
    (folder / "stages.parquet").write_bytes(pages[:4] + bytes(196) + pages[200:])
    with refused(r"^\S*stages\.parquet: ", LogError):
        read_logs(folder)
    frames = tables()
    stages("elapsed_s", 1, 1.0)(frames)
    with refused(r"^\S*late: trajectory 1, stage 2: elapsed_s 1.0 is before", LogError):
        read_logs(written(tmp_path / "late", frames))
    # On the command line, too.
    result = CliRunner().invoke(halfseen, ["inspect", str(tmp_path / "late")])
    assert isinstance(result.exception, LogError)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"trajectory": [1, 2], "end_s": [1.0]}, "trajectories: not a table"),
        ({"trajectory": np.ones((2, 2))}, "trajectories: not a table"),
        (
            pd.DataFrame([[1, 2]], columns=["trajectory", "trajectory"]),
            "trajectories: there are two columns 'trajectory'",
        ),
        (pd.DataFrame([[1]]), "trajectories: column 0 has a name that is not text"),
        ({"trajectory": [1, "a"]}, "trajectories: a column cannot be stored .*trajectory.*give each column one type"),
        (3, r"trajectories: not a table \(it is a int\)"),
    ],
)
def test_what_is_no_table_is_refused(table, message):
    with refused(message, LogError):
        as_frame("trajectories", table)


# Logs of several robots: a clock that may stand, and no two at one object.

TURNS = ("right", "left", "right")


def log_of_robots(objects=(0, 1, 2), robots=("left", "right", "left"), elapsed_s=(0.0, 2.0, 5.0), **does):
    robots = {} if robots is None else {"robot": robots}
    return log_of(stage=range(1, 4), elapsed_s=elapsed_s, object=objects, **robots, **does)


def test_a_clock_may_stand_where_two_robots_are_free_at_once(tmp_path):
    logs = log_of_robots()
    assert logs.elapsed_s().tolist() == [[0.0, 2.0, 5.0]]
    assert "robot" not in logs.stage_covariates
    logs.write(tmp_path / "log")
    assert read_logs(tmp_path / "log").stages["robot"].tolist() == ["left", "right", "left"]
    for given in (
        # At 2 s both are free; left decides first, and takes what right has just let go of.
        {"objects": (0, 0, 1), "robots": TURNS, "elapsed_s": (2.0, 2.0, 5.0)},
        # By a clock that nobody stops right decides a moment later.
        {"objects": (0, 0, 1), "robots": TURNS, "elapsed_s": (2.0, 2.01, 5.0), "right_does": "FREE"},
        {"objects": (0, 1, 1), "robots": ("left", "right", "right")},
        {"objects": (0, 1, 0), "robots": ("left", "left", "right")},
    ):
        assert log_of_robots(**given).num_trajectories == 1


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"robots": None}, r"elapsed_s 0.0 is not a time after the trajectory's beginning"),
        ({"elapsed_s": (0.0, 2.0, 1.0)}, r"elapsed_s 1.0 is before the 2.0 of stage 2"),
        ({"objects": (0, 0, 2), "elapsed_s": (1.0, 2.0, 5.0)},
         "stage 2: robot 'right' starts on object 0, on which robot 'left' has worked since"),
        ({"objects": (0, 0, 1), "robots": TURNS, "elapsed_s": (2.0, 3.0, 5.0)},
         "stage 2: robot 'left' starts on object 0"),
        ({"objects": (0, 0, 1), "robots": TURNS, "elapsed_s": (2.0, 2.01, 5.0), "right_does": "WASH 0"},
         "stage 2: robot 'left' starts on object 0"),
        ({"robots": ("left", None, "left")}, "robot is null"),
    ],
)  # fmt: skip
def test_clocks_that_fall_two_at_one_object_and_stages_of_nobody_are_refused(given, message):
    with refused(message, LogError):
        log_of_robots(**given)
