"""Weights of a million trajectories with ties, ours and scikit-survival's in turn; medians, their ratio, and JSON.

python benchmarks/censoring_weights.py [--out runs/benchmarks/censoring_weights.json]

The two differ where ends tie: ours takes the left limit, with completions before cuts. Only speed is compared here.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from sksurv.nonparametric import ipc_weights
from timings import Row, write

from halfseen.censoring import censoring_weights

NUM_TRAJECTORIES = 1_000_000
NUM_RUNS = 5


def seconds(call: Callable[[], object]) -> float:
    begin = time.perf_counter()
    call()
    return time.perf_counter() - begin


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/censoring_weights.json"))
    out = parser.parse_args().out
    rng = np.random.default_rng(0)
    finish, cut = rng.integers(1, 1000, size=(2, NUM_TRAJECTORIES)).astype(float)
    end, is_finished = np.minimum(finish, cut), finish <= cut
    runs = [
        (seconds(lambda: censoring_weights(end, is_finished)), seconds(lambda: ipc_weights(is_finished, end)))
        for _ in range(NUM_RUNS)
    ]
    ours, peer = np.median(runs, axis=0)
    result = {
        "num_trajectories": NUM_TRAJECTORIES,
        "runs": NUM_RUNS,
        "ours_s": ours,
        "scikit_survival_s": peer,
        "ratio": peer / ours,
    }
    write(
        out,
        result,
        [Row(f"weights of {NUM_TRAJECTORIES:,} trajectories, Kaplan–Meier", ours, "s", "scikit-survival", peer)],
    )
    print(f"ours {1e3 * ours:.0f} ms, scikit-survival {1e3 * peer:.0f} ms: {peer / ours:.1f} times as fast")


if __name__ == "__main__":
    main()
