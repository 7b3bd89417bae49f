"""ICU-Sepsis again: CQL and BCQ of d3rlpy, networks on one-hot states, on the first logs of `icu_sepsis.py`.

python benchmarks/published/icu_deep.py [--out …/icu_deep.json] [--repetitions 4] [--sizes 1000 5000]

What they can choose was chosen on a random world of the same shape (--tune --repetitions 1). Training takes half a
minute. d3rlpy 2.8.1 asks for gymnasium 1.0.0 and PyTorch, so it wants an environment of its own.
"""

from importlib import import_module
from importlib.metadata import version
from typing import Any

import numpy as np
from peers.side_by_side import asked, markdown, run, skip
from peers.tabular import counts_of, discrete_bcq, discrete_cql
from published.icu_sepsis import EXPLORED, KIN, SETTINGS, exploring, icu, judged, ours, seen_only
from worlds.mdp import FiniteWorld, Steps, random_world

PACKAGE = "d3rlpy==2.8.1"
CUTS = ("uncut", "half cut")
SIZES = (1000, 5000)
NAMES = ("ours", "CQL, tabular", "CQL, d3rlpy", "BCQ, tabular", "BCQ, d3rlpy")
TRIED: dict[str, list[dict[str, Any]]] = {
    "CQL": [{"num_steps": num, "alpha": alpha} for num, alpha in ((2000, 0.1), (2000, 1.0), (2000, 4.0), (6000, 1.0))],
    "BCQ": [{"num_steps": num, "action_flexibility": least} for num, least in ((2000, 0.3), (2000, 0.6), (6000, 0.3))],
}


def peer() -> Any:
    """The module that knows d3rlpy."""
    try:
        return import_module("peers.deep_table")
    except ModuleNotFoundError as error:
        return skip(f"{error.name} is not installed: pip install {PACKAGE}")


def tuned(num_worlds: int) -> None:
    """Print what each choice earns on random worlds, of 100 between the log and the best policy."""
    deep = peer()
    for name, choices in TRIED.items():
        for choice in choices:
            gains = [of_random(deep, name, choice, seed) for seed in range(num_worlds)]
            print(f"{name:<6}{choice!s:<50}{' '.join(f'{gain:6.1f}' for gain in gains)}", flush=True)


def of_random(deep: Any, name: str, choice: dict[str, Any], seed: int) -> float:
    world, expert = random_world(seed, **KIN[seed % len(KIN)])
    rule = exploring(expert, np.ones(expert.shape, dtype=bool), EXPLORED)
    steps = world.simulate(SIZES[0], rule, world.hazard(rule, 0.0), np.random.default_rng([seed, SIZES[0]]))
    found = seen_only(deep.learned(name, world, steps, **choice), counts_of(world, steps))
    own = world.worth(rule)
    return 100.0 * (judged(world, found, rule) - own) / (world.worth(world.best()) - own)


def measured(icu_world: Any, setting: str, size: int, num: int) -> dict[str, Any]:
    """Mean worth of what each learns from so many logs, and its standard error."""
    world, expert, is_admissible = icu_world
    explored, cut = SETTINGS[setting]
    rule = exploring(expert, is_admissible, explored)
    hazard, worth = world.hazard(rule, cut), []
    for seed in range(num):
        steps = world.simulate(size, rule, hazard, np.random.default_rng([seed, size]))
        counts = counts_of(world, steps)
        worth.append([judged(world, seen_only(each, counts), expert) for each in learned(world, steps, rule)])
    mean, error = np.mean(worth, axis=0), np.std(worth, axis=0, ddof=1) / np.sqrt(num)
    each = np.round(np.array([mean, error]).T, 5).tolist()
    return {"setting": setting, "size": size, "logs": num, **dict(zip(NAMES, each, strict=True))}


def learned(world: FiniteWorld, steps: Steps, rule: np.ndarray) -> list[np.ndarray]:
    """π(a | s) of each of `NAMES`."""
    deep, counts = peer(), counts_of(world, steps)
    networks = {name: deep.learned(name, world, steps, **chosen) for name, chosen in deep.SETTINGS.items()}
    tabular = {"CQL": discrete_cql(counts, 0.01), "BCQ": discrete_bcq(counts, 0.6)}
    pairs = [each[name] for name in ("CQL", "BCQ") for each in (tabular, networks)]
    return [ours(world, steps, rule), *pairs]


def tables(report: dict[str, Any]) -> str:
    head = ["log", *NAMES]
    rows = [
        [f"{row['setting']}, {row['size']:,}", *("{:.4f} ± {:.4f}".format(*row[name]) for name in NAMES)]
        for row in report["rows"]
    ]
    caption = f"*{report['package']}; means ± a standard error of the first {report['repetitions']} logs*"
    return f"{caption}\n\n{markdown(head, rows)}"


def main() -> None:
    parser = asked(__doc__, "icu_deep", 4)
    parser.add_argument("--sizes", nargs="+", type=int, default=list(SIZES), help="trajectories of a log")
    parser.add_argument("--tune", action="store_true", help="print what choices earn on random worlds, and stop")
    options = parser.parse_args()
    if options.tune:
        tuned(options.repetitions)
        return
    peer()
    cells = [(icu(), setting, size, options.repetitions) for setting in CUTS for size in options.sizes]
    run(
        options.out,
        cells,
        measured,
        tables,
        repetitions=options.repetitions,
        package=f"{PACKAGE}, torch {version('torch')}",
    )


if __name__ == "__main__":
    main()
