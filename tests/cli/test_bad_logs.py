"""Each rule of the guide's page on logs is broken on disk; the message is the one that the page promises."""

import json
import re
import sys
from pathlib import Path
from types import SimpleNamespace

import click
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from halfseen import cli
from halfseen.learning import NamedActions
from halfseen.logs import Logs, read_logs
from halfseen.tables import TableTask

PAGE = Path(__file__).parents[2] / "docs" / "guide" / "logs.md"
MESSAGES = dict(
    re.findall(r"^\| ([A-Z]\d\d) \| .* \| `(.*)` \|$", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE)
)
HORIZON = 4


def tables():
    """Path 1 finished, path 2 was cut in its second stage with the mug washed, path 3 in its first."""
    stages = pd.DataFrame(
        {
            "path": [1, 1, 2, 2, 3],
            "stage": [1, 2, 1, 2, 1],
            "elapsed_s": [1.5, 4.0, 2.0, np.nan, np.nan],
            "action": ["LIFT", "FINISH", "WASH", "WASH", None],
            "object": ["cup", None, "mug", "cup", None],
            "reward": [-0.1, -5.0, 5.0, np.nan, np.nan],
            "probability": [0.5, 1.0, 0.25, 0.25, np.nan],
            "light": [0.5, 0.4, 0.3, 0.2, 0.1],
        }
    )
    paths = pd.DataFrame(
        {
            "path": [1, 2, 3],
            "end_s": [4.0, 3.5, 0.5],
            "ending": ["finished", "cut", "cut"],
            "cause": [None, "battery", "operator"],
        }
    )
    objects = pd.DataFrame(
        {
            "path": np.repeat([1, 1, 2, 2, 3], 2),
            "stage": np.repeat([1, 2, 1, 2, 1], 2),
            "object": ["cup", "mug"] * 5,
            "location": [*["TABLE"] * 7, "DISHWASHER", "TABLE", "TABLE"],
            "occlusion": [0.0, 0.4] * 5,
            "log_odds": np.linspace(-1.0, 1.0, 10),
            "lifts": [0, 0, 1, 0, 0, 0, 0, 0, 0, 0],
            "hidden_by": [[0.0, 0.0], [0.4, 0.0]] * 5,
            "attempt_occlusions": [[], [], [0.0], [], [], [], [], [0.4], [], []],
            "attempt_succeeded": [[], [], [True], [], [], [], [], [True], [], []],
        }
    )
    return {"stages": stages, "paths": paths, "objects": objects}


def put(table, column, row, value):
    """Break one cell, or a whole column."""

    def broken(frames):
        values = frames[table][column].tolist()
        values[row] = value
        frames[table][column] = values

    return broken


def rows(table, kept):
    """Keep these rows."""

    def broken(frames):
        frames[table] = frames[table].iloc[kept]

    return broken


def renamed(table, column, name):
    def broken(frames):
        frames[table] = frames[table].rename(columns={column: name})

    return broken


def extra(table, column, value=0.5):
    def broken(frames):
        frames[table][column] = value

    return broken


def both(*breaks):
    def broken(frames):
        for each in breaks:
            each(frames)

    return broken


def longer(frames):
    """Add a path of more stages than the horizon."""
    path = {"path": 4, "end_s": 9.0, "ending": "finished"}
    stage = {"path": 4, "action": "LIFT", "object": "cup", "reward": 0.0, "probability": 1.0, "light": 0.5}
    stages = [{**stage, "stage": number, "elapsed_s": float(number)} for number in range(1, HORIZON + 2)]
    objects = [frames["objects"].iloc[:2].assign(path=4, stage=number) for number in range(1, HORIZON + 2)]
    frames["paths"] = pd.concat([frames["paths"], pd.DataFrame([path])])
    frames["stages"] = pd.concat([frames["stages"], pd.DataFrame(stages)])
    frames["objects"] = pd.concat([frames["objects"], *objects])


def without(table):
    def broken(frames):
        del frames[table]

    return broken


