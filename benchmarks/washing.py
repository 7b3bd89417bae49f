"""Does the physical cell do its work? Every cup of fresh tables goes into the rack, one after the other.

python benchmarks/washing.py [--tables 50] [--seed 2026] [--out FILE]

No attribute and no policy: the cup that is hidden least and failed least is washed until nothing is left in view. It
prints cups in the rack, toppled and fallen, attempts that held, and CPU seconds of looks with perception, of attempts
with their plans, and of whole tables, medians over all.
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits
from tqdm import tqdm

from halfseen.cell.campaign import Conditions
from halfseen.cell.memory import KnownObject
from halfseen.cell.rewards import CupsTruth
from halfseen.cell.workcell import Workcell

MOST_FAILURES = 3
MOST_STEPS = 40


def washed(cell: Workcell, is_dirty: np.ndarray) -> dict[str, Any]:
    """Wash until nothing is left that is worth another try."""
    truth, looks_s, attempts_s, held, begin_s = CupsTruth(cell, is_dirty), [], [], [], time.process_time()
    for _ in range(MOST_STEPS):
        start = time.process_time()
        cell.look()
        looks_s.append(time.process_time() - start)
        left = {k: known for k, known in enumerate(cell.memory.objects) if known.seen is not None}
        left = {k: known for k, known in left.items() if _num_failures(known) < MOST_FAILURES}
        if not left:
            break
        start = time.process_time()
        held.append(cell.wash(min(left, key=lambda k: _order(left[k]))).is_held)
        attempts_s.append(time.process_time() - start)
    seconds = {"table_s": time.process_time() - begin_s, "looks_s": looks_s, "attempts_s": attempts_s}
    return {
        **truth.counts(cell),
        "num_attempts": len(held),
        "num_held": sum(held),
        "robot_s": cell.cell.time_s,
        **seconds,
    }


def _order(known: KnownObject) -> float:
    return _num_failures(known) + (1.0 if known.seen is None else known.seen.occlusion)


def _num_failures(known: KnownObject) -> int:
    return sum(not trial.is_held for trial in known.trials)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tables", type=int, default=50)
    parser.add_argument("--seed", type=int, default=2026)
    parser.add_argument("--grasping", choices=["completed", "visible-only"], default="completed")
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/washing.json"))
    options = parser.parse_args()
    conditions, tables = Conditions(stops=None, grasping=options.grasping), []
    with threadpool_limits(1):
        for index in tqdm(range(options.tables), disable=None):
            tables.append(washed(*conditions.cell(options.seed, index)))
    total = {name: sum(table[name] for table in tables) for name in tables[0] if name.startswith("num_")}
    print(f"{options.tables} tables, {total['num_cups']} cups, shapes {options.grasping}")
    print(f"in the rack  {total['num_racked']} ({total['num_racked'] / total['num_cups']:.1%})")
    print(f"toppled {total['num_toppled']}, fell {total['num_fallen']}")
    print(f"attempts     {total['num_attempts']}, held {total['num_held'] / total['num_attempts']:.1%}")
    for name in ("looks_s", "attempts_s"):
        print(f"{name[:-2]:<12} {np.median([one for table in tables for one in table[name]]):.2f} CPU-s")
    sixes = [table["table_s"] for table in tables if table["num_cups"] == 6] or [np.nan]
    every = float(np.median([table["table_s"] for table in tables]))
    print(f"tables       {every:.1f} CPU-s, of six cups {np.median(sixes):.1f}")
    print(f"robot        {np.mean([table['robot_s'] for table in tables]):.0f} s a table")
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps({"seed": options.seed, "tables": tables}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
