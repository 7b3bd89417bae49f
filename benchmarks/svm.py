"""Fits of the censored SVM with every loss, scikit-survival's kernel SVM in turn; medians, their ratio, and JSON.

python benchmarks/svm.py [--out runs/benchmarks/svm.json]

Bars: every loss below 0.1 s at n = 500 and below 5 s at n = 5,000 (rbf, F = 10, some 30 % cut). The peer ranks where
ours regresses or classifies, so only speed is compared; it is run at n = 500.
"""

import argparse
import time
import warnings
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from sksurv.svm import FastKernelSurvivalSVM
from timings import Row, write

from halfseen.errors import HalfseenWarning
from halfseen.learning import CensoredSVC, CensoredSVR, survival_array
from halfseen.learning.svm.losses import CLASSIFICATION, REGRESSION

REGS = (1e-2, 1e-4, 1e-6)
NUM_FEATURES = 10
GAMMA = 1.0 / NUM_FEATURES
SIZES = {500: (3, 0.1), 5000: (1, 5.0)}
"""Runs, and the bar [s], of each n."""


def seconds(call: Callable[[], object]) -> float:
    begin = time.perf_counter()
    call()
    return time.perf_counter() - begin


def log(num_rows: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(num_rows, NUM_FEATURES))
    finish = np.exp(0.5 * np.sin(2 * rows[:, 0]) + 0.5 * rows[:, 1] + 0.3 * rng.normal(size=num_rows))
    cut = rng.exponential(3.5, size=num_rows)
    return rows, survival_array(np.minimum(finish, cut), finish <= cut)


def model(loss: str, reg: float) -> CensoredSVR | CensoredSVC:
    if loss in CLASSIFICATION:
        return CensoredSVC(loss, tau=1.0, reg=reg, gamma=GAMMA, calibrate=False)
    return CensoredSVR(loss, reg=reg, gamma=GAMMA)


def measured(loss: str, reg: float, num_rows: int) -> dict[str, object]:
    rows, y = log(num_rows)
    num_runs, bar = SIZES[num_rows]
    ours = model(loss, reg)
    peer = FastKernelSurvivalSVM(rank_ratio=0.0, fit_intercept=True, kernel="rbf", gamma=GAMMA)
    with_peer = num_rows == min(SIZES)
    with warnings.catch_warnings():
        # The gap is printed, and how far the peer got is its own affair.
        warnings.simplefilter("ignore", HalfseenWarning)
        warnings.filterwarnings("ignore", module="sksurv")
        runs = [
            (seconds(lambda: ours.fit(rows, y)), seconds(lambda: peer.fit(rows, y)) if with_peer else np.nan)
            for _ in range(num_runs)
        ]
    ours_s, peer_s = np.median(runs, axis=0)
    result = {"n": num_rows, "loss": loss, "reg": reg, "share_cut": 1.0 - float(y["is_finished"].mean())}
    result |= {"seconds": ours_s, "bar_s": bar, "relative_gap": ours.duality_gap_ / ours.objective_}
    return result | ({"scikit_survival_s": peer_s, "ratio": peer_s / ours_s} if with_peer else {})


def line_of(result: dict) -> str:
    ratio = f", {result['ratio']:.1f} times as fast as scikit-survival" if "ratio" in result else ""
    verdict = "" if result["seconds"] < result["bar_s"] else f" (MISSES {result['bar_s']} s)"
    return (
        f"n={result['n']:5d} {result['loss']:20s} λ={result['reg']:.0e}: {result['seconds']:7.3f} s{verdict}, "
        f"gap {result['relative_gap']:.0e}{ratio}"
    )


def by_size_and_reg(results: list[dict[str, Any]]) -> list[list[dict[str, Any]]]:
    """Bring together what differs by its loss alone."""
    return [[each for each in results if (each["n"], each["reg"]) == place] for place in product(SIZES, REGS)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/svm.json"))
    out = parser.parse_args().out
    model("squared", 1.0).fit(*log(50))
    results = []
    for num_rows in SIZES:
        for loss in (*REGRESSION, *CLASSIFICATION):
            for reg in REGS:
                results.append(measured(loss, reg, num_rows))
                print(line_of(results[-1]), flush=True)
    # Of the table, the loss that takes longest alone.
    slowest = [max(same, key=lambda each: each["seconds"]) for same in by_size_and_reg(results)]
    rows = [
        Row(
            f"censored SVM, {each['n']:,} rows, λ = {each['reg']:.0e}, slowest loss",
            each["seconds"],
            "s",
            "scikit-survival" if "ratio" in each else None,
            each.get("scikit_survival_s"),
            each["bar_s"],
        )
        for each in slowest
    ]
    write(out, results, rows)


if __name__ == "__main__":
    main()
