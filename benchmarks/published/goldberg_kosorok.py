"""The simulated trial of the paper that eq. 3 comes from [Goldberg, Kosorok, Annals of Statistics 40:529, 2012].

PYTHONPATH=benchmarks python benchmarks/published/goldberg_kosorok.py [--out …/goldberg_kosorok.json] [--sizes N …]
                                                                      [--repetitions 20] [--shares SHARE …]

Wellness W is uniform on [½, 1]; the tumour has size 1 at each of at most three decisions in three years. Treatment A
leaves W⁺ = W − ½ and M⁺ = 1/(10 W), B leaves W − ¼ and 2/(10 W). Then W(u) = W⁺ + (1 − W⁺)(1 − 2^(−u/2)), and the
tumour grows by 4/3 M⁺ a year, until it has size 1 again. Death comes at the rate 20 M⁺ / (3 (W⁺ + 2)), and at once if
W⁺ < ¼. So all but death is a function of W and the treatments, and the value of a policy is a mean over W without
draws. Cuts are exponential. The axes are those of the paper's first figure (months; means over 400 trials by size and
share of cuts); it has no table, and the sizes here are our own. *Derived* was worked out for this project before, from
the paper's dynamics, by other code.
"""

from collections.abc import Callable
from functools import cache
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int
from peers.side_by_side import asked, markdown, run, with_error
from scipy.optimize import brentq

from halfseen.learning import CensoredQLearner
from halfseen.logs import Logs

HORIZON, YEARS, MONTHS = 3, 3.0, 12.0
ACTIONS = ("A", "B")
COSTS, LEFT = np.array([0.5, 0.25]), np.array([0.1, 0.2])
FEWEST = 0.25
GRID = 0.5 + 0.5 * (np.arange(2000) + 0.5) / 2000

Rule = Callable[[Float[np.ndarray, " m"], int], Int[np.ndarray, " m"]]
"""(W, stage from 1) → index of the treatment."""


class Course(NamedTuple):
    """What a treatment makes of a stage."""

    dies_at_once: Bool[np.ndarray, " m"]
    rate: Float[np.ndarray, " m"]
    """Of death [1/years]."""
    years: Float[np.ndarray, " m"]
    """Until the next decision; infinite in the last stage."""
    wellness: Float[np.ndarray, " m"]
    """At the next decision."""


def course(wellness: Float[np.ndarray, " m"], action: Int[np.ndarray, " m"], stage: int) -> Course:
    well, tumour = wellness - COSTS[action], LEFT[action] / wellness
    years = (1.0 - tumour) / (4.0 / 3.0 * tumour)
    after = well + (1.0 - well) * (1.0 - 2.0 ** (-years / 2.0))
    rate = 20.0 * tumour / (3.0 * (well + 2.0))
    # W − ½ of ¾ is a quarter, which rounding must not kill.
    return Course(well < FEWEST - 1e-12, rate, years if stage < HORIZON else np.full_like(years, np.inf), after)


def value(rule: Rule) -> float:
    """E min(T, 3) under a policy [months], exactly."""
    wellness, lived, alive, total = GRID, np.zeros(len(GRID)), np.ones(len(GRID)), 0.0
    for stage in range(1, HORIZON + 1):
        found = course(wellness, rule(wellness, stage), stage)
        alive = alive * ~found.dies_at_once
        years = np.minimum(found.years, YEARS - lived)
        total = total + alive * -np.expm1(-found.rate * years) / found.rate
        alive, lived, wellness = alive * np.exp(-found.rate * years), lived + years, found.wellness
    return MONTHS * float(np.mean(total))


def sequence(actions: tuple[int, ...]) -> Rule:
    return lambda wellness, stage: np.full(len(wellness), actions[stage - 1])


def best(wellness: Float[np.ndarray, " m"], stage: int) -> Int[np.ndarray, " m"]:
    """A at first where W ≥ ¾; else B, the only one that most survive, and that leads to another decision in time."""
    return np.where((stage == 1) & (wellness >= 0.75), 0, 1)


@cache
def plain() -> dict[str, float]:
    """Values of what needs no log [months]."""
    sequences = {actions: value(sequence(actions)) for actions in product((0, 1), repeat=HORIZON)}
    chance = float(np.mean(list(sequences.values())))
    return {"optimum": value(best), "B B B": sequences[1, 1, 1], "A A A": sequences[0, 0, 0], "random": chance}


