"""ICU-Sepsis [Choudhary, Gupta, Thomas, RLC 2024]: 716 states and 25 actions, learned from logs of its expert.

python benchmarks/published/icu_sepsis.py [--out …/icu_sepsis.json] [--repetitions 20] [--sizes 1000 5000 …]

The dynamics are those of the package `icu-sepsis`, and every value is computed from them exactly. A log is of the
expert, who at a share ε of decisions takes one of the admissible actions at random. A stage is cut at a rate that
doubles with every 3 points of SOFA. Peers are tabular (`peers.tabular`); what they can choose was chosen, as our method
was, on random worlds of the same shape (--tune), though this world was in view, and ε was chosen by it. In a state that
a log never shows the expert decides, whoever learned. *Informed* is a yardstick: it knows all of each state but which
action is best, and looks one step ahead.
"""

from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from peers.side_by_side import asked, markdown, run, skip
from peers.tabular import (
    Counts,
    behaviour_cloning,
    certainty_equivalence,
    counts_of,
    discrete_bcq,
    discrete_cql,
    greedy,
    pessimistic,
)
from threadpoolctl import threadpool_limits
from tqdm import tqdm
from worlds.mdp import FiniteWorld, Steps, random_world

from halfseen.learning import CensoredQLearner

PACKAGE = "icu-sepsis==2.0.1"
EXPLORED = 0.5
SETTINGS = {
    "uncut": (EXPLORED, 0.0),
    "a third cut": (EXPLORED, 1 / 3),
    "half cut": (EXPLORED, 0.5),
    "no exploration": (0.0, 0.0),
}
"""ε, and the share of trajectories that is cut."""
SIZES = (1000, 5000, 10_000, 20_000)
MANY = 5
"""Times as many logs where they are smallest, for their worst."""
SOFA_OF_DOUBLING = 3.0
PEERS: dict[str, Callable[[Counts], np.ndarray]] = {
    "cloning": behaviour_cloning,
    "certainty equivalence": certainty_equivalence,
    "the same, seen 10 times": lambda counts: certainty_equivalence(counts, 10),
    "pessimistic VI": lambda counts: pessimistic(counts, 1.0),
    "BCQ": lambda counts: discrete_bcq(counts, 0.6),
    "CQL": lambda counts: discrete_cql(counts, 0.01),
}
"""What they can choose is the best of `CHOICES` on random worlds."""
CHOICES: dict[str, Callable[[Counts, float], np.ndarray]] = {
    "seen so often": lambda counts, least: certainty_equivalence(counts, int(least)),
    "pessimistic VI": pessimistic,
    "BCQ": discrete_bcq,
    "CQL": discrete_cql,
}
TRIED = {
    "seen so often": (3, 10, 20),
    "pessimistic VI": (0.1, 0.3, 1.0, 3.0),
    "BCQ": (0.1, 0.3, 0.6, 0.8),
    "CQL": (0.003, 0.01, 0.03, 0.1),
}
KIN = ({}, {"tilt": 1.5}, {"num_own": 24.0, "tilt": 0.6}, {"num_own": 6.0, "skill": 1.0})
"""Random worlds to tune on: few or many actions of an effect, experts of little and of some skill."""


def icu() -> tuple[FiniteWorld, np.ndarray, np.ndarray]:
    """The world, its expert, and what is admissible."""
    try:
        assets = Path(str(distribution("icu-sepsis").locate_file("icu_sepsis/envs/assets")))
    except PackageNotFoundError:
        skip(f"icu-sepsis is not installed: pip install --no-deps {PACKAGE}")
    with np.load(assets / "dynamics.npz") as dynamics:
        chance, start, sofa = dynamics["tx_mat"], dynamics["d_0"], dynamics["sofa_scores"]
        expert, by_entry = dynamics["expert_policy"], dynamics["r_mat"].max(axis=(0, 1))
    is_end = chance[np.arange(len(start)), 0, -1] == 1.0
    lines = (assets / "admissible_actions.txt").read_text().splitlines()[1 : len(start) + 1]
    is_admissible = np.array([np.isin(np.arange(expert.shape[1]), np.array(line.split(), dtype=int)) for line in lines])
    severity = (sofa - sofa[~is_end].mean()) / SOFA_OF_DOUBLING
    world = FiniteWorld(chance, by_entry, start / start.sum(), is_end, np.where(is_end, 0.0, severity))
    return world, expert / np.maximum(expert.sum(axis=1, keepdims=True), 1e-300), is_admissible


def exploring(expert: np.ndarray, is_admissible: np.ndarray, share: float) -> np.ndarray:
    return (1.0 - share) * expert + share * is_admissible / is_admissible.sum(axis=1, keepdims=True)


def ours(world: FiniteWorld, steps: Steps, rule: np.ndarray) -> np.ndarray:
    """π(a | s) of the learner as shipped."""
    log = world.log(steps, rule)
    learner = CensoredQLearner(log.horizon, world.actions, ["state"]).fit(log)
    known = np.flatnonzero(np.isin(world.names, learner.policy_.categories["state"]))
    found = np.zeros(rule.shape)
    found[known] = learner.policy_.probabilities(pd.DataFrame({"state": world.names[known]}), 1)
    return found


