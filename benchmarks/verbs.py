"""How long do users wait for a verb? CPU seconds of whole processes, compiling and imports included.

python benchmarks/verbs.py [--out runs/benchmarks/verbs.json] [--runs 3] [--only NAME …]

Each verb runs in a process of its own, on logs and policies that are made first, and once before it counts, as a user
has called it before; it prints the median CPU time of the process and of all that it starts, beside what is wanted.
Parts are of examples/pick_cell, tables the shipped ones.
"""

import argparse
import os
import resource
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from timings import Row, write
from tqdm import tqdm

from halfseen.scene import table_paths

CONSOLE = "from halfseen.cli import main; main()"


class Verb(NamedTuple):
    """What is typed, and how long it may take [s]."""

    name: str
    words: str
    bar_s: float


VERBS = (
    Verb("import halfseen", "", 0.3),
    Verb("halfseen --help", "--help", 0.4),
    Verb("halfseen inspect, 400 trajectories", "inspect {parts}", 0.8),
    Verb("halfseen learn --no-verdict, 400 trajectories", "learn {parts} --no-verdict --out {new}", 2.0),
    Verb("halfseen learn, 400 trajectories", "learn {parts} --out {new}", 2.0),
    Verb("halfseen evaluate, 400 trajectories", "evaluate {part_policy} --logs {later}", 4.0),
    Verb("halfseen report, 400 trajectories", "report {later} {part_policy} --out {new}.html", 6.0),
    Verb("halfseen act on a part", "act {part_policy} {part}", 0.8),
    Verb("halfseen act on a table", "act {policy} {table}", 1.5),
    Verb("halfseen simulate, 100 episodes", "simulate --episodes 100 --out {new}", 4.0),
    Verb("halfseen learn --no-verdict, 400 tables", "learn {logs} --no-verdict --out {new}", 2.0),
    Verb("halfseen evaluate, 400 tables", "evaluate {policy} --logs {aside}", 4.0),
    Verb("halfseen evaluate --world, 2,000 episodes", "evaluate {policy} --world --episodes 2000", 8.0),
)
CELL = Path(__file__).parents[1] / "examples" / "pick_cell"
PART = '{"weight_kg": 0.3, "shine": 0.4, "clutter": 0.2}'


def cpu_s(words: str) -> float:
    """CPU time of one process that does it [s]."""
    code = "import halfseen" if not words else CONSOLE
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-c", code, *shlex.split(words)]
    # Python keeps what it compiled of a module, too, unless this says not to.
    usual = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    done = subprocess.run(command, capture_output=True, text=True, env=usual, check=False)
    if done.returncode:
        raise SystemExit(f"halfseen {words} ended with {done.returncode}: {done.stderr.strip()[-500:]}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return (after.ru_utime - before.ru_utime) + (after.ru_stime - before.ru_stime)


def prepared(folder: Path) -> dict[str, Path]:
    """Logs, policies and observations that verbs are tried on."""
    there = {name: folder / name for name in ("logs", "aside", "policy", "part_policy")}
    there |= {"part": folder / "part.json", "parts": CELL / "logs", "later": CELL / "later_logs"}
    there["part"].write_text(PART)
    for name, seed in (("logs", 1), ("aside", 2)):
        cpu_s(f"simulate --episodes 400 --seed {seed} --out {there[name]}")
    for log, policy in (("logs", "policy"), ("parts", "part_policy")):
        cpu_s(f"learn {there[log]} --no-verdict --out {there[policy]}")
    return there | {"table": table_paths()[7]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/verbs.json"))
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--only", nargs="*", help="names of verbs, or parts of them")
    args = parser.parse_args()
    chosen = [verb for verb in VERBS if not args.only or any(name in verb.name for name in args.only)]
    rows = []
    with tempfile.TemporaryDirectory() as temporary:
        there = prepared(Path(temporary))
        for verb in tqdm(chosen, desc="verbs", disable=None):
            news = [Path(temporary) / f"new-{len(rows)}-{run}" for run in range(1 + args.runs)]
            _, *times = [cpu_s(verb.words.format(**there, new=new)) for new in news]
            rows.append(Row(verb.name, float(np.median(times)), "s of CPU", bar=verb.bar_s))
    for row in rows:
        print(f"{row.what:<50} {row.ours:6.2f} s of CPU   bar {row.bar:4.1f} s {'holds' if row.holds else 'missed'}")
    write(args.out, [], rows)


if __name__ == "__main__":
    main()
