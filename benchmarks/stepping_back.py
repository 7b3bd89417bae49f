"""How often does a policy step back in a cell that is as it was? By ranges alone, and with their margins.

python benchmarks/stepping_back.py [--logs 40] [--states 4000] [--out FILE]

Covariates are independent; a log has so many trajectories of one stage. It prints the share of fresh states that lie
outside in any covariate, and by how much of a range the margin widens it at each end.
"""

import argparse
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from halfseen.policies.ranges import margin

Draw = Callable[[np.random.Generator, tuple[int, int]], np.ndarray]
SIZES = ((2, 100), (8, 100), (20, 100), (20, 1000))
"""Covariates and trajectories."""
LAWS: dict[str, Draw] = {
    "uniform": lambda rng, shape: rng.random(shape),
    "normal": lambda rng, shape: rng.normal(size=shape),
    "exponential": lambda rng, shape: rng.exponential(size=shape),
    "lognormal": lambda rng, shape: np.exp(0.5 * rng.normal(size=shape)),
    "Student's t, 3": lambda rng, shape: rng.standard_t(3, size=shape),
}


def outside(log: np.ndarray, fresh: np.ndarray) -> tuple[float, float, float]:
    """Share outside of ranges, the same with margins, and the mean margin in ranges."""
    low, high = log.min(axis=0), log.max(axis=0)
    below, above = (np.array([margin(sign * column, log.shape[1]) for column in log.T]) for sign in (-1.0, 1.0))
    is_out = ((fresh < low) | (fresh > high)).any(axis=1).mean()
    is_far = ((fresh < low - below) | (fresh > high + above)).any(axis=1).mean()
    return float(is_out), float(is_far), float(((below + above) / (high - low)).mean() / 2.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--logs", type=int, default=40)
    parser.add_argument("--states", type=int, default=4000)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/stepping_back.json"))
    options = parser.parse_args()
    found = []
    for law, draw in LAWS.items():
        for d, n in SIZES:
            rng = np.random.default_rng([d, n])
            each = [outside(draw(rng, (n, d)), draw(rng, (options.states, d))) for _ in range(options.logs)]
            alone, with_margin, wider = np.mean(each, axis=0).tolist()
            found.append({"law": law, "d": d, "n": n, "ranges": alone, "margins": with_margin, "wider": wider})
            print(f"{law:<16}{d:>3}{n:>6}  ranges {alone:6.1%}  margins {with_margin:6.1%}  wider by {wider:4.0%}")
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
