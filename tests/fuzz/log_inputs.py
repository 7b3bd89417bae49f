"""Logs of every form as small valid inputs, made by the project's own writers."""

import json
import os
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from fuzz.corpus import HEAVY, INSPECTED, LEARN, LOGS, MAPPED, ONE, seed
from fuzz.policy_inputs import NUM_COLUMNS, NUM_ROWS, table_cloud
from halfseen.logs import LogRecorder, Logs
from holes import holed_log
from small_logs import flat_log, table_log
from text_logs import text_log

OF_LEARNING = ("--json", "--streaming --json", "--censoring cox --q-function kernel --reg 0.1")
OF_SQL = "--stages 'SELECT * FROM stages' --trajectories 'SELECT * FROM trajectories'"


def parquet(folder: Path, log: Callable[[], Logs]) -> None:
    log().write(folder / "logs")


def csv(folder: Path, log: Callable[[], Logs]) -> None:
    from halfseen.logs.formats import write_csv

    write_csv(log(), folder / "logs")


FILLED = [f"inspect in/logs --missing {rules} --json" for rules in ("median+flag", "last", "x=last,*=median+flag")]
few_words = partial(text_log, 20)
for _name, _kind, _make, _log, _lines in (
    ("flat", LOGS, parquet, flat_log, INSPECTED),
    ("tables", LOGS, parquet, table_log, INSPECTED),
    ("text", LOGS, parquet, few_words, INSPECTED[:1]),
    ("holes", LOGS, parquet, partial(holed_log, 0.3, num_trajectories=20), FILLED),
    ("csv", LOGS, csv, partial(flat_log, 8), [f"convert in/logs {ONE}"]),
    ("csv-tables", LOGS, csv, partial(table_log, 6), [f"convert in/logs {ONE}"]),
    ("flat-learned", HEAVY, parquet, flat_log, [f"{LEARN} {more}" for more in OF_LEARNING]),
    ("text-learned", HEAVY, parquet, few_words, [f"{LEARN} --json"]),
    ("tables-learned", HEAVY, parquet, table_log, [f"{LEARN} --json"]),
):
    seed(_kind, *_lines, name=_name)(partial(_make, log=_log))


@seed(LOGS, "inspect in/logs --json", f"convert in/logs {ONE}", "convert in/logs in/more --out out")
def journal(folder: Path) -> None:
    rng = np.random.default_rng(0)
    with LogRecorder(folder / "logs") as recorder:
        for number in range(6):
            trajectory = recorder.begin_trajectory(number)
            for stage in range(1, 3):
                trajectory.begin_stage({"x1": rng.normal(), "x2": stage}, action="AB"[rng.integers(2)], probability=0.5)
                trajectory.complete_stage(rng.normal(), elapsed_s=1.5 * stage)
            trajectory.finish() if number % 2 else trajectory.cut("battery")
        recorder.begin_trajectory(6).begin_stage({"x1": 0.5, "x2": 1}, action="A", probability=0.5)
        shutil.copytree(folder / "logs", folder / "torn")
    (folder / "logs").rename(folder / "more")
    (folder / "torn").rename(folder / "logs")


def datasets_in(folder: Path) -> Any:
    """Minari's datasets are in this folder."""
    return patch.dict(os.environ, MINARI_DATASETS_PATH=str(folder))


@seed(LOGS, f"convert in/logs/flat-v0 {ONE}")
def minari(folder: Path) -> None:
    from halfseen.logs.formats import write_minari

    with datasets_in(folder):
        write_minari(flat_log(6), "logs/flat-v0")


@seed(LOGS, f"convert in/hand-v0 {ONE}", f"convert in/hand-v0 --clock t {ONE}")
def minari_foreign(folder: Path) -> None:
    from foreign import LAST, NO, write_minari_episodes

    with datasets_in(folder):
        write_minari_episodes("hand-v0", [(LAST, NO), (NO, LAST)])


def bag(folder: Path, storage: str, with_cloud: bool = False) -> None:
    from bags import WITHOUT_CLOUD, cloud, two_trajectories, write_bag
    from halfseen.logs.formats import MAPPING_TEMPLATE

    messages = two_trajectories()
    if with_cloud:
        points = table_cloud(False).points_m
        messages += [cloud(at, "/camera/points", points, (NUM_ROWS, NUM_COLUMNS)) for at in (1.2, 3.2, 11.3, 13.6)]
    (folder / "cell.toml").write_text(MAPPING_TEMPLATE if with_cloud else WITHOUT_CLOUD)
    write_bag(folder / "bag", sorted(messages, key=lambda one: one[0]), storage)


for _name, _storage, _with_cloud in (
    ("mcap", "mcap", False),
    ("db3", "sqlite3", False),
    ("bag-of-clouds", "mcap", True),
):
    _line = f"convert in/bag {MAPPED}{' --clouds out-clouds' if _with_cloud else ''} --json"
    seed(LOGS, _line, name=_name)(partial(bag, storage=_storage, with_cloud=_with_cloud))


@seed(LOGS, f"convert in/old.bag {MAPPED} --json")
def bag_of_ros_1(folder: Path) -> None:
    from bags import SMALL, one_trajectory, tables_of, write_bag_of_ros_1

    write_bag_of_ros_1(folder / "old.bag", one_trajectory())
    (folder / "cell.toml").write_text(tables_of(SMALL))


