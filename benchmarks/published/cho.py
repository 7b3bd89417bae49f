"""Three stages, ten years: cuts depend on covariates and action [Cho, Holloway, Couper, Kosorok, Biometrika 2023].

PYTHONPATH=benchmarks python benchmarks/published/cho.py [--out …/cho.json] [--repetitions 20] [--cells NAME …]
                                                         [--sizes 300 1000]

Dynamics and coefficients are those of the paper's simulation (arXiv 2012.03294); its results are box plots without a
table. A treatment divides the tumour by 10 and costs half of wellness (+1), or by 4 and a quarter (−1); then both grow
again, with noise, until the tumour calls for the next decision. Learners see Z and log(1 + years lived) alone. Policies
are judged by E min(T, 10) and S(5) of the same patients, uncut: each patient counts with the probability of being
alive, so that 1,000 of them tell as much as several times as many deaths. *Default, linear* imputes as the default
does, but has a linear Q for each stage, and no pessimism. When the default has a trend over the stages, and when it
does not follow the log, was chosen on logs of seeds 500 to 727 of this world, too; here they begin at 0.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int
from peers.side_by_side import asked, markdown, mean_and_error, run, with_error
from peers.staged_survival import Rule, dwsurv_rules, forest_rules, stage_times
from scipy.signal import lfilter
from scipy.special import expit
from worlds.world import Chances

from halfseen.learning import CensoredQLearner, Weighted
from halfseen.logs import Logs

HORIZON, YEARS, FIVE, TICK = 3, 10.0, 5.0, 0.01
NUM_TICKS = round(YEARS / TICK)
ACTIONS = ("-1", "+1")
SHRINKS, COSTS = np.array([4.0, 10.0]), np.array([0.25, 0.5])
NOISE_MEAN = TICK * np.array([0.1, 0.05])
NOISE_ROOT = TICK * np.linalg.cholesky([[1.0, -0.5], [-0.5, 1.0]])
NOISE_KEPT = 0.98
NUM_JUDGED, FIRST_JUDGED_SEED = 1000, 10_000


class World(NamedTuple):
    """Coefficients of (1, log(1 + years lived), Z)."""

    hazard: Float[np.ndarray, "2 p2"]
    """Of the log hazard, by action."""
    cuts: Float[np.ndarray, "2 p2"]
    """Of the log rate of cuts, by action."""
    treatment: Float[np.ndarray, " p2"]
    """Of the log-odds of +1 in the log."""

    @property
    def covariates(self) -> list[str]:
        return ["lived", *(f"z{k}" for k in range(1, self.hazard.shape[1] - 1))]

    def logging(self, frame: pd.DataFrame, stage: int) -> Float[np.ndarray, "m 2"]:
        chance = expit(self.treatment[0] + frame[self.covariates].to_numpy() @ self.treatment[1:])
        return np.column_stack([1.0 - chance, chance])


def world(
    hazard: Sequence[Sequence[float]], cuts: Sequence[Sequence[float]], intercept: float, is_trial: bool
) -> World:
    num_covariates = len(cuts[0])
    lived = ([0.1], [0.0])
    return World(
        np.array([[0.0, *row] for row in hazard]),
        np.array([[intercept, *first, *0.2 * np.array(rest)] for first, rest in zip(lived, cuts, strict=True)]),
        np.zeros(2 + num_covariates) if is_trial else np.array([0.0, 1.0, *[-0.5] * num_covariates]),
    )


FIVE_COVARIATES = (([-1, 1, 1, 1, 1, 1], [-3, 2, 2, 1, -1, -1]), ([1, 1, 1, 1, 1], [1, 1, 1, -1, -1]))
SETTINGS = {
    "d = 5": (*FIVE_COVARIATES, -3.0),
    "d = 5, more cuts": (*FIVE_COVARIATES, -2.0),
    "d = 2": (([-1, 1, 1], [-2, 2, 0]), ([1, 1], [1, -1]), -3.0),
    "d = 10": (
        ([-1, *[1] * 8, 0, 0], [-2, *[2] * 4, *[-1] * 4, -2, -2]),
        ([*[1] * 7, 0, 0, 0], [*[1] * 4, *[-1] * 3, 0, 0, 0]),
        -3.0,
    ),
}
WORLDS = {
    f"{name}, {kind}": world(*setting, kind == "trial")
    for name, setting in SETTINGS.items()
    for kind in ("observed", "trial")
}


class Patients(NamedTuple):
    """Who begin a stage."""

    who: Int[np.ndarray, " m"]
    lived: Float[np.ndarray, " m"]
    """Years so far."""
    tumour: Float[np.ndarray, " m"]
    wellness: Float[np.ndarray, " m"]
    z: Float[np.ndarray, "m p"]

    @property
    def frame(self) -> pd.DataFrame:
        names = pd.Index(["lived", *(f"z{k}" for k in range(1, self.z.shape[1] + 1))])
        return pd.DataFrame(np.column_stack([np.log1p(self.lived), self.z]), columns=names)

    def rate(self, coefficients: Float[np.ndarray, "m p2"]) -> Float[np.ndarray, " m"]:
        return np.exp(coefficients[:, 0] + (self.frame.to_numpy() * coefficients[:, 1:]).sum(axis=1))

    def take(self, kept: Bool[np.ndarray, " m"]) -> "Patients":
        return Patients(*(each[kept] for each in self))


class Luck(NamedTuple):
    """What a stage draws for each patient, whatever is done."""

    chosen: Float[np.ndarray, " n"]
    noise: Float[np.ndarray, "n ticks 2"]
    """Of tumour and wellness."""
    fresh: Float[np.ndarray, "n p"]
    """Of the next covariates."""


class Course(NamedTuple):
    """What a stage is until the next decision or the tenth year, if nobody dies."""

    action: Int[np.ndarray, " m"]
    ticks: Int[np.ndarray, " m"]
    goes_on: Bool[np.ndarray, " m"]
    hazard: Float[np.ndarray, "m ticks"]
    """Cumulative, at the end of each tick."""
    after: Patients


def correlated(num: int, num_covariates: int, rng: np.random.Generator) -> Float[np.ndarray, "n p"]:
    """Normal, of variance 1 and covariance .2."""
    return np.sqrt(0.8) * rng.normal(size=(num, num_covariates)) + np.sqrt(0.2) * rng.normal(size=(num, 1))


@lru_cache(maxsize=HORIZON)
def luck(num: int, num_covariates: int, seed: int, stage: int) -> Luck:
    rng = np.random.default_rng([seed, stage])
    shocks = rng.normal(size=(num, NUM_TICKS, 2)) @ NOISE_ROOT.T + NOISE_MEAN
    noise = 2.0 * lfilter([1.0], [1.0, -NOISE_KEPT], shocks, axis=1)
    return Luck(rng.random(num), np.asarray(noise), correlated(num, num_covariates, rng))


def entering(num: int, num_covariates: int, seed: int) -> Patients:
    rng = np.random.default_rng([seed, 0])
    tumour, wellness = rng.uniform(0.5, 1.0, (2, num))
    return Patients(np.arange(num), np.zeros(num), tumour, wellness, correlated(num, num_covariates, rng))


def course(world: World, patients: Patients, chances: Chances, stage: int, drawn: Luck) -> Course:
    """Treat patients, and follow tumour, wellness and hazard on the ticks of ten years."""
    who, rows, t = patients.who, np.arange(len(patients.who)), TICK * np.arange(NUM_TICKS)
    action = (drawn.chosen[who] > chances(patients.frame, stage)[:, 0]).astype(int)
    begun = (patients.tumour / patients.wellness / SHRINKS[action])[:, None]
    left = (patients.wellness - COSTS[action])[:, None]
    noise = drawn.noise[who]
    tumour = np.maximum(0.0, noise[..., 0] + begun * (1.0 + 2.0 * t))
    wellness = np.maximum(0.1, noise[..., 1] + left + (1.0 - left) * -np.expm1(-t / 2.0))
    risk = patients.rate(world.hazard[action])[:, None]
    hazard = np.cumsum((tumour / wellness * risk + (wellness <= 0.1)) * TICK / 5.0, axis=1)
    is_grown = tumour >= 1.0
    calls_at = np.where(is_grown.any(axis=1) & (stage < HORIZON), is_grown.argmax(axis=1) + 1, NUM_TICKS + 1)
    most = np.round((YEARS - patients.lived) / TICK).astype(int)
    ticks = np.minimum(calls_at, most)
    tumour, wellness = tumour[rows, ticks - 1], wellness[rows, ticks - 1]
    z = 0.5 * (patients.z + drawn.fresh[who])
    z[:, :2] = 0.2 * z[:, :2] + 0.8 * np.column_stack([tumour, wellness])
    after = Patients(who, patients.lived + TICK * ticks, tumour, wellness, z)
    return Course(action, ticks, calls_at < most, hazard, after)


def values(world: World, chances: Chances, num: int, seed: int) -> tuple[float, float]:
    """E min(T, 10) [years] and S(5) of a policy; the same seed gives every policy the same patients."""
    num_covariates = len(world.covariates) - 1
    patients, alive = entering(num, num_covariates, seed), np.ones(num)
    years, five = np.zeros(num), np.zeros(num)
    for stage in range(1, HORIZON + 1):
        found = course(world, patients, chances, stage, luck(num, num_covariates, seed, stage))
        who, rows, last = patients.who, np.arange(len(patients.who)), found.ticks - 1
        survival = alive[who, None] * np.exp(-found.hazard)
        years[who] += TICK * np.cumsum(survival, axis=1)[rows, last]
        fifth = np.round((FIVE - patients.lived) / TICK).astype(int) - 1
        is_here = (fifth >= 0) & (fifth <= last)
        five[who[is_here]] = survival[rows[is_here], fifth[is_here]]
        alive[who] = survival[rows, last]
        patients = found.after.take(found.goes_on)
    return float(years.mean()), float(five.mean())


def log(world: World, num: int, seed: int) -> Logs:
    """Run the study, and cut it; rewards are years, and who lives for ten has finished."""
    rng, num_covariates = np.random.default_rng([seed, HORIZON + 1]), len(world.covariates) - 1
    patients, end, is_cut, parts = entering(num, num_covariates, seed), np.zeros(num), np.zeros(num, dtype=bool), []
    for stage in range(1, HORIZON + 1):
        found = course(world, patients, world.logging, stage, luck(num, num_covariates, seed, stage))
        who, action = patients.who, found.action
        patience, cut_after = rng.exponential(size=(2, num))[:, who]
        dies = found.hazard >= patience[:, None]
        dies_at = np.where(dies.any(axis=1), dies.argmax(axis=1) + 1, NUM_TICKS + 1)
        years, cut_after = TICK * np.minimum(dies_at, found.ticks), cut_after / patients.rate(world.cuts[action])
        is_seen = years <= cut_after
        end[who], is_cut[who] = patients.lived + np.minimum(years, cut_after), ~is_seen
        frame = patients.frame
        columns = {
            "trajectory": who,
            "stage": stage,
            "elapsed_s": np.where(is_seen, end[who], np.nan),
            "action": np.array(ACTIONS, dtype=object)[action],
            "reward": np.where(is_seen, years, np.nan),
            "probability": world.logging(frame, stage)[np.arange(len(who)), action],
        }
        parts.append(frame.assign(**columns))
        patients = found.after.take(is_seen & found.goes_on & (dies_at > found.ticks))
    stages = pd.concat(parts, ignore_index=True).sort_values(["trajectory", "stage"], ignore_index=True)
    ending = np.where(is_cut, "cut", "finished")
    return Logs(stages, pd.DataFrame({"trajectory": np.arange(num), "end_s": end, "ending": ending}))


def learned(world: World, logs: Logs, covariates: Sequence[str] | None = None, **parameters: Any) -> Chances:
    looks_at = world.covariates if covariates is None else covariates
    fitted = CensoredQLearner(HORIZON, ACTIONS, looks_at, **parameters).fit(logs)
    return fitted.policy_.probabilities


def by_rules(world: World, rules: Sequence[Rule]) -> Chances:
    return lambda frame, stage: np.eye(2)[rules[stage - 1](frame[world.covariates].to_numpy()).astype(int)]


def forest(world: World, logs: Logs) -> Chances:
    return by_rules(world, forest_rules(stage_times(logs, world.covariates, ACTIONS[1])))


def dwsurv(world: World, logs: Logs) -> Chances:
    return by_rules(world, dwsurv_rules(stage_times(logs, world.covariates, ACTIONS[1])))


PAPER = {"q_function": "linear", "stages": "separate", "pessimism": 0.0}
BY_KAPLAN_MEIER, BY_COX = {"censoring": "kaplan-meier", **PAPER}, {"censoring": Weighted("cox", by="pooled"), **PAPER}
SIMPLER = "default, linear"
METHODS: dict[str, Callable[[World, Logs], Chances]] = {
    "default": learned,
    SIMPLER: lambda world, logs: learned(world, logs, **PAPER),
    "eq. 3, Kaplan–Meier": lambda world, logs: learned(world, logs, **BY_KAPLAN_MEIER),
    "eq. 3, Cox": lambda world, logs: learned(world, logs, **BY_COX),
    "survival forest": forest,
    "DWSurv": dwsurv,
    "zero-order": lambda world, logs: learned(world, logs, (), **BY_KAPLAN_MEIER),
    "observed": lambda world, logs: world.logging,
}
CRITERIA = ("years", "five")


def measured(cell: str, size: int, repetitions: int, num_judged: int = NUM_JUDGED) -> dict[str, Any]:
    """Values of each method's policy, log by log."""
    world, found = WORLDS[cell], {name: {criterion: [] for criterion in CRITERIA} for name in METHODS}
    for seed in range(repetitions):
        logs = log(world, size, seed)
        for name, method in METHODS.items():
            policy = method(world, logs)
            for criterion, value in zip(
                CRITERIA, values(world, policy, num_judged, FIRST_JUDGED_SEED + seed), strict=True
            ):
                found[name][criterion].append(round(value, 4))
    return {"cell": cell, "size": size, "values": found}


