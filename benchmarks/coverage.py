"""Do 95 % intervals of a policy's value cover the truth, when trajectories of the log were cut?

python benchmarks/coverage.py [--out runs/benchmarks/coverage.json] [--logs 200] [--row NAME ...]

A log is a trial of 400 patients and up to three stages: a state in {0, 1, 2}, and an action in {A, B} that the logging
policy draws with a probability that depends on the state. A stage lasts longer or shorter, what it pays grows with how
long it lasted, and after it a patient may leave. The policy takes A in state 0, B in state 2, and in state 1 either.
Its value is computed by enumeration. Cuts come at a constant rate, which cuts none, a third or half of
the trajectories; in the last rows at a rate that depends on a covariate z that rewards depend on, too.

cut 0, 1/3, 1/2             cuts depend on nothing; Q has the states as indicators; weights are at most 10
cut 1/2, unbounded          the same without a bound: Ĝ of nine tenths of a log may end before the last tenth
wrong Q                     half are cut; Q and the regression of cut stages see nothing but the action
by z, wrong cuts            half are cut, by z; Ĝ is Kaplan–Meier's, Q and the regression are right
by z, wrong cuts, simple    the same by weights alone
by z, right cuts            the same logs, and Ĝ is Cox's, given z
by z, right cuts, wrong Q   Ĝ is Cox's, and Q and the regression see nothing but the action
"""

import argparse
import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.optimize import brentq
from scipy.stats import beta

from halfseen.evaluation import QSpec, evaluate
from halfseen.learning import DoublyRobust, NamedActions, Weighted
from halfseen.learning.targets import Targets
from halfseen.logs import Logs

NUM_PATIENTS, HORIZON, NUM_STATES, ACTIONS = 400, 3, 3, ("A", "B")
ESTIMATORS = ("importance_sampling", "fitted_q", "doubly_robust", "logging", "difference")

LOGGING_B = np.array([0.35, 0.5, 0.65])
TARGET_B = np.array([0.0, 0.5, 1.0])
START = np.array([0.3, 0.4, 0.3])
MEAN_S = np.array([[2.0, 3.0], [3.0, 2.5], [2.5, 4.0]])
"""Mean duration of a stage, by state and action."""
LONGEST_S = 9.0
BONUS = np.array([[1.0, -0.5], [0.0, 0.5], [-1.0, 1.0]])
PER_SECOND, PER_Z = 0.6, 1.0
LEAVES = np.array([[0.1, 0.25], [0.15, 0.15], [0.3, 0.1]])
NEXT = np.array(
    [[[0.5, 0.3, 0.2], [0.2, 0.4, 0.4]], [[0.4, 0.4, 0.2], [0.2, 0.3, 0.5]], [[0.6, 0.3, 0.1], [0.1, 0.3, 0.6]]]
)
Z_STEEPNESS = 1.2
"""Log of how much more often those with z = 1 are cut than those with z = 0 …"""
Z_SLOWER = 0.4
"""… and of how much longer their stages last."""


@dataclass(frozen=True)
class Patients:
    """A trial that nothing has cut."""

    z: np.ndarray
    state: np.ndarray
    is_b: np.ndarray
    duration_s: np.ndarray
    reward: np.ndarray
    num_stages: np.ndarray

    @property
    def total_s(self) -> np.ndarray:
        taken = np.arange(HORIZON) < self.num_stages[:, None]
        return (self.duration_s * taken).sum(axis=1)


@dataclass(frozen=True)
class TargetPolicy:
    """What is evaluated, as a policy of named actions."""

    chance_b: tuple[float, ...] = tuple(TARGET_B)
    actions: tuple[str, ...] = ACTIONS
    horizon: int = HORIZON

    def probabilities(self, frame: pd.DataFrame, stage: int) -> np.ndarray:
        chance_b = np.array(self.chance_b)[frame["state"].to_numpy(dtype=int)]
        return np.stack([1.0 - chance_b, chance_b], axis=1)