def file(name, content):
    """Break the bytes of a file after all was written; None takes it away."""

    def broken(folder):
        target = folder / name
        if content is None:
            target.unlink()
        else:
            target.write_bytes(content(target.read_bytes()))

    broken.is_on_disk = True
    return broken


def manifest(**changes):
    return file("logs.json", lambda old: json.dumps(json.loads(old) | changes).encode())


EVERYTHING = slice(None)
BREAKS = {
    "F02": [file("logs.json", None)],
    "F03": [
        file("logs.json", lambda old: old[:20]),
        file("logs.json", lambda old: b""),
        file("logs.json", lambda old: b"\xff"),
    ],
    "F04": [manifest(format="other"), file("logs.json", lambda old: b"[]")],
    "F05": [manifest(version=99)],
    "F06": [manifest(rows={"stages": 5}), manifest(rows=7)],
    "F07": [file("paths.parquet", None), file("objects.parquet", None)],
    "F08": [
        file("stages.parquet", lambda old: old[:-9]),
        file("paths.parquet", lambda old: old[: len(old) // 2]),
        file("stages.parquet", lambda old: b""),
        file("objects.parquet", lambda old: b"not Parquet at all"),
    ],
    "F09": [manifest(rows={"stages": 6, "paths": 3, "objects": 10})],
    "F10": [manifest(reward_unit=" "), manifest(reward_unit="two\nlines"), manifest(reward_unit="x" * 25)],
    "C01": [
        *(renamed("stages", name, "x") for name in ("path", "stage", "elapsed_s", "action", "reward")),
        *(renamed("paths", name, "x") for name in ("path", "end_s", "ending")),
        *(renamed("objects", name, "x") for name in ("path", "stage", "object")),
    ],
    "C02": [renamed("stages", "light", "reward"), renamed("paths", "cause", "path")],
    "C03": [extra("stages", "Reward"), renamed("stages", "probability", "Probability "), extra("objects", "OBJECT")],
    "C04": [extra("stages", "ending", "cut"), extra("paths", "reward"), extra("objects", "probability")],
    "C05": [
        put("stages", "elapsed_s", EVERYTHING, ["1.5 s", "4 s", "2 s", None, None]),
        put("stages", "elapsed_s", EVERYTHING, pd.to_datetime([15, 40, 20, None, None], unit="s")),
        put("stages", "reward", EVERYTHING, [True] * 5),
        put("paths", "end_s", EVERYTHING, ["4", "3", "1"]),
    ],
    "C06": [put("paths", "path", 1, 2.5), put("stages", "action", EVERYTHING, [0.5, 1, 1, 1, 1])],
    "C07": [
        put("stages", "action", EVERYTHING, [[0.1, 0.2]] * 5),
        put("stages", "action", EVERYTHING, [True, False, True, True, None]),
        put("paths", "cause", EVERYTHING, pd.to_datetime([None, "2024-05-01", "2024-05-02"])),
    ],
    "C08": [put("stages", "path", 1, None), put("paths", "path", 0, None), put("objects", "object", 3, None)],
    "C09": [
        put("stages", "light", 4, None),
        put("stages", "light", 0, np.inf),
        put("objects", "occlusion", 0, np.nan),
        put("objects", "hidden_by", 3, [0.4, np.nan]),
        put("objects", "hidden_by", 3, [-np.inf, 0.0]),
    ],
    "P01": [both(*(rows(name, []) for name in ("paths", "stages", "objects")))],
    "P02": [rows("paths", [0, 1, 2, 1])],
    "P03": [put("paths", "end_s", 0, value) for value in (0.0, -1.0, None, np.inf)],
    "P04": [put("paths", "end_s", 1, 1.7e9)],
    "P05": [put("paths", "ending", 1, value) for value in ("done", "Cut", None)],
    "P06": [put("paths", "cause", 0, "battery")],
    "P07": [both(rows("stages", [0, 1, 2, 3]), rows("objects", range(8))), rows("stages", [])],
    "S01": [both(rows("paths", [0, 1]), rows("objects", range(8)))],
    "S02": [put("stages", "stage", 1, value) for value in (1.5, None, np.inf)],
    "S03": [rows("stages", [0, 1, 2, 2, 3, 4])],
    "S04": [put("stages", "stage", 1, 3), put("stages", "stage", 0, 0), rows("stages", [1, 2, 3, 4])],
    "S05": [put("stages", "elapsed_s", 1, None), put("stages", "elapsed_s", 2, None)],
    "S06": [put("stages", "elapsed_s", 3, 3.0)],
    "S07": [put("stages", "elapsed_s", 0, value) for value in (0.0, -1.0, np.inf)],
    "S08": [put("stages", "elapsed_s", 1, 1.2), put("stages", "elapsed_s", 1, 1.5)],
    "S09": [put("stages", "elapsed_s", 2, 3.6), put("stages", "elapsed_s", 2, 2000.0), put("paths", "end_s", 1, 1.9)],
    "S10": [put("paths", "end_s", 0, 4000.0), put("paths", "end_s", 0, 4e6)],
    "S11": [put("stages", "action", 0, None)],
    "S12": [put("stages", "reward", 1, None), put("stages", "reward", 1, np.inf)],
    "S13": [put("stages", "reward", 3, 1.0)],
    "S14": [
        put("stages", "probability", 0, 0.0),
        put("stages", "probability", 2, 1.1),
        put("stages", "probability", 2, None),
        put("stages", "probability", 3, -0.5),
    ],
    "O01": [put("objects", "path", 0, 9)],
    "O02": [put("objects", "stage", 9, 2), put("objects", "stage", 0, 0)],
    "O03": [put("objects", "object", 3, "cup")],
    "O04": [rows("objects", [0, 1, *range(4, 10)]), rows("objects", [])],
    "O05": [put("stages", "object", 2, "jug"), rows("objects", [0, 1, 2, 3, 4, 6, 7, 8, 9])],
    "T01": [without("objects")],
    "T02": [renamed("objects", "lifts", "grips"), renamed("objects", "hidden_by", "x")],
    "T03": [longer],
    "T04": [both(put("stages", "action", 0, "FINISH"), put("stages", "object", 0, None))],
    "T05": [put("objects", "location", 0, "SINK"), put("objects", "location", 0, None)],
    "T06": [rows("objects", [0, 1, 3, *range(4, 10)])],
    "T07": [put("objects", "object", 3, "jug")],
    "T08": [put("stages", "object", 3, "mug")],
    "T09": [put("objects", "location", 1, "DISHWASHER")],
    "T10": [put("objects", "occlusion", 1, value) for value in (-0.1, 1.1, 40.0)],
    "T11": [put("objects", "lifts", 2, value) for value in (-1, 0.5)],
    "T12": [
        put("objects", "hidden_by", EVERYTHING, [0.4] * 10),
        put("objects", "attempt_succeeded", EVERYTHING, [["yes"]] * 10),
    ],
    "T13": [put("objects", "attempt_succeeded", 2, [None]), put("objects", "attempt_succeeded", 2, None)],
    "T14": [put("objects", "hidden_by", 1, value) for value in ([0.4], [0.4, 0.0, 0.0], [])],
    "T15": [put("objects", "hidden_by", 1, [40.0, 0.0]), put("objects", "hidden_by", 1, [-0.4, 0.0])],
    "T16": [put("objects", "hidden_by", 1, [0.4, 0.1])],
    "T17": [put("objects", "attempt_occlusions", 0, [0.5]), put("objects", "attempt_succeeded", 2, [])],
    "T18": [put("objects", "attempt_occlusions", 2, [1.5])],
    "T19": [put("objects", "attempt_succeeded", EVERYTHING, [[], [], [2], [], [], [], [], [1], [], []])],
    "T20": [
        both(put("objects", "attempt_occlusions", 2, [0.0] * 5), put("objects", "attempt_succeeded", 2, [True] * 5))
    ],
    "T21": [put("stages", "action", 0, "DROP"), put("stages", "object", 0, None)],
    "A01": [put("stages", "action", 0, "DROP"), put("stages", "action", 1, "LIFT")],
}
CASES = [(rule, number) for rule, breaks in BREAKS.items() for number in range(len(breaks))]


def written(folder, frames):
    """Write tables as they are, unchecked."""
    folder.mkdir()
    counts = {name: len(frame) for name, frame in frames.items()}
    (folder / "logs.json").write_text(json.dumps({"format": "halfseen-logs", "version": 1, "rows": counts}))
    for name, frame in frames.items():
        columns = [pa.array(frame.iloc[:, k], from_pandas=True) for k in range(frame.shape[1])]
        pq.write_table(pa.Table.from_arrays(columns, names=list(frame.columns)), folder / f"{name}.parquet")
    return folder


def broken_folder(folder, frames, break_it):
    if getattr(break_it, "is_on_disk", False):
        break_it(written(folder, frames))
        return folder
    break_it(frames)
    return written(folder, frames)


def content(folder):
    return {each.name: each.read_bytes() for each in sorted(folder.iterdir())} if folder.exists() else None


def reading_verb(task):
    """A verb that learns no more of a log than what stands there: what is checked for a learner is checked here."""

    @click.command()
    @click.argument("folder")
    def encode(folder):
        task.encode(read_logs(folder), HORIZON)

    return encode


TASKS = {
    "T": TableTask(),
    "A": NamedActions({1: ["LIFT", "WASH"], 2: ["FINISH", "WASH"], 3: ["FINISH"], 4: ["FINISH"]}, ["light"]),
}


@pytest.fixture
def told(monkeypatch, typed):
    """Run the command line on a folder; give its exit status, standard output and standard error."""

    def run(folder, rule):
        if rule[0] not in TASKS:
            return typed("inspect", folder)
        monkeypatch.setitem(cli.VERBS, "encode", "Encode a log.")
        module = SimpleNamespace(encode=reading_verb(TASKS[rule[0]]))
        monkeypatch.setitem(sys.modules, "halfseen.cli.encode", module)
        return typed("encode", folder)

    return run


def assert_refused(told, folder, rule):
    before = content(folder)
    status, out, err = told(folder, rule)
    assert (status, out) == (2, "")
    assert len(err.splitlines()) == 1
    pattern = ".*".join(re.escape(part) for part in MESSAGES[rule].split("…"))
    assert re.search(f"^halfseen: (.*: )?{pattern}", err.strip()), err
    assert content(folder) == before


def test_every_rule_of_the_page_is_broken_here():
    assert set(MESSAGES) == {*BREAKS, "F01"}
    assert len(MESSAGES) == len(re.findall(r"^\| [A-Z]\d\d \|", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE))


@pytest.mark.parametrize("rule", ["F", "T", "A"])
def test_the_unbroken_log_breaks_no_rule(rule, tmp_path, told):
    status, _, err = told(written(tmp_path / "logs", tables()), rule)
    assert (status, err) == (0, "")
    assert Logs(**tables()).num_paths == 3


def test_no_folder_at_all(tmp_path, told):
    assert_refused(told, tmp_path / "logs", "F01")


@pytest.mark.parametrize(("rule", "number"), CASES)
def test_a_broken_rule_is_told_in_one_line_and_nothing_is_lost(rule, number, tmp_path, told):
    assert_refused(told, broken_folder(tmp_path / "logs", tables(), BREAKS[rule][number]), rule)


def flat_tables():
    frames = tables()
    del frames["objects"]
    frames["stages"] = frames["stages"].drop(columns="object")
    return frames


def needs_objects(break_it):
    try:
        break_it(flat_tables())
    except KeyError:
        return True
    return False


EVERY_LOGS = [case for case in CASES if case[0][0] in "CPS" and not needs_objects(BREAKS[case[0]][case[1]])]


@pytest.mark.parametrize(("rule", "number"), EVERY_LOGS)
def test_the_same_in_a_log_without_objects(rule, number, tmp_path, told):
    assert_refused(told, broken_folder(tmp_path / "logs", flat_tables(), BREAKS[rule][number]), rule)


def test_the_flat_log_breaks_no_rule(tmp_path, told):
    assert told(written(tmp_path / "logs", flat_tables()), "S")[::2] == (0, "")