def lives(num: int, rng: np.random.Generator) -> pd.DataFrame:
    """Follow randomised patients for three years, with nobody cut: a row for each stage."""
    patient, wellness, lived, parts = np.arange(num), rng.uniform(0.5, 1.0, num), np.zeros(num), []
    for stage in range(1, HORIZON + 1):
        action = rng.integers(0, 2, len(patient))
        found = course(wellness, action, stage)
        death = np.where(found.dies_at_once, 1e-6, rng.exponential(size=len(patient)) / found.rate)
        years = np.minimum(np.minimum(death, found.years), YEARS - lived)
        columns = {"trajectory": patient, "stage": stage, "wellness": wellness, "treated": action, "years": years}
        parts.append(pd.DataFrame({**columns, "lived": lived + years}))
        goes_on = (years == found.years) & (lived + years < YEARS)
        patient, wellness, lived = patient[goes_on], found.wellness[goes_on], (lived + years)[goes_on]
    return pd.concat(parts, ignore_index=True).sort_values(["trajectory", "stage"], ignore_index=True)


@cache
def cut_rate(share: float) -> float:
    """Rate of the exponential cuts that cuts a share of the patients [1/years]."""
    total = lives(20_000, np.random.default_rng(0)).groupby("trajectory")["lived"].max().to_numpy()
    root: Any = brentq(lambda rate: float(-np.expm1(-rate * total).mean()) - share, 0.0, 100.0)
    return float(root)


def log(num: int, share: float, seed: int) -> Logs:
    """Run the trial, and cut a share of it in expectation; rewards are years."""
    rows = lives(num, np.random.default_rng([seed, 0]))
    cut = np.full(num, np.inf)
    if share > 0:
        cut = np.random.default_rng([seed, 1]).exponential(size=num) / cut_rate(share)
    is_begun, is_seen = (
        rows["lived"] - rows["years"] <= cut[rows["trajectory"]],
        rows["lived"] <= cut[rows["trajectory"]],
    )
    end = rows.groupby("trajectory")["lived"].max().to_numpy()
    stages = rows[["trajectory", "stage", "wellness"]].assign(
        elapsed_s=rows["lived"].where(is_seen),
        reward=rows["years"].where(is_seen),
        action=np.array(ACTIONS, dtype=object)[rows["treated"]],
        probability=0.5,
    )
    ends = {
        "trajectory": np.arange(num),
        "end_s": np.minimum(end, cut),
        "ending": np.where(end > cut, "cut", "finished"),
    }
    return Logs(stages[is_begun], pd.DataFrame(ends))


def learned(logs: Logs, is_paper: bool = True, **parameters: Any) -> Rule:
    make = CensoredQLearner.of_paper if is_paper else CensoredQLearner
    fitted = make(HORIZON, ACTIONS, ["wellness"], **parameters).fit(logs)
    return lambda wellness, stage: (fitted.decide(pd.DataFrame({"wellness": wellness}), stage) == "B").astype(int)


METHODS: dict[str, Callable[[Logs], Rule]] = {
    "default": lambda logs: learned(logs, is_paper=False),
    "eq. 3, linear": learned,
    "eq. 3, RKHS": lambda logs: learned(logs, q_function="kernel"),
    "uncut only": lambda logs: learned(logs.select(logs.trajectory_ids[logs.is_finished])),
}


def measured(size: int, share: float, repetitions: int) -> dict[str, Any]:
    """Exact values of what each method learns, log by log."""
    found: dict[str, list[float]] = {name: [] for name in METHODS}
    for seed in range(repetitions):
        logs = log(size, share, seed)
        for name, method in METHODS.items():
            found[name].append(round(value(method(logs)), 4))
    return {"size": size, "share": share, "values": found}


DERIVED = {0.0: 1.409, 0.1: 1.409, 0.2: 1.410, 0.3: 1.409, 0.5: 1.354}
"""What linear eq. 3 earns from 1,000 trajectories [years], by share of cuts."""


def tables(report: dict[str, Any]) -> str:
    """E min(T, 3) by size and share of cuts."""
    rows = []
    for row in report["rows"]:
        derived = f"{MONTHS * DERIVED[row['share']]:.2f}" if row["size"] == 1000 and row["share"] in DERIVED else ""
        cells = [with_error(row["values"][name], 2) for name in METHODS]
        rows.append([f"{row['size']:,}, {row['share']:.0%} cut", derived, *cells])
    exact = ", ".join(f"{name} {months:.2f}" for name, months in report["plain"].items())
    head = ("patients", "eq. 3, linear, derived", *METHODS)
    return f"*E min(T, 3) [months]; exactly: {exact}*\n\n{markdown(head, rows)}"


def main() -> None:
    parser = asked(__doc__, "goldberg_kosorok", 20)
    parser.add_argument("--sizes", type=int, nargs="+", default=[50, 100, 200, 400, 1000], help="patients of a log")
    parser.add_argument("--shares", type=float, nargs="+", default=[0.0, 0.1, 0.2, 0.3, 0.5], help="of patients cut")
    options = parser.parse_args()
    cells = [(size, share, options.repetitions) for share in options.shares for size in options.sizes]
    run(options.out, cells, measured, tables, repetitions=options.repetitions, plain=plain())


if __name__ == "__main__":
    main()
