"""Relearning: what is to be learned from logs in which the cell changes, and is it noticed that it does?

python benchmarks/relearning.py [--logs 20] [--unchanged 200] [--only none wear] [--after 100 200] [--out FILE]

Each log is of 400 trajectories of the bin before and 100, 200 or 400 after a change, a third of them cut, all by the
cell's own rule with its exploration:

- none: nothing changes;
- wear: a grasp fetches less often, by .35;
- camera: a look shows the part one time in ten, where it did nine times.

Learned is, by default, from all of it (pooled), from what came after the change (since), from what came after the
change that `halfseen learn` reports, or from all where it reports none (advised), and by `--recency auto`. It prints
the value of each in the cell as it is after the change, which is exact, beside that of the best policy; the mean over
logs with its standard error; in which share of the logs a change is reported; and how often one is in logs of 400
trajectories in which there is none.
"""

import argparse
import json
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from service import SHARE, joined, patched
from tqdm import tqdm
from worlds.examples import Bin, bin_cell

from halfseen.learning import CensoredQLearner
from halfseen.logs import Logs
from halfseen.logs.later_part import since
from halfseen.monitoring.training_log import changes_in

NUM_BEFORE, NUMS_AFTER = 400, (100, 200, 400)
KINDS = ("none", "wear", "camera")
WEAR, SEES_WORSE = 0.35, 0.1


def change(kind: str) -> AbstractContextManager[Any]:
    if kind == "camera":
        return patched(bin_cell, "SEES", SEES_WORSE)
    usual = bin_cell.reach
    worn = patched(bin_cell, "reach", lambda state: np.clip(usual(state) - WEAR, 0.02, 0.95))
    return worn if kind == "wear" else nullcontext()


def log_after(kind: str, num: int, seed: int) -> Logs:
    cell, rate = Bin(), Bin()._rate(SHARE)
    cell._rate = lambda _: rate
    with change(kind):
        return cell.log(num, seed, SHARE)


def learned(logs: Logs, half_life: Any = None) -> CensoredQLearner:
    return CensoredQLearner(5, Bin.actions_by_stage, Bin.covariates, half_life=half_life).fit(logs)


def value(learner: CensoredQLearner, kind: str) -> float:
    index, one = pd.Index(Bin.actions), np.eye(len(Bin.actions))
    with change(kind):
        return Bin().value(lambda frame, stage: one[index.get_indexer(learner.decide(frame, stage))])


def learned_each_way(kind: str, num_after: int, seed: int) -> dict[str, Any]:
    after = log_after(kind, num_after, 2 * seed + 1)
    logs = joined([Bin().log(NUM_BEFORE, 2 * seed, SHARE), after])
    pooled, recent = learned(logs), learned(logs, "auto")
    result = changes_in(logs, pooled.policy_, seed)
    learners = {
        "pooled": pooled,
        "since": learned(after),
        "advised": learned(since(logs, result[0].since)) if result else pooled,
        "recency": recent,
    }
    values = {name: value(one, kind) for name, one in learners.items()}
    return {**values, "is reported": bool(result), "half-life": recent.model_.half_life}


def figures(kind: str, num_after: int, num_logs: int) -> dict[str, Any]:
    rows = [
        learned_each_way(kind, num_after, 1000 + seed)
        for seed in tqdm(range(num_logs), f"{kind}, {num_after} after", leave=False, disable=None)
    ]
    found: dict[str, Any] = {"best": _best(kind), "reported": float(np.mean([row["is reported"] for row in rows]))}
    for name in ("pooled", "since", "advised", "recency"):
        each = np.array([row[name] for row in rows])
        found[name] = [float(each.mean()), float(each.std(ddof=1) / np.sqrt(num_logs))]
    found["half-lives"] = [row["half-life"] for row in rows]
    return found


def _best(kind: str) -> float:
    with change(kind):
        return Bin().optimum


def false_reports(num_logs: int) -> float:
    policy = learned(Bin().log(NUM_BEFORE, 0, SHARE)).policy_
    seeds = tqdm(range(5000, 5000 + num_logs), "unchanged", leave=False, disable=None)
    return float(np.mean([bool(changes_in(Bin().log(NUM_BEFORE, seed, SHARE), policy, seed)) for seed in seeds]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--logs", type=int, default=20)
    parser.add_argument("--unchanged", type=int, default=200)
    parser.add_argument("--only", nargs="*", choices=KINDS, default=KINDS)
    parser.add_argument("--after", nargs="*", type=int, default=NUMS_AFTER)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/relearning.json"))
    options = parser.parse_args()
    results: dict[str, Any] = {"unchanged": false_reports(options.unchanged)}
    print(f"a change is reported in {results['unchanged']:.1%} of {options.unchanged} unchanged logs", flush=True)
    names = ("pooled", "since", "advised", "recency")
    print(f"{'change':<8}{'after':>6}{'reported':>9}{'best':>7}" + "".join(f"{name:>15}" for name in names))
    for kind in options.only:
        for num_after in options.after:
            found = figures(kind, num_after, options.logs)
            results[f"{kind} {num_after}"] = found
            cells = "".join(f"{found[name][0]:>8.3f} ± {found[name][1]:.3f}" for name in names)
            print(f"{kind:<8}{num_after:>6}{found['reported']:>9.0%}{found['best']:>7.3f}{cells}", flush=True)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
