"""How well is the logging policy without its exploration found from its log, and do comparisons with it hold?

python benchmarks/logging_rule.py [--out runs/benchmarks/logging_rule.json] [--logs 40]

The cell is that of examples/pick_cell, whose rule of thumb has thresholds on weight and shine, or a rule with slanted
borders in its place; in 40 % of the stages any action is tried. *Agreement* is the share of the logged stages in which
the model of the actions, which was not fitted to the trajectory, says what the rule would do: given the logged
probabilities, and from the actions alone. Then another rule and the rule of thumb itself are compared with it: how
often the 95 % interval of the difference holds the truth, which is computed exactly, and how often the verdict is
"better".
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from halfseen.evaluation import Baseline, evaluate
from halfseen.evaluation.logging_rule import logging_rule
from halfseen.learning import DoublyRobust, NamedActions
from halfseen.learning.rows import trajectory_arrays
from halfseen.policies import Rule

sys.path.insert(0, str(Path(__file__).parents[1] / "examples" / "pick_cell"))

import cell_trajectories
from cell_optimum import policy_value
from cell_parts import ACTIONS_ALL, COVARIATES, GRIPPERS, HAND_OVER, HORIZON

THRESHOLDS = cell_trajectories.rule_of_thumb
NUM_TRAJECTORIES, COMPARED_TRAJECTORIES = (100, 400, 1600), 800
BY_COX = DoublyRobust("cox", by="pooled")


def slanted(parts: pd.DataFrame, stage: int) -> np.ndarray:
    """A rule whose borders run across the axes."""
    if stage > 2:
        return np.full(len(parts), HAND_OVER)
    weight, shine, clutter = (parts[name].to_numpy() for name in COVARIATES)
    names = np.select([weight - 1.5 * shine > 0.8, shine > clutter + 0.1], ["parallel", "suction"], "soft")
    return pd.Index(GRIPPERS).get_indexer(names).astype(np.int64)


def cautious(parts: pd.DataFrame, stage: int) -> np.ndarray:
    """The rule of thumb, but a person after the first failure."""
    return THRESHOLDS(parts, stage) if stage == 1 else np.full(len(parts), HAND_OVER)


def agreement(rule: Any, num_trajectories: int, seed: int, has_probability: bool) -> float:
    """Share of the logged stages in which the model says what the rule would do."""
    cell_trajectories.rule_of_thumb = rule
    logs = cell_trajectories.simulate(num_trajectories, seed)
    cell_trajectories.rule_of_thumb = THRESHOLDS
    task = NamedActions(ACTIONS_ALL, COVARIATES)
    trajectories = trajectory_arrays(logs, task.encode(logs, HORIZON), None)
    found = logging_rule(logs, trajectories, task, np.arange(num_trajectories) % 10, has_probability)
    if isinstance(found, str):
        return float("nan")
    says, hits = found.probabilities.argmax(axis=2), []
    for stage, frame in logs.stages.groupby("stage"):
        row = pd.Index(logs.trajectory_ids).get_indexer(frame["trajectory"])
        hits.append(says[row, stage - 1] == rule(frame, stage))
    return float(np.concatenate(hits).mean())


def named(rule: Any) -> Rule:
    """As a policy of named actions."""
    return Rule(lambda parts, stage: np.array(ACTIONS_ALL, dtype=object)[rule(parts, stage)], ACTIONS_ALL, HORIZON)


def compared(rule: Any, num_logs: int, propensity: str) -> dict[str, Any]:
    """Does the interval of the difference from the rule behind the log hold the truth?"""
    truth = policy_value(rule) - policy_value(THRESHOLDS)
    found = []
    for seed in range(num_logs):
        logs = cell_trajectories.simulate(COMPARED_TRAJECTORIES, 1000 + seed)
        against = Baseline("logging-rule", "rule")
        answer = evaluate(
            named(rule), logs, against=against, censoring=BY_COX, propensity=propensity, random_state=seed
        )
        gain = answer.difference
        found.append((gain.value, gain.low <= truth <= gain.high, gain.high - gain.low, answer.verdict == "better"))
    value, holds, width, better = np.array(found, dtype=float).T
    error = float(value.std(ddof=1) / np.sqrt(num_logs))
    means = {"holds": holds.mean(), "width": width.mean(), "better": better.mean(), "bias": value.mean() - truth}
    return {"truth": truth, **{name: float(mean) for name, mean in means.items()}, "bias_error": error}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/logging_rule.json"))
    parser.add_argument("--logs", type=int, default=40)
    options = parser.parse_args()
    results = []
    for rule in (THRESHOLDS, slanted):
        for num_trajectories in NUM_TRAJECTORIES:
            row: dict[str, Any] = {"rule": rule.__name__, "num_trajectories": num_trajectories}
            for name, has_probability in (("logged", True), ("actions alone", False)):
                row[name] = float(
                    np.mean([agreement(rule, num_trajectories, seed, has_probability) for seed in range(5)])
                )
            results.append(row)
            print(
                f"{row['rule']:<15}{num_trajectories:>6}  {row['logged']:.1%}  {row['actions alone']:.1%}", flush=True
            )
    for rule in (cautious, THRESHOLDS):
        for propensity in ("logged", "estimated"):
            row = {"rule": rule.__name__, "propensity": propensity, **compared(rule, options.logs, propensity)}
            results.append(row)
            print(
                f"{row['rule']:<15}{propensity:<10} gain {row['truth']:+.4f}, bias {row['bias']:+.4f} ± "
                f"{row['bias_error']:.4f}, width {row['width']:.3f}, holds {row['holds']:.1%}, "
                f"better {row['better']:.1%}",
                flush=True,
            )
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