def lead(row: dict[str, Any], criterion: str) -> tuple[float, float]:
    """The default less the best of the peers, log by log: mean and standard error."""
    values = {name: np.array(of_method[criterion]) for name, of_method in row["values"].items() if name != SIMPLER}
    ours = values.pop("default")
    best = max(values, key=lambda name: values[name].mean())
    return mean_and_error(ours - values[best])


def tables(report: dict[str, Any]) -> str:
    """E min(T, 10) and S(5) of each method, and how far the default is ahead of the best peer."""
    parts = []
    for criterion, title in zip(CRITERIA, ("E min(T, 10) [years]", "S(5)"), strict=True):
        rows = [
            [
                f"{row['cell']}, n = {row['size']:,}",
                *(with_error(row["values"][name][criterion]) for name in METHODS),
                "{:+.3f} ± {:.3f}".format(*lead(row, criterion)).replace("-", "−"),
            ]
            for row in report["rows"]
        ]
        parts.append(f"*{title}*\n\n{markdown(('cell', *METHODS, 'default − best peer'), rows)}")
    return "\n\n".join(parts)


def main() -> None:
    parser = asked(__doc__, "cho", 20)
    parser.add_argument("--cells", nargs="+", choices=WORLDS, default=list(WORLDS))
    parser.add_argument("--sizes", nargs="+", type=int, default=[300, 1000], help="patients of a log")
    options = parser.parse_args()
    cells = [(cell, size, options.repetitions) for cell in options.cells for size in options.sizes]
    run(options.out, cells, measured, tables, repetitions=options.repetitions, judged=NUM_JUDGED)


if __name__ == "__main__":
    main()
