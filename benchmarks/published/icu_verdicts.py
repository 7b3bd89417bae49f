"""What `held_out_verdict` says of tables of states: how often "better", how often that is wrong, and its intervals.

python benchmarks/published/icu_verdicts.py [--out …/icu_verdicts.json] [--repetitions 10]

Of ICU-Sepsis as in `icu_sepsis.py`, and of random worlds whose actions all do the same, so that nothing can be gained
but by chance; the interval was made a little wider on another such world. What is judged are the policies of five
folds, and the mean of what they gain is known exactly.
"""

from typing import Any

import numpy as np
from peers.side_by_side import asked, markdown, run
from published.icu_sepsis import SETTINGS, exploring, icu
from worlds.mdp import FiniteWorld, random_world

from halfseen.evaluation.held_out import NUM_FOLDS, learn_by_folds
from halfseen.evaluation.tabular import gain_of
from halfseen.learning import CensoredQLearner

CELLS = [
    ("uncut", 5000),
    ("uncut", 10_000),
    ("half cut", 10_000),
    ("nothing to gain, uncut", 1000),
    ("nothing to gain, uncut", 10_000),
    ("nothing to gain, half cut", 10_000),
    ("uncut", 20_000),
    ("half cut", 20_000),
]
SEEDS_OF_WORLDS, LEVEL = 100, 0.95


def judged(world: FiniteWorld, rule: np.ndarray, cut: float, size: int, seed: int) -> dict[str, Any]:
    """The verdict on one log, its interval, and what the policies of its folds gain in truth."""
    steps = world.simulate(size, rule, world.hazard(rule, cut), np.random.default_rng([seed, size, 1]))
    log = world.log(steps, rule)
    learner = CensoredQLearner(log.horizon, world.actions, ["state"]).fit(log)
    policy = learn_by_folds(learner, log, NUM_FOLDS)
    gain = gain_of(policy, learner.model_, log, float(learner.q_functions_.reg[-1, 0]), LEVEL)
    truth = np.mean([world.worth(choices(world, one, rule)) for one in policy.policies]) - world.worth(rule)
    return {"verdict": gain.verdict(LEVEL)[0], "truth": float(truth), **gain._asdict()}


def choices(world: FiniteWorld, policy: Any, rule: np.ndarray) -> np.ndarray:
    """What a policy takes with all stages to go; in states that it does not know, the rule."""
    found, known = rule.copy(), np.isin(world.names, policy.categories["state"])
    each = policy.coefficients[0]
    q = np.column_stack([each[:, 0], each[:, :1] + each[:, 1:]]).T
    found[known] = np.eye(world.num_actions)[np.where(policy.is_possible[0], q, -np.inf).argmax(axis=1)]
    return found


def measured(name: str, size: int, num: int) -> dict[str, Any]:
    """Verdicts on so many logs."""
    if name in SETTINGS:
        world, expert, is_admissible = icu()
        worlds = [(world, exploring(expert, is_admissible, SETTINGS[name][0]))] * num
    else:
        drawn = [random_world(SEEDS_OF_WORLDS + seed, tilt=0.0) for seed in range(num)]
        worlds = [(world, exploring(expert, np.ones(expert.shape, dtype=bool), 0.5)) for world, expert in drawn]
    cut = 0.5 if name.endswith("half cut") else 0.0
    each = [judged(world, rule, cut, size, seed) for seed, (world, rule) in enumerate(worlds)]
    better = [one for one in each if one["verdict"] == "better"]
    return {
        "setting": name,
        "size": size,
        "logs": num,
        "truth": float(np.mean([one["truth"] for one in each])),
        "estimated": float(np.mean([one["value"] for one in each])),
        "held": int(sum(one["low"] <= one["truth"] <= one["high"] for one in each)),
        "better": len(better),
        "wrong": sum(one["truth"] <= 0 for one in better),
        "num_stages": float(np.mean([one["num_stages"] for one in each])),
    }


def tables(report: dict[str, Any]) -> str:
    head = ["log", "trajectories", "stages of a cell", "gain", "estimate", "intervals that hold", "*better*", "wrong"]
    rows = [
        [
            row["setting"],
            f"{row['size']:,}",
            f"{row['num_stages']:.1f}",
            f"{row['truth']:.4f}",
            f"{row['estimated']:.4f}".replace("-", "−"),
            f"{row['held']} of {row['logs']}",
            str(row["better"]),
            str(row["wrong"]),
        ]
        for row in report["rows"]
    ]
    return markdown(head, rows)


def main() -> None:
    options = asked(__doc__, "icu_verdicts", 10).parse_args()
    run(options.out, [(*cell, options.repetitions) for cell in CELLS], measured, tables)


if __name__ == "__main__":
    main()
