"""Do the intervals of `evaluate` hold, and is "better" said of what is better, when trajectories of the log were cut?

python benchmarks/verdicts.py [--out FILE] [--logs 60] [--trajectories 800] [--world NAME ...] [--share SHARE ...]

Worlds and policies are those of `worlds`; cuts take none, a third or half of the trajectories of a log. For each
policy: how often the 95 % interval of its doubly robust value, and of the difference from the logging policy, held the
truth; the mean error in standard errors; the mean standard error over the standard deviation of the estimates; and how
often it was called better: rightly (best, plain), or falsely (null).
"""

import argparse
import json
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits
from worlds.examples import Bin, Cell, Trial
from worlds.haze import Haze
from worlds.policies import policies_of
from worlds.wide import Wide
from worlds.world import World

from halfseen.evaluation import Evaluation, evaluate
from halfseen.learning import DoublyRobust, Weighted
from halfseen.logs import Logs

NUM_TRAJECTORIES = 800
SHARES = {"0": 0.0, "1/3": 1 / 3, "1/2": 1 / 2}
Judge = Callable[[Any, Logs], Evaluation]
SETTINGS: dict[str, Judge] = {
    name: partial(evaluate, against="logging", censoring=censoring)
    for name, censoring in {
        "default": None,
        "kaplan-meier": DoublyRobust(),
        "cox": DoublyRobust("cox", by="pooled"),
        "cox, weights": Weighted("cox", by="pooled"),
    }.items()
}
WORLDS: dict[str, Callable[[], World]] = {"cell": Cell, "trial": Trial, "haze": Haze, "wide": Wide, "bin": Bin}


def measured(
    world_name: str, share: float, judges: dict[str, Judge], num_logs: int, num_trajectories: int = NUM_TRAJECTORIES
) -> list[dict[str, Any]]:
    """One row for each setting and policy."""
    world = WORLDS[world_name]()
    policies = policies_of(world)
    own = world.value(world.logging)
    truths = {name: world.value(policy.chances) for name, policy in policies.items()}
    found: dict[tuple[str, str], list[tuple[Evaluation, float]]] = {}
    for seed in range(num_logs):
        logs = world.log(num_trajectories, 1000 + seed, share)
        for name, policy in policies.items():
            for setting, judge in judges.items():
                start = time.process_time()
                answer = judge(policy, logs)
                found.setdefault((setting, name), []).append((answer, time.process_time() - start))
    return [
        {"setting": setting, "policy": name, **summary([a for a, _ in answers], truths[name], own)}
        | {"cpu_s": float(np.median([s for _, s in answers]))}
        for (setting, name), answers in found.items()
    ]


def summary(answers: list[Evaluation], truth: float, own: float) -> dict[str, Any]:
    """How the intervals of many logs did."""
    parts = {}
    for name, target in (("doubly_robust", truth), ("logging", own), ("difference", truth - own)):
        each = [getattr(one, name) for one in answers]
        values, errors = np.array([(one.value, one.standard_error) for one in each]).T
        parts[name] = {
            "coverage": float(np.mean([one.low <= target <= one.high for one in each])),
            "bias": float(values.mean() - target),
            "z": float(np.mean((values - target) / np.maximum(errors, 1e-12))),
            "error_ratio": float(errors.mean() / max(values.std(ddof=1), 1e-12)),
            "width": float(np.mean([one.high - one.low for one in each])),
        }
    verdicts = [one.verdict for one in answers]
    size = float(np.mean([one.difference.effective_sample_size for one in answers]))
    return parts | {"better": verdicts.count("better") / len(verdicts), "effective_sample_size": size, "truth": truth}


def line(row: dict[str, Any]) -> str:
    value, difference = row["doubly_robust"], row["difference"]
    return (
        f"{row['setting']:<16}{row['policy']:<13}{value['coverage']:>7.1%}{value['bias']:>+8.3f}{value['z']:>+7.2f}"
        f"{value['error_ratio']:>6.2f}{value['width']:>7.3f} |{row['logging']['coverage']:>7.1%} |"
        f"{difference['coverage']:>7.1%}{difference['bias']:>+8.3f}{difference['z']:>+7.2f}"
        f"{difference['error_ratio']:>6.2f}{difference['width']:>7.3f} |{row['better']:>7.1%}"
        f"{row['effective_sample_size']:>6.0f}{row['cpu_s']:>6.2f}"
    )


HEAD = (
    f"{'':<29}{'value':>7}{'bias':>8}{'z':>7}{'se/sd':>6}{'width':>7} |{'own':>7} |"
    f"{'diff':>7}{'bias':>8}{'z':>7}{'se/sd':>6}{'width':>7} |{'better':>7}{'ESS':>6}{'CPU s':>6}"
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/verdicts.json"))
    parser.add_argument("--logs", type=int, default=60)
    parser.add_argument("--trajectories", type=int, default=NUM_TRAJECTORIES)
    parser.add_argument("--world", choices=WORLDS, nargs="+", default=list(WORLDS))
    parser.add_argument("--share", choices=SHARES, nargs="+", default=list(SHARES))
    parser.add_argument("--setting", choices=SETTINGS, nargs="+", default=["default", "kaplan-meier"])
    options = parser.parse_args()
    results = []
    judges = {name: SETTINGS[name] for name in options.setting}
    for world in options.world:
        for share in options.share:
            with threadpool_limits(1):
                rows = measured(world, SHARES[share], judges, options.logs, options.trajectories)
            print(f"\n{world}, {share} cut, {options.logs} logs of {options.trajectories}\n{HEAD}")
            print("\n".join(line(row) for row in rows), flush=True)
            results += [{"world": world, "share": share, **row} for row in rows]
    report = {"num_trajectories": options.trajectories, "num_logs": options.logs, "results": results}
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
