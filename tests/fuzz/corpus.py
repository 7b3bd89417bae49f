"""Small valid inputs, made by the project's own writers, each with a command line that reads it.

A command line names its input ``in/…`` and what it writes ``out…``, below the folder in which it runs.
"""

import shutil
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from fuzz import log_inputs as logs
from fuzz import policy_inputs as policies
from small_logs import flat_log, table_log
from text_logs import text_log

OF_SQL = "--stages 'SELECT * FROM stages' --paths 'SELECT * FROM paths'"


@dataclass(frozen=True)
class Seed:
    """A valid input and what is done with it."""

    name: str
    make: Callable[[Path], object]
    lines: tuple[str, ...]
    is_heavy: bool = False


def made(seed: Seed, corpus: Path) -> Path:
    """The folder of a valid input, made where it is not there yet; several processes may ask at once."""
    folder = corpus / seed.name
    if not folder.exists():
        fresh = Path(tempfile.mkdtemp(dir=corpus))
        seed.make(fresh)
        try:
            fresh.rename(folder)
        except OSError:  # another process was faster
            shutil.rmtree(fresh)
    return folder


def seeds(table: Mapping[str, tuple[Any, ...]], is_heavy: bool = False) -> tuple[Seed, ...]:
    """Seeds by name: what makes each, and the command lines that read it."""
    return tuple(Seed(name, make, tuple(lines), is_heavy) for name, (make, *lines) in table.items())


ONE = "--out out --json"
LEARN = "learn in/logs --out out --no-verdict --workers 1"
EVALUATE = "evaluate in/policy --logs in/logs --propensity estimated"
SIMULATE = "simulate in/table.npz --episodes 4 --out out --json"
INSPECTED = ("inspect in/logs --json", "inspect in/logs", "convert in/logs --out csv:out --json")
MAPPED = "--mapping in/cell.toml --out out"
CLOUDS = seeds(
    {
        "npz": (
            policies.npz,
            "look in/table.npz --json",
            "look in/table.npz",
            "look in/table.npz --json --picture out.png",
        ),
        "pcd": (policies.pcd, "look in/table.pcd --json", "look in/table.pcd"),
        "pcd-text": (policies.pcd_text, "look in/table.pcd --json"),
        "ply": (partial(policies.ply, is_text=False), "look in/table.ply --json"),
        "ply-text": (partial(policies.ply, is_text=True), "look in/table.ply --json"),
        "labels": (
            policies.labelled,
            *(f"look in/table.npz --labels in/labels.{kind} --json" for kind in ("csv", "json")),
        ),
        "several": (policies.several, "look in --json --workers 1", "look in/table.npz in/table.ply --workers 1"),
    }
)
LOGS = seeds(
    {
        "flat": (logs.parquet(flat_log), *INSPECTED),
        "tables": (logs.parquet(table_log), *INSPECTED),
        "text": (logs.parquet(text_log, 20), "inspect in/logs --json"),
        "csv": (logs.csv(flat_log, 8), f"convert in/logs {ONE}"),
        "csv-tables": (logs.csv(table_log, 6), f"convert in/logs {ONE}"),
        "journal": (
            logs.journal,
            "inspect in/logs --json",
            f"convert in/logs {ONE}",
            "convert in/logs in/more --out out",
        ),
        "minari": (logs.minari, f"convert in/logs/flat-v0 {ONE}"),
        "minari-foreign": (
            logs.minari_foreign,
            f"convert in/hand-v0 {ONE}",
            f"convert in/hand-v0 --clock t {ONE}",
        ),
        "mcap": (partial(logs.bag, storage="mcap"), f"convert in/bag {MAPPED} --json"),
        "db3": (partial(logs.bag, storage="sqlite3"), f"convert in/bag {MAPPED} --json"),
        "bag-of-clouds": (
            partial(logs.bag, storage="mcap", with_cloud=True),
            f"convert in/bag {MAPPED} --clouds out-clouds --json",
        ),
        "lerobot": (logs.lerobot, f"convert in/robot {ONE}", "convert in/robot --out csv:out --step-s 0.5 --json"),
        **{
            f"steps-{kind}": (partial(logs.steps, kind=kind), f"convert in/steps.{kind} {ONE}")
            for kind in ("parquet", "csv", "arrow")
        },
        "steps-hdf5": (
            logs.step_arrays,
            f"convert in/steps.hdf5 {ONE}",
            "convert in/steps.hdf5 --out out --check --truncated finished",
        ),
        **{
            f"mcap-{encoding}": (
                partial(logs.mcap_of_other_encodings, encoding=encoding),
                f"convert in/cell.mcap {MAPPED} --json",
            )
            for encoding in ("json", "protobuf")
        },
        "sqlite": (logs.sqlite, f"convert sql:sqlite:///in/logs.db {OF_SQL} {ONE}"),
        "bag-of-ros-1": (logs.bag_of_ros_1, f"convert in/old.bag {MAPPED} --json"),
        "journal-of-objects": (
            logs.journal_of_objects,
            "inspect in/logs --json",
            "convert in/logs --out csv:out --json",
        ),
        "calls": (logs.calls, "record in/calls.jsonl --out out"),
    }
)
HEAVY = seeds(
    {
        "flat-learned": (
            logs.parquet(flat_log),
            f"{LEARN} --json",
            f"{LEARN} --in-passes --json",
            f"{LEARN} --censoring cox --q-function kernel --reg 0.1",
        ),
        "text-learned": (logs.parquet(text_log, 20), f"{LEARN} --json"),
        "tables-learned": (logs.parquet(table_log), f"{LEARN} --json"),
        "flat-policy": (
            policies.flat_policy,
            "act in/policy in/state.json --json",
            "act in/policy in/state.csv --json",
            "act in/policy in/state.json",
            "export in/policy --onnx out.onnx",
        ),
        "judged": (
            policies.judged,
            f"{EVALUATE} --workers 1 --json",
            f"{EVALUATE} --against in/rule.toml --workers 1 --json",
            f"{EVALUATE} --against in/rule.csv --workers 1",
            "report in/logs --out out.html --json --workers 1",
        ),
        "table-policy": (
            policies.table_policy,
            "act in/policy in/table.npz --json",
            "act in/policy in/table.npz --picture out.png",
        ),
        "begun": (
            policies.begun,
            "act in/policy in/table.npz --history in/history --json",
            "watch in/table.npz --policy in/policy --export out.html",
            "evaluate in/policy in/table.npz --world --episodes 8 --json",
        ),
        "attempts": (policies.attempts, f"cell calibrate --from in/attempts --workers 1 {ONE}"),
        "law": (policies.law, f"{SIMULATE} --law in/law"),
        "team": (policies.team, *(f"{SIMULATE} --team in/team.{kind} --horizon 2" for kind in ("toml", "json"))),
        "team-logs": (policies.team_logs, "inspect in/logs --json", LEARN),
    },
    is_heavy=True,
)
COMMAND_LINES = Seed(
    "command-line",
    policies.nothing,
    (
        *(f"{verb} --help" for verb in ("look", "inspect", "cell run")),
        "study in/none.pcd --out out --only reward --repetitions 2 --seed 1",
        "cell run --policy nobody --out out",
        "cell calibrate --out out --attempts 50 --arm in/none.xml",
        "cell film --policy nobody --out out.gif",
        "watch in/none --export out.html",
        "serve in/none",
    ),
)
SEEDS = {seed.name: seed for seed in (*CLOUDS, *LOGS, *HEAVY, COMMAND_LINES)}
