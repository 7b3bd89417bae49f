"""The censored SVM of 100,000 rows by 500 landmarks, a process a loss; seconds, peak memory, and JSON.

python benchmarks/low_rank_svm.py [--loss absolute] [--out runs/benchmarks/low_rank_svm.json]

Bars: every loss below 60 s and 2 GB (rbf, F = 10, some 30 % cut, λ = 1e-4). The memory is the largest that the process
ever held, Python and its libraries included.
"""

import argparse
import json
import resource
import subprocess
import sys
import time
import warnings
from pathlib import Path

import numpy as np
from timings import Row, write

from halfseen.errors import HalfseenWarning
from halfseen.learning import CensoredSVC, CensoredSVR, survival_array
from halfseen.learning.svm.losses import CLASSIFICATION, REGRESSION

NUM_ROWS, NUM_FEATURES, NUM_LANDMARKS = 100_000, 10, 500
REG = 1e-4
BAR_S, BAR_BYTES = 60.0, 2e9


def log() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(NUM_ROWS, NUM_FEATURES))
    finish = np.exp(0.5 * np.sin(2 * rows[:, 0]) + 0.5 * rows[:, 1] + 0.3 * rng.normal(size=NUM_ROWS))
    cut = rng.exponential(3.5, size=NUM_ROWS)
    return rows, survival_array(np.minimum(finish, cut), finish <= cut)


def measured(loss: str) -> dict[str, object]:
    shared = {"reg": REG, "gamma": 1.0 / NUM_FEATURES, "num_landmarks": NUM_LANDMARKS}
    is_label = loss in CLASSIFICATION
    model = CensoredSVC(loss, tau=1.0, calibrate=False, **shared) if is_label else CensoredSVR(loss, **shared)
    rows, y = log()
    with warnings.catch_warnings():
        # The gap is printed.
        warnings.simplefilter("ignore", HalfseenWarning)
        begin = time.perf_counter()
        model.fit(rows, y)
        passed = time.perf_counter() - begin
    # Linux counts in KiB.
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    gap = model.duality_gap_ / model.objective_
    return {"loss": loss, "seconds": passed, "peak_bytes": peak, "relative_gap": gap}


def line_of(result: dict) -> str:
    is_met = result["seconds"] < BAR_S and result["peak_bytes"] < BAR_BYTES
    return (
        f"{result['loss']:20s} {result['seconds']:6.1f} s, peak {result['peak_bytes'] / 1e9:.2f} GB, "
        f"gap {result['relative_gap']:.0e}{'' if is_met else ' (MISSES 60 s and 2 GB)'}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--loss", choices=(*REGRESSION, *CLASSIFICATION), help="this loss only, in this process")
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/low_rank_svm.json"))
    arguments = parser.parse_args()
    if arguments.loss:
        print(json.dumps(measured(arguments.loss)))
        return
    results = []
    for loss in (*REGRESSION, *CLASSIFICATION):
        command = [sys.executable, __file__, "--loss", loss]
        results.append(json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout))
        print(line_of(results[-1]), flush=True)
    rows = [
        Row(f"censored SVM, 100,000 rows, 500 landmarks, {each['loss']}", each["seconds"], "s", bar=BAR_S)
        for each in results
    ]
    write(arguments.out, results, rows)


if __name__ == "__main__":
    main()
