"""RockSample(7, 8) [Smith and Simmons 2004]: a policy learned from logs of a heuristic, beside a planner.

python benchmarks/published/rocksample.py [--out …/rocksample.json] [--repetitions 4] [--sizes 300 1000 5000]

The world is `worlds/rocks.py`. Rewards of a log are discounted to the first step, and how far that has gone is among
the covariates; stages are skills, which take as many seconds as steps. A log is of the heuristic, of which three
decisions in ten are by chance, or of chance alone. Its covariates are of rocks by their numbers (`by number`), or by
their ranks among the nearest that are not believed to be bad, and covariates are present values (`by rank`). Values
are means of 4,000 fresh episodes. Beside them: the heuristic; who sees which rocks are good, and takes the best route;
and pomdp-py's POMCP (`peers/rover.py`), which decides every step, knows the model and the exact posterior, and makes as
many simulations a decision as a core makes in a second, as this machine may be busy.
"""

import gc
import sys
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from peers.side_by_side import asked, markdown, mean_and_error, run, with_error
from tqdm import tqdm
from worlds.rocks import (
    BY_NUMBER,
    BY_RANK,
    DISCOUNT,
    HORIZON,
    NUM,
    PAY,
    SIZE,
    Choices,
    Played,
    Rule,
    Seen,
    best_routes,
    heuristic,
    log_of,
    nearest,
    play,
    rate_of,
    rocks_of,
)

from halfseen.learning import CensoredQLearner

PACKAGE = "pomdp-py==1.3.5.1"
SIZES = (300, 1000, 5000)
EPISODES, REPLAYS = 4000, 200
EXPLORES = {"heuristic": 0.3, "chance": 1.0}
CUTS = {"uncut": 0.0, "half cut": 0.5}
PUBLISHED = {"POMCP": 20.71, "SARSOP": 21.39}
"""By Silver and Veness, NIPS 2010, for the same map."""


def beliefs(seen: Seen) -> pd.DataFrame:
    """What is known, as it is."""
    columns = {f"belief {k}": seen.belief[:, k] for k in range(NUM)}
    columns |= {"x": seen.position[:, 0], "y": seen.position[:, 1], "now": DISCOUNT**seen.steps}
    return pd.DataFrame(columns).astype(float)


def present_values(seen: Seen) -> pd.DataFrame:
    """Of the nearest open rocks what a sample is expected to bring and may fail to; of leaving; of all open rocks."""
    rock, there = nearest(seen)
    now = PAY * DISCOUNT**seen.steps
    worth = now[:, None] * DISCOUNT**seen.driving
    at, belief = (np.where(there, np.take_along_axis(each, rock, axis=1), 0.0) for each in (worth, seen.belief))
    columns = {f"gain {k + 1}": at[:, k] * (2.0 * belief[:, k] - 1.0) for k in range(rock.shape[1])}
    columns |= {f"doubt {k + 1}": at[:, k] * (1.0 - belief[:, k]) for k in range(rock.shape[1])}
    leave = now * DISCOUNT ** (SIZE - 1 - seen.position[:, 0])
    open_rocks = np.where(seen.belief >= 0.5, worth * seen.belief, 0.0).sum(axis=1)
    return pd.DataFrame(columns | {"now": now, "leave": leave, "open": open_rocks})


class Design(NamedTuple):
    """How a log is written, and learned from."""

    choices: Choices
    covariates: Callable[[Seen], pd.DataFrame]
    parameters: dict[str, Any]


DESIGNS = {
    "by number, linear": Design(BY_NUMBER, beliefs, {"q_function": "linear"}),
    "by rank, linear": Design(BY_RANK, present_values, {"q_function": "linear"}),
    "by rank, default": Design(BY_RANK, present_values, {}),
}


def learned(played: Played, design: Design, rate: float, seed: int) -> Rule:
    """The policy that is learned from a log."""
    covariates, names = design.covariates(played.seen), design.choices.names
    log = log_of(played, design.choices, covariates, rate, np.random.default_rng([seed, 2]))
    actions = {stage: names if stage < HORIZON else names[-1:] for stage in range(1, HORIZON + 1)}
    policy = CensoredQLearner(HORIZON, actions, list(covariates), **design.parameters).fit(log).policy_
    return lambda seen, stage: policy.probabilities(design.covariates(seen), stage)


