"""What the control variate is worth: variance of a difference between two policies, with it and without.

python benchmarks/control_variate.py [--blocks 20] [--seed 77] [--out FILE]

The look one step ahead and the best rule of thumb, which both know the true laws, play the same hundred episodes of the
study in each block. So many times as many episodes would be needed without it for intervals as narrow.
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from halfseen.cell.calibration.law import shipped_law
from halfseen.scene.shipped import table_paths
from halfseen.study.pipeline import Source
from halfseen.study.policies import ONE_STEP, STRONGEST_RULE
from halfseen.study.setting import Setting, look_at, under
from halfseen.writing import write_file

NUM_EPISODES = 100


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--blocks", type=int, default=20)
    parser.add_argument("--seed", type=int, default=77)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/control_variate.json"))
    given = parser.parse_args()
    setting, law = under(Setting(()), shipped_law())
    setting = replace(setting, scenes=look_at(table_paths(), law)[0], seed=given.seed)
    policies = [each.policy(setting.world) for each in (ONE_STEP, STRONGEST_RULE)]
    gains: dict[str, list[np.ndarray]] = {"as they fall": [], "by the control variate": []}
    for block in range(given.blocks):
        source = Source.of(setting, block)
        ways = source.evaluate_each(policies, NUM_EPISODES), source.control_each(policies, range(NUM_EPISODES), 0.0)
        for each, (one, other) in zip(gains.values(), ways, strict=True):
            each.append(one.reward - other.reward)
    found = {
        name: {"mean": float(np.mean(each)), "deviation": float(np.std(each, ddof=1))} for name, each in gains.items()
    }
    raw, controlled = (one["deviation"] for one in found.values())
    write_file(given.out, json.dumps({**found, "ratio": (raw / controlled) ** 2}, indent=2).encode())
    for name, one in found.items():
        print(f"{name:22} {one['mean']:+.2f} an episode, standard deviation {one['deviation']:.2f}")
    print(f"variance without, of that with it: {(raw / controlled) ** 2:.0f}")


if __name__ == "__main__":
    main()