@seed(LOGS, f"convert in/robot {ONE}", "convert in/robot --out csv:out --step-s 0.5 --json")
def lerobot(folder: Path) -> None:
    from foreign import episodes, last_of, write_lerobot

    found = episodes()
    write_lerobot(folder / "robot", found, extra={"next.done": last_of(found, [True, False, True])}, tasks=["pick"])


def steps(folder: Path, kind: str) -> None:
    from foreign import episodes, rows_of, write_rows

    write_rows(folder / f"steps.{kind}", rows_of(episodes(), [True, False, True]), kind)


for _kind in ("parquet", "csv", "arrow"):
    seed(LOGS, f"convert in/steps.{_kind} {ONE}", name=f"steps-{_kind}")(partial(steps, kind=_kind))


@seed(
    LOGS,
    "convert in/stages.csv --mapping in/stages.toml --out out --json",
    "convert in/events.parquet --mapping in/events.toml --out csv:out",
    "convert in/stages.csv --mapping-template --out out",
)
def events(folder: Path) -> None:
    from event_files import STAGES, WIDE, write_events

    write_events(folder)
    (folder / "events.csv").unlink()  # what changes nothing is done to CSV of UTF-8 with commas
    (folder / "stages.csv").write_text(WIDE)
    (folder / "stages.toml").write_text(STAGES)


@seed(
    LOGS,
    "convert in/trial.csv --mapping in/trial.toml --out out --json",
    "convert in/trial.csv --mapping-template --out out",
    "convert in/stages.jsonl --mapping in/stages.toml --out csv:out",
    "convert in/trial.xlsx --mapping in/trial.toml --out out",
)
def trial(folder: Path) -> None:
    from event_files import PATIENTS, STAGES, TRIAL, WIDE

    (folder / "trial.csv").write_text(PATIENTS.replace("NA", "").replace("reason", "lost"))
    shutil.copy(Path(__file__).parents[1] / "logs" / "formats" / "trial.xlsx", folder)
    text = TRIAL.replace('covariates.age = {field = "age"}\n', "").replace('"reason"', '"lost"')
    (folder / "trial.toml").write_text(text, encoding="utf-8")
    heading, *rows = (line.split(",") for line in WIDE.splitlines())
    lines = (json.dumps(dict(zip(heading, row, strict=True))) for row in rows)
    (folder / "stages.jsonl").write_text("".join(f"{line}\n" for line in lines))
    (folder / "stages.toml").write_text(STAGES, encoding="utf-8")


@seed(
    LOGS,
    f"convert in/steps.hdf5 {ONE}",
    "convert in/steps.hdf5 --out out --check --truncated finished",
    name="steps-hdf5",
)
def step_arrays(folder: Path) -> None:
    from foreign import arrays, episodes, write_arrays

    write_arrays(folder / "steps.hdf5", arrays(episodes(), terminated=[0], timed_out=[1]))


@seed(LOGS, f"convert sql:sqlite:///in/logs.db {OF_SQL} {ONE}")
def sqlite(folder: Path) -> None:
    import sqlite3
    from contextlib import closing

    logs = flat_log(8)
    with closing(sqlite3.connect(folder / "logs.db")) as database:
        for name in ("stages", "trajectories"):
            logs.tables[name].to_sql(name, database, index=False)


def mcap_of_other_encodings(folder: Path, encoding: str) -> None:
    import bags

    encode = getattr(bags, f"as_{encoding}")
    bags.write_mcap(folder / "cell.mcap", bags.two_trajectories(), encode)
    (folder / "cell.toml").write_text(bags.mapping_for(encode))


for _encoding in ("json", "protobuf"):
    _make = partial(mcap_of_other_encodings, encoding=_encoding)
    seed(LOGS, f"convert in/cell.mcap {MAPPED} --json", name=f"mcap-{_encoding}")(_make)


@seed(LOGS, "inspect in/logs --json", "convert in/logs --out csv:out --json")
def journal_of_objects(folder: Path) -> None:
    seen = [{"object": name, "occlusion": 0.2 * k, "hidden_by": [0.0, 0.0]} for k, name in enumerate(("cup", "mug"))]
    with LogRecorder(folder / "logs", reward_unit="cups") as recorder:
        for number in range(4):
            trajectory = recorder.begin_trajectory(f"table-{number}", cell="left")
            for stage in range(1, 3):
                trajectory.begin_stage({"light": 0.5}, objects=seen, action="WASH", object="cup", probability=0.5)
                trajectory.complete_stage(1.0, elapsed_s=2.0 * stage)
            trajectory.finish()


@seed(LOGS, "record in/calls.jsonl --out out")
def calls(folder: Path) -> None:
    lines = [
        {"call": "begin_trajectory", "name": 1, "columns": {"cell": "left"}},
        {"call": "begin_stage", "covariates": {"x": 0.3}, "action": "PICK", "probability": 0.5},
        {"call": "complete_stage", "reward": 1.0, "elapsed_s": 2.5},
        {"call": "begin_stage", "covariates": {"x": 0.4}, "action": "FINISH", "probability": 0.5},
        {"call": "complete_stage", "reward": 1.0, "elapsed_s": 3.5},
        {"call": "finish"},
    ]
    (folder / "calls.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
