"""What each model of the cuts makes of a mean, when cuts depend on nothing, on what was recorded, or on what was not.

python benchmarks/dependent_cuts.py [--out runs/benchmarks/dependent_cuts.json] [--logs 200] [--situation NAME ...]

A log is 600 attempts. An attempt has a difficulty g(z), for a clutter z in [0, 1], and takes exp(1 + g(z) + 0.4 ε) s,
at most 8 s: then it is over, and counts as finished. It is cut at the rate κ exp(1.5 g(z)); κ is such that a third, or
half, of the attempts are cut. What is wanted is the mean time of an attempt, had nothing been cut. Situations:

independent   g(z) = z, and the rate of cuts is κ for all
linear        g(z) = z
curved        g(z) = (2z − 1)²: both ends of z are difficult
unrecorded    g(z) = z, but what was recorded instead of z has nothing to do with it

The estimate is Σ w y / Σ w, its interval ± 1.96 √(Σ w² (y − estimate)²) / Σ w, as if the weights were known. ``drop``
is the mean of the attempts that were not cut; ``cox, z and z²`` is Cox with the square as a second covariate;
``kernel`` chooses its bandwidth by cross-validation, ``kernel, 0.2`` has one of 0.2 standard deviations.
"""

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import brentq

from halfseen.censoring import KernelKaplanMeier, censoring_weights

NUM_ATTEMPTS = 600
HORIZON_S = 8.0
STEEPNESS = 1.5
CUT_SHARES = {"1/3": 1 / 3, "1/2": 1 / 2}
MODELS = ("drop", "kaplan-meier", "cox", "cox, z and z²", "kernel", "kernel, 0.2")
SITUATIONS = ("independent", "linear", "curved", "unrecorded")
NUM_FOR_TRUTH = 1_000_000


def difficulty(situation: str, clutter: np.ndarray) -> np.ndarray:
    return (2.0 * clutter - 1.0) ** 2 if situation == "curved" else clutter


def attempt_s(hard: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return np.minimum(np.exp(1.0 + hard + 0.4 * rng.normal(size=len(hard))), HORIZON_S)


def cut_rate(situation: str, hard: np.ndarray) -> np.ndarray:
    return np.ones(len(hard)) if situation == "independent" else np.exp(STEEPNESS * hard)


def calibrated(situation: str) -> tuple[float, dict[str, float]]:
    """The true mean [s], and κ [1/s] for each share of cuts."""
    rng = np.random.default_rng(0)
    hard = difficulty(situation, rng.uniform(size=NUM_FOR_TRUTH))
    time_s = attempt_s(hard, rng)
    exposure = cut_rate(situation, hard) * time_s

    def excess(kappa: float, share: float) -> float:
        return float(1.0 - np.exp(-kappa * exposure).mean()) - share

    kappas = {name: float(np.asarray(brentq(excess, 1e-6, 10.0, args=(share,)))) for name, share in CUT_SHARES.items()}
    return float(time_s.mean()), kappas


def drawn(situation: str, kappa: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """One log: observed ends [s], which of them are finishes, and what was recorded, shape (n, 1)."""
    clutter = rng.uniform(size=NUM_ATTEMPTS)
    hard = difficulty(situation, clutter)
    time_s = attempt_s(hard, rng)
    cut_s = rng.exponential(1.0 / (kappa * cut_rate(situation, hard)))
    recorded = rng.uniform(size=NUM_ATTEMPTS) if situation == "unrecorded" else clutter
    return np.minimum(time_s, cut_s), time_s <= cut_s, recorded[:, None]


def weights_by(model: str, end_s: np.ndarray, is_finished: np.ndarray, recorded: np.ndarray) -> np.ndarray:
    if model == "drop":
        return is_finished.astype(float)
    if model == "cox, z and z²":
        return censoring_weights(end_s, is_finished, "cox", covariates=np.hstack([recorded, recorded**2]))
    if model == "kernel, 0.2":
        return censoring_weights(end_s, is_finished, KernelKaplanMeier(bandwidth=0.2), covariates=recorded)
    return censoring_weights(end_s, is_finished, model, covariates=None if model == "kaplan-meier" else recorded)


def estimate(model: str, end_s: np.ndarray, is_finished: np.ndarray, recorded: np.ndarray) -> tuple[float, float]:
    """Mean time of an attempt and its standard error [s]."""
    weights = weights_by(model, end_s, is_finished, recorded)
    mean = float(weights @ end_s / weights.sum())
    return mean, float(np.sqrt(np.sum((weights * (end_s - mean)) ** 2)) / weights.sum())


def measured(situation: str, num_logs: int, models: tuple[str, ...] = MODELS) -> list[dict[str, Any]]:
    """One row for each share of cuts and each model."""
    truth, kappas = calibrated(situation)
    rows = []
    for share, kappa in kappas.items():
        logs = [drawn(situation, kappa, np.random.default_rng([seed, len(share)])) for seed in range(num_logs)]
        cut = 1.0 - float(np.mean([is_finished.mean() for _, is_finished, _ in logs]))
        for model in models:
            means, errors = np.array([estimate(model, *log) for log in logs]).T
            rows.append(
                {
                    "situation": situation,
                    "share": share,
                    "share_cut": cut,
                    "model": model,
                    "truth_s": truth,
                    "mean_s": float(means.mean()),
                    "bias_s": float(means.mean() - truth),
                    "bias_error_s": float(means.std(ddof=1) / np.sqrt(num_logs)),
                    "coverage": float((np.abs(means - truth) <= 1.96 * errors).mean()),
                }
            )
    return rows


def table(rows: list[dict[str, Any]]) -> str:
    """The rows of one situation, as Markdown."""
    columns: dict[str, Callable[[dict[str, Any]], str]] = {
        "cut": lambda row: row["share"],
        "weights": lambda row: row["model"],
        "mean estimate [s]": lambda row: f"{row['mean_s']:.3f}",
        "bias [s]": lambda row: f"{row['bias_s']:+.3f} ± {row['bias_error_s']:.3f}".replace("-", "−"),
        "95 % interval covers": lambda row: f"{row['coverage']:.1%}".replace("%", " %"),
    }
    lines = ["| " + " | ".join(columns) + " |", "|" + "|".join([":--", ":--", "--:", "--:", "--:"]) + "|"]
    lines += ["| " + " | ".join(cell(row) for cell in columns.values()) + " |" for row in rows]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/dependent_cuts.json"))
    parser.add_argument("--logs", type=int, default=200)
    parser.add_argument("--situation", choices=SITUATIONS, nargs="+", default=SITUATIONS)
    options = parser.parse_args()
    results = []
    for situation in options.situation:
        rows = measured(situation, options.logs)
        print(f"\n{situation}: the true mean is {rows[0]['truth_s']:.3f} s\n\n{table(rows)}", flush=True)
        results += rows
    report = {"num_attempts": NUM_ATTEMPTS, "num_logs": options.logs, "results": results}
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