def treated(num: int, rng: np.random.Generator) -> Patients:
    shape = (num, HORIZON)
    z = (rng.random(num) < 0.5).astype(float)
    state, is_b = np.zeros(shape, dtype=int), np.zeros(shape, dtype=int)
    leaves = np.zeros(shape, dtype=bool)
    current = rng.choice(NUM_STATES, size=num, p=START)
    for t in range(HORIZON):
        state[:, t] = current
        is_b[:, t] = rng.random(num) < LOGGING_B[current]
        leaves[:, t] = rng.random(num) < LEAVES[current, is_b[:, t]]
        chances = NEXT[current, is_b[:, t]].cumsum(axis=1)
        current = (rng.random(num)[:, None] > chances).sum(axis=1).clip(max=NUM_STATES - 1)
    mean_s = MEAN_S[state, is_b] * np.exp(Z_SLOWER * z)[:, None]
    # Hazards are proportional, so the model of durations can be right: P(D > u) = (1 − u / LONGEST_S) ** power.
    power = LONGEST_S / mean_s - 1.0
    duration_s = LONGEST_S * (1.0 - rng.random(shape) ** (1.0 / power))
    reward = BONUS[state, is_b] + PER_SECOND * duration_s + PER_Z * z[:, None] + 0.5 * rng.normal(size=shape)
    leaves[:, -1] = True
    return Patients(z, state, is_b, duration_s, reward, leaves.argmax(axis=1) + 1)


def true_value(chance_b: np.ndarray) -> float:
    """E[Σ_t R_t] of a policy, by enumeration of states, actions and z."""
    total = 0.0
    for z in (0.0, 1.0):
        pays = BONUS + PER_SECOND * MEAN_S * np.exp(Z_SLOWER * z) + PER_Z * z
        chance = np.stack([1.0 - chance_b, chance_b], axis=1)
        value = np.zeros(NUM_STATES)
        for t in reversed(range(HORIZON)):
            after = (1.0 - LEAVES) * (NEXT @ value) if t < HORIZON - 1 else 0.0
            value = (chance * (pays + after)).sum(axis=1)
        total += 0.5 * float(START @ value)
    return total


def cut_rates(share: float, steepness: float) -> np.ndarray:
    """Rate of cuts [1/s] of z = 0 and z = 1 that cuts this share of the trajectories."""
    pilot = treated(100_000, np.random.default_rng(0))
    relative = np.exp(steepness * np.array([0.0, 1.0]))
    if share == 0.0:
        return 0.0 * relative
    exposure = pilot.total_s * relative[pilot.z.astype(int)]
    return float(brentq(lambda rate: 1.0 - np.exp(-rate * exposure).mean() - share, 1e-6, 10.0)) * relative


def recorded(patients: Patients, rates: np.ndarray, rng: np.random.Generator) -> Logs:
    """What is left once cuts have come; the action of the stage in which a patient was lost is known."""
    rate = rates[patients.z.astype(int)]
    cut_s = np.where(rate > 0, rng.exponential(size=len(rate)) / np.where(rate > 0, rate, 1.0), np.inf)
    elapsed_s = patients.duration_s.cumsum(axis=1)
    exists = np.arange(HORIZON) < patients.num_stages[:, None]
    is_completed = exists & (elapsed_s <= cut_s[:, None])
    is_begun = exists & ((elapsed_s - patients.duration_s) <= cut_s[:, None])
    trajectory, t = np.nonzero(is_begun)
    state, is_b = patients.state[trajectory, t], patients.is_b[trajectory, t]
    completed = is_completed[trajectory, t]
    chance_b = LOGGING_B[state]
    stages = pd.DataFrame(
        {
            "trajectory": trajectory,
            "stage": t + 1,
            "elapsed_s": np.where(completed, elapsed_s[trajectory, t], np.nan),
            "action": np.array(ACTIONS)[is_b],
            "reward": np.where(completed, patients.reward[trajectory, t], np.nan),
            "probability": np.where(is_b == 1, chance_b, 1.0 - chance_b),
            "state": state,
            "is_1": (state == 1).astype(float),
            "is_2": (state == 2).astype(float),
            "z": patients.z[trajectory],
            "z_1": patients.z[trajectory] * (state == 1),
            "z_2": patients.z[trajectory] * (state == 2),
        }
    )
    is_cut = cut_s < patients.total_s
    trajectories = pd.DataFrame(
        {
            "trajectory": np.arange(len(rate)),
            "end_s": np.minimum(cut_s, patients.total_s),
            "ending": np.where(is_cut, "cut", "finished"),
        }
    )
    return Logs(stages, trajectories)


def simulated(seed: int, rates: np.ndarray, num: int = NUM_PATIENTS) -> Logs:
    rng = np.random.default_rng(seed)
    return recorded(treated(num, rng), rates, rng)


# Saturated in the states, which is right where z is not observed. A penalty is a little wrong, too; where one model is
# to be right, there is next to none.
STATES = QSpec(NamedActions(ACTIONS, ("is_1", "is_2")))
WITH_Z = QSpec(NamedActions(ACTIONS, ("is_1", "is_2", "z", "z_1", "z_2")), reg=1e-4)
BLIND = QSpec(NamedActions(ACTIONS), reg=1e-4)
BOUNDED: dict[str, Any] = {"truncate_at": 10}
"""As `evaluate` has it where nothing is said."""
BY_KM, BY_COX = DoublyRobust(**BOUNDED), DoublyRobust("cox", covariates=["z"], **BOUNDED)

