"""Does what `halfseen learn` vouches for hold, how much is it, and do as many trajectories decide as it says?

python benchmarks/vouched.py [--out FILE] [--logs 40] [--trajectories 150 300 600] [--world NAME ...] [--share SHARE]

From each log of worlds whose values are known a policy is learned and judged as by default. For each size of the logs
it prints: how often the policy that is vouched for, and the best guess, are called better than what made the log with
and without its exploration; what the two earn more, in truth, than the better of these; of the claims "at least …"
their mean, and how many are true; and the median of how many trajectories would decide, with its quartiles.
"""

import argparse
import json
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits
from verdicts import SHARES, WORLDS
from worlds.world import Chances, World

from halfseen.errors import HalfseenWarning
from halfseen.evaluation.comparison import deciding
from halfseen.evaluation.evaluation import Evaluation
from halfseen.evaluation.held_out import held_out_verdict
from halfseen.learning.discrete_policy import DiscretePolicy, more_cautious
from halfseen.policies.learner_choice import learner_for


def measured(world: World, num_trajectories: int, share: float, seed: int) -> dict[str, Any]:
    """Learn from one log and judge by it."""
    logs = world.log(num_trajectories, 7000 + seed, share)
    start = time.process_time()
    learner = learner_for(logs, censoring="auto", random_state=seed).learner.fit(logs)
    found = held_out_verdict(learner, logs)
    took_s = time.process_time() - start
    to_beat = max(world.value(world.logging), world.value(rule_of(world)))
    assert found.evaluation is not None
    assert found.best is not None
    cautious = more_cautious(learner.policy_, found.caution)
    return {
        "caution": found.caution,
        "cpu_s": took_s,
        "vouched": claimed(found.evaluation) | {"gain": world.value(chances_of(cautious, world)) - to_beat},
        "best": claimed(found.best) | {"gain": world.value(chances_of(learner.policy_, world)) - to_beat},
        "possible": world.optimum - to_beat,
    }


def claimed(found: Evaluation) -> dict[str, Any]:
    """What is said of a policy."""
    main = deciding(found.comparisons)
    is_known = main.difference is not None and main.p is not None
    advice = main.needed if is_known else None
    factors = None if advice is None else (advice.times, advice.low, advice.high)
    return {
        "verdict": found.verdict,
        "value": found.difference.value,
        "low": found.difference.low,
        "standard_error": found.difference.standard_error,
        "bias": found.difference.bias,
        "effective_sample_size": found.difference.effective_sample_size,
        "fitted_q": found.fitted_q.value - found.logging.value,
        "needed": None if factors is None else [each * found.num_trajectories for each in factors],
    }


def rule_of(world: World) -> Chances:
    """What makes the logs, without its exploration."""

    def rule(frame: pd.DataFrame, stage: int) -> np.ndarray:
        chances = world.logging(frame, stage)
        return np.eye(chances.shape[1])[chances.argmax(axis=1)]

    return rule


def chances_of(policy: DiscretePolicy, world: World) -> Chances:
    """Columns in the order of the world; beyond the stages that its log reached it does as in the last of them."""
    columns = [policy.actions.index(name) for name in world.actions]
    return lambda frame, stage: policy.probabilities(frame, min(stage, policy.horizon))[:, columns]


def line(num_trajectories: int, rows: Sequence[dict[str, Any]]) -> str:
    claims = np.array([row["vouched"]["low"] if row["vouched"]["verdict"] == "better" else 0.0 for row in rows])
    gains = {name: np.array([row[name]["gain"] for row in rows]) for name in ("vouched", "best")}
    better = {name: np.mean([row[name]["verdict"] == "better" for row in rows]) for name in gains}
    is_true = np.mean((claims <= 0.0) | (gains["vouched"] >= claims))
    advice = [row["best"]["needed"][0] for row in rows if row["best"]["needed"]]
    quartiles = np.quantile(advice, [0.25, 0.5, 0.75], method="lower") if advice else [np.nan] * 3
    return (
        f"{num_trajectories:>6}{better['vouched']:>9.0%}{better['best']:>7.0%}{gains['vouched'].mean():>+9.3f}"
        f"{gains['best'].mean():>+8.3f}{rows[0]['possible']:>+9.3f}{claims.mean():>+8.3f}{is_true:>7.1%}"
        f"{quartiles[1]:>9.0f}  {quartiles[0]:.0f} to {quartiles[2]:.0f}"
    )


HEAD = (
    f"{'':<6}{'better,':>9}{'best':>7}{'gain,':>9}{'best':>8}{'possible':>9}{'claim':>8}{'true':>7}{'decide':>9}\n"
    f"{'trajectories':>6}{'vouched':>9}{'guess':>7}{'vouched':>9}{'guess':>8}"
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/vouched.json"))
    parser.add_argument("--logs", type=int, default=40)
    parser.add_argument("--trajectories", type=int, nargs="+", default=[150, 300, 600])
    parser.add_argument("--world", choices=WORLDS, nargs="+", default=["bin"])
    parser.add_argument("--share", choices=SHARES, default="1/3")
    options = parser.parse_args()
    results = []
    for name in options.world:
        world = WORLDS[name]()
        print(f"\n{name}, {options.share} cut, {options.logs} logs\n{HEAD}", flush=True)
        for num_trajectories in options.trajectories:
            with threadpool_limits(1), warnings.catch_warnings():
                warnings.simplefilter("ignore", HalfseenWarning)
                rows = [measured(world, num_trajectories, SHARES[options.share], seed) for seed in range(options.logs)]
            print(line(num_trajectories, rows), flush=True)
            results += [
                {"world": name, "num_trajectories": num_trajectories, "seed": seed, **row}
                for seed, row in enumerate(rows)
            ]
    report = {"share": options.share, "num_logs": options.logs, "results": results}
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