def earned(rule: Rule, choices: Choices) -> tuple[float, float]:
    """Value of a policy, and its standard error, on the worlds that all are judged by."""
    return mean_and_error(play(EPISODES, rule, choices, np.random.default_rng(99)).returns)


def measured(logger: str, cut: str, size: int, num: int) -> dict[str, Any]:
    """Values of what is learned from each of some logs."""
    rule = heuristic(EXPLORES[logger])
    rate = rate_of(CUTS[cut], rule, np.random.default_rng(98))
    values: dict[str, list[float]] = {name: [] for name in DESIGNS}
    for seed in range(num):
        played = play(size, rule, BY_RANK, np.random.default_rng([seed, size]))
        for name, design in DESIGNS.items():
            values[name].append(round(earned(learned(played, design, rate, seed), design.choices)[0], 3))
    return {"log": f"{logger}, {cut}", "size": size, "values": values}


def peer() -> Any:
    """The module of POMCP."""
    try:
        from peers import rover
    except ModuleNotFoundError as error:
        sys.exit(f"{error.name} is not installed: pip install --no-deps {PACKAGE}, or give --episodes 0")
    return rover


def planner(episodes: int, simulations: int) -> dict[str, Any]:
    """What POMCP earns by so many simulations a decision, or by a second of this core where that is 0."""
    rover, returns = peer(), []
    number = simulations or rover.pace()
    gc.disable()
    for seed in tqdm(range(episodes), desc="POMCP", disable=None, leave=False):
        returns.append(rover.episode(number, seed))
        gc.collect()
    gc.enable()
    return {"simulations": number, **compared(returns)}


def compared(returns: list[float]) -> dict[str, Any]:
    """What a planner earns in each episode, and how much more than the heuristic's mean on the same rocks."""
    ahead = []
    for seed, value in enumerate(returns):
        same = heuristic(), BY_RANK, np.random.default_rng(seed), rocks_of(seed)
        ahead.append(value - play(REPLAYS, *same).returns.mean())
    return {"returns": np.round(returns, 3).tolist(), "ahead": np.round(ahead, 3).tolist()}


def tables(report: dict[str, Any]) -> str:
    """Values in one table, below those that no log is needed for."""
    rows = [
        [
            f"{row['log']}, {row['size']:,}",
            *(f"{np.mean(each):.1f} ({min(each):.1f})" for each in row["values"].values()),
        ]
        for row in report["rows"]
    ]
    known = {"clairvoyant": report["clairvoyant"], **report["known"]}
    facts = [f"published: {listed(PUBLISHED)}", f"here, with errors up to {report['error']:.2f}: {listed(known)}"]
    if report["POMCP"]:
        returns, ahead, number = (report["POMCP"][name] for name in ("returns", "ahead", "simulations"))
        pace = f"POMCP by {number:,} simulations a decision {with_error(returns, 1)} in {len(returns)} worlds"
        facts.append(f"{pace}, there against the heuristic {with_error(ahead, 1)}")
    facts.append(f"learned: mean of {report['repetitions']} logs (lowest)")
    return f"*{'; '.join(facts)}*\n\n{markdown(['log', *DESIGNS], rows)}"


def listed(values: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {value:.1f}" for name, value in values.items())


def main() -> None:
    parser = asked(__doc__, "rocksample", 4)
    parser.add_argument("--sizes", nargs="+", type=int, default=list(SIZES), help="trajectories of a log")
    parser.add_argument("--logs", nargs="+", choices=EXPLORES, default=list(EXPLORES), help="whose (%(default)s)")
    parser.add_argument("--episodes", type=int, default=30, help="of POMCP; 0 leaves it out (%(default)s)")
    parser.add_argument("--simulations", type=int, default=0, help="of POMCP a decision; 0 for a second of this core")
    options = parser.parse_args()
    rules = {"heuristic": 0.0} | {f"log of {name}": share for name, share in EXPLORES.items()}
    known = {name: earned(heuristic(share), BY_RANK) for name, share in rules.items()}
    facts = {
        "known": {name: round(value, 3) for name, (value, _) in known.items()},
        "error": round(max(error for _, error in known.values()), 3),
        "clairvoyant": round(float(best_routes()[:, NUM].mean()), 3),
        "POMCP": planner(options.episodes, options.simulations) if options.episodes else None,
    }
    cells = [(log, cut, size, options.repetitions) for log in options.logs for cut in CUTS for size in options.sizes]
    run(options.out, cells, measured, tables, repetitions=options.repetitions, **facts)


if __name__ == "__main__":
    main()
