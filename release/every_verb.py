"""Each verb once, in an order in which one makes what the next one takes, in a folder that `prepare` made.

``python every_verb.py`` does so in one process, with whatever halfseen is installed there, and prints what each line
ended with as JSON.
"""

import contextlib
import io
import json
import shlex
import shutil
import sys
import traceback
from pathlib import Path
from typing import NamedTuple

CLONE = Path(__file__).parents[1]
CELL = "examples/bin_cell"
MONITOR = f"monitor policy --logs {CELL}/later_logs"
LINES = (
    f"inspect {CELL}/logs",
    f"learn {CELL}/logs --out policy --exploration try.csv",
    f"evaluate policy --logs {CELL}/later_logs",
    MONITOR,
    f"act policy {CELL}/part.json",
    f"report {CELL}/later_logs policy --out report.html",
    "export policy --onnx policy.onnx",
    f"convert {CELL}/logs --out csv",
    f"convert {CELL}/logs --out minari:logs-v0",
    "record lines.jsonl --out recorded",
    "look table.pcd",
    "simulate --out tables --episodes 30",
    "cell calibrate --from law --out law_again",
    "cell run --policy greedy --tables 2 --out cell",
    "study table.pcd --only grasp --repetitions 2 --out study",
)
"""Verbs that end by themselves."""
SERVERS = ("serve", "watch")
"""Verbs that go on until they are stopped; `record`, too, where it listens."""


class Ended(NamedTuple):
    """What a line ended with; its status is 1 where halfseen has a defect."""

    line: str
    status: int
    err: str


def prepare(folder: Path) -> None:
    """Copy what an engineer has: logs of a cell, a part, a cloud, a law; nothing else of the clone."""
    shutil.copytree(CLONE / CELL, folder / CELL, ignore=shutil.ignore_patterns("*.py", "__pycache__"))
    (folder / "lines.jsonl").write_text(
        '{"call": "begin_trajectory"}\n{"call": "cut", "cause": "lost", "end_s": 1.0}\n'
    )
    source = CLONE / "src" / "halfseen"
    shutil.copy(source / "scene" / "tables" / "table_00.pcd", folder / "table.pcd")
    shutil.copytree(source / "cell" / "calibration" / "shipped_law", folder / "law")


def run(line: str) -> Ended:
    """Run a line as a shell would, in this process."""
    from halfseen import cli

    sys.argv = ["halfseen", *shlex.split(line)]
    status, err = 0, io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(err):
        try:
            cli.main()
        except SystemExit as stop:
            status = int(stop.code or 0)
            # These logs are not of the policy's service, which the page and the status say.
            status = 0 if line == MONITOR and status == 2 and not err.getvalue() else status
        except Exception:
            status = 1
            traceback.print_exc()
    return Ended(line, status, err.getvalue())


if __name__ == "__main__":
    print(json.dumps([run(line) for line in LINES]))