ROWS: dict[str, tuple[float, float, Targets, QSpec]] = {
    "cut 0": (0.0, 0.0, BY_KM, STATES),
    "cut 1/3": (1 / 3, 0.0, BY_KM, STATES),
    "cut 1/2": (1 / 2, 0.0, BY_KM, STATES),
    "cut 1/2, unbounded": (1 / 2, 0.0, DoublyRobust(), STATES),
    "wrong Q": (1 / 2, 0.0, BY_KM, BLIND),
    "by z, wrong cuts": (1 / 2, Z_STEEPNESS, BY_KM, WITH_Z),
    "by z, wrong cuts, simple": (1 / 2, Z_STEEPNESS, Weighted(), WITH_Z),
    "by z, right cuts": (1 / 2, Z_STEEPNESS, BY_COX, WITH_Z),
    "by z, right cuts, wrong Q": (1 / 2, Z_STEEPNESS, BY_COX, BLIND),
}


def measured(name: str, num_logs: int) -> list[dict[str, Any]]:
    """One row for each estimator."""
    share, steepness, censoring, q = ROWS[name]
    rates = cut_rates(share, steepness)
    policy, value, own = TargetPolicy(), true_value(TARGET_B), true_value(LOGGING_B)
    truths = dict.fromkeys(ESTIMATORS, value) | {"logging": own, "difference": value - own}
    found, cut, verdicts = {name: [] for name in ESTIMATORS}, [], []
    for seed in range(num_logs):
        logs = simulated(seed, rates)
        answer = evaluate(policy, logs, against="logging", censoring=censoring, q=q, random_state=seed)
        cut.append(1.0 - logs.is_finished.mean())
        verdicts.append(answer.verdict)
        for estimator in ESTIMATORS:
            one = getattr(answer, estimator)
            found[estimator].append((one.value, one.low, one.high, one.standard_error, one.effective_sample_size))
    rows = []
    for estimator, truth in truths.items():
        values, low, high, errors, sizes = np.array(found[estimator]).T
        covered = int(((low <= truth) & (truth <= high)).sum())
        bounds = beta.ppf(0.025, covered, num_logs - covered + 1), beta.ppf(0.975, covered + 1, num_logs - covered)
        rows.append(
            {
                "row": name,
                "estimator": estimator,
                "share_cut": float(np.mean(cut)),
                "truth": truth,
                "bias": float(values.mean() - truth),
                "bias_error": float(values.std(ddof=1) / np.sqrt(num_logs)),
                "spread": float(values.std(ddof=1)),
                "mean_standard_error": float(errors.mean()),
                "mean_width": float((high - low).mean()),
                "coverage": covered / num_logs,
                "coverage_low": float(np.nan_to_num(bounds[0], nan=0.0)),
                "coverage_high": float(np.nan_to_num(bounds[1], nan=1.0)),
                "effective_sample_size": float(sizes.mean()),
                "share_better": verdicts.count("better") / num_logs,
            }
        )
    return rows


def line(row: dict[str, Any]) -> str:
    interval = f"{row['coverage_low']:.1%}–{row['coverage_high']:.1%}"
    return (
        f"{row['estimator']:<20}{row['bias']:>+9.3f} ± {row['bias_error']:.3f}{row['spread']:>8.3f}"
        f"{row['mean_standard_error']:>8.3f}{row['mean_width']:>8.3f}{row['coverage']:>8.1%}  {interval:<14}"
        f"{row['effective_sample_size']:>7.0f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/coverage.json"))
    parser.add_argument("--logs", type=int, default=200)
    parser.add_argument("--row", choices=ROWS, nargs="+", default=list(ROWS))
    options = parser.parse_args()
    results = []
    for name in options.row:
        start = time.perf_counter()
        rows = measured(name, options.logs)
        took_s = time.perf_counter() - start
        print(f"\n{name}: {rows[0]['share_cut']:.1%} cut, truth {rows[0]['truth']:.3f} ({took_s:.0f} s)")
        print(f"{'':<20}{'bias':>17}{'sd':>8}{'se':>8}{'width':>8}{'covers':>8}  {'95 % interval':<14}{'ESS':>7}")
        print("\n".join(line(row) for row in rows), flush=True)
        results += rows
    report = {"num_patients": NUM_PATIENTS, "num_logs": options.logs, "results": results}
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