def informed(world: FiniteWorld, counts: Counts, rule: np.ndarray) -> np.ndarray:
    """What a Bayesian would choose who knows V of the log, and noise and spread of every state, but no action's Q."""
    value = world.values(rule)
    q, entered = world.q(value), world.reward + np.where(world.is_end, 0.0, value)
    mean = (rule * q).sum(axis=1, keepdims=True)
    spread = (rule * (q - mean) ** 2).sum(axis=1, keepdims=True)
    noise = np.einsum("sa,sat,t->s", rule, world.chance, entered**2)[:, None] - mean**2
    kept = counts.n * spread / np.maximum(counts.n * spread + noise, 1e-12)
    likely = counts.clone * 1e-12
    return greedy(np.where(counts.is_seen, kept * (counts.backed_up(value) - mean) + likely, likely - 1e-9))


def judged(world: FiniteWorld, found: np.ndarray, rule: np.ndarray) -> float:
    """Worth of a policy; where it says nothing, the rule decides."""
    return world.worth(np.where(found.sum(axis=1, keepdims=True) > 0, found, rule))


def tuned(repetitions: int) -> None:
    """Print what each choice earns on random worlds, of 100 between the log and the best policy."""
    earned: dict[tuple[str, float], list[float]] = {}
    for seed, kin in tqdm([(seed, kin) for seed in range(repetitions) for kin in KIN], disable=None, leave=False):
        world, expert = random_world(seed, **kin)
        rule = exploring(expert, np.ones(expert.shape, dtype=bool), EXPLORED)
        own, best = world.worth(rule), world.worth(world.best())
        for size in (1000, 10_000):
            steps = world.simulate(size, rule, world.hazard(rule, 0.0), np.random.default_rng([seed, size]))
            counts = counts_of(world, steps)
            found = {(name, c): CHOICES[name](counts, c) for name, choices in TRIED.items() for c in choices}
            found["ours", 0.0] = ours(world, steps, rule)
            for key, policy in found.items():
                gain = 100.0 * (judged(world, seen_only(policy, counts), rule) - own) / (best - own)
                earned.setdefault(key, []).append(gain)
    for (name, choice), gains in earned.items():
        print(f"{name:<16}{choice:<8g}{np.mean(gains):6.1f}")


def seen_only(policy: np.ndarray, counts: Counts) -> np.ndarray:
    return policy * (counts.n.sum(axis=1, keepdims=True) > 0)


def measured(
    icu_world: tuple[FiniteWorld, np.ndarray, np.ndarray], setting: str, size: int, num: int
) -> dict[str, Any]:
    """Worth of what each learns from so many logs."""
    world, expert, is_admissible = icu_world
    explored, cut = SETTINGS[setting]
    rule = exploring(expert, is_admissible, explored)
    hazard, worth = world.hazard(rule, cut), []
    for seed in range(num):
        steps = world.simulate(size, rule, hazard, np.random.default_rng([seed, size]))
        counts = counts_of(world, steps)
        found = {"ours": ours(world, steps, rule)} | {name: learn(counts) for name, learn in PEERS.items()}
        found["informed"] = informed(world, counts, rule)
        worth.append([judged(world, seen_only(each, counts), expert) for each in found.values()])
    return {"setting": setting, "size": size, "logs": num, **summary(list(found), np.array(worth))}


def summary(names: list[str], worth: np.ndarray) -> dict[str, Any]:
    """Mean and its standard error, mean of the worst 5 % of logs, and how far ours is ahead."""
    num, root = max(1, round(0.05 * len(worth))), np.sqrt(len(worth))
    ahead = worth[:, :1] - worth
    columns = {
        "mean": worth.mean(axis=0),
        "error": worth.std(axis=0, ddof=1) / root,
        "worst": np.sort(worth, axis=0)[:num].mean(axis=0),
        "ahead": ahead.mean(axis=0),
        "ahead_error": ahead.std(axis=0, ddof=1) / root,
    }
    return {name: dict(zip(names, np.round(each, 5).tolist(), strict=True)) for name, each in columns.items()}


def tables(report: dict[str, Any]) -> str:
    """Values in one table; errors are in the results."""
    names = ["ours", *PEERS, "informed"]
    head = ["log", *names, "worst 5 % of ours", "of informed"]
    rows = [
        [
            f"{row['setting']}, {row['size']:,}",
            *(f"{row['mean'][name]:.4f}" for name in names),
            *(f"{row['worst'][name]:.4f}" for name in ("ours", "informed")),
        ]
        for row in report["rows"]
    ]
    exact = ", ".join(f"{name} {value:.4f}" for name, value in report["exact"].items())
    error = max(row["error"][name] for row in report["rows"] for name in names)
    return f"*Exact: {exact}; standard errors are at most {error:.4f}*\n\n{markdown(head, rows)}"


def main() -> None:
    parser = asked(__doc__, "icu_sepsis", 20)
    parser.add_argument("--settings", nargs="+", choices=SETTINGS, default=list(SETTINGS))
    parser.add_argument("--sizes", nargs="+", type=int, default=list(SIZES), help="trajectories of a log")
    parser.add_argument("--tune", action="store_true", help="print what choices earn on random worlds, and stop")
    options = parser.parse_args()
    if options.tune:
        with threadpool_limits(1):
            tuned(options.repetitions)
        return
    world = icu()
    policies = {"random": np.full(world[1].shape, 1.0 / world[1].shape[1]), "expert": world[1]}
    policies["optimal"] = world[0].best()
    exact = {name: round(world[0].worth(policy), 4) for name, policy in policies.items()}
    times = {size: options.repetitions * (MANY if size == min(SIZES) else 1) for size in options.sizes}
    cells = [(world, setting, size, times[size]) for setting in options.settings for size in options.sizes]
    run(options.out, cells, measured, tables, repetitions=options.repetitions, exact=exact)


if __name__ == "__main__":
    main()
