"""Few trajectories of many actions: what is learned, beside the policy that logged.

python benchmarks/many_actions.py [--sizes 50 128 256] [--logs 5] [--loggers …] [--out …/many_actions.json]

The world is `worlds/clinic.py`: sixteen treatments. It is logged by care that tries any treatment in half of the
visits, or in a fifth, or in four fifths, by chance alone, by one who takes what looks worst in half of them, and by
rough care, which knows little and tries in half. Each has a world of its own. *learned* is the default; *by Q alone* is
its policy without what the log prefers; for *apart* the Q of each treatment is fitted to its own rows, too. Values are
means of 10,000 fresh trajectories. How far means are shrunk was chosen on logs 0 to 2 of the worlds 0, 3 and 4, and how
a nat is weighed on logs of the worlds 20 to 22 with good and rough care; these are others.
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from tqdm import tqdm
from worlds.clinic import HORIZON, NUM_TREATMENTS, SYMPTOMS, TREATMENTS, Clinic

from halfseen.learning import CensoredQLearner, DiscretePolicy, q_learner
from halfseen.logs import Logs
from halfseen.writing import write_file

FIRST_SEED = 10
LOGGERS = {
    "half tried": Clinic(10),
    "a fifth tried": Clinic(11, 0.2),
    "four fifths tried": Clinic(12, 0.8),
    "chance": Clinic(13, 1.0),
    "worst": Clinic(14, is_worst=True),
    "rough care": Clinic(15, error=0.4),
}


def learned(log: Logs, has_many: bool = True) -> DiscretePolicy:
    q_learner.MANY_ACTIONS = 2 if has_many else NUM_TREATMENTS + 1
    return CensoredQLearner(HORIZON, TREATMENTS, SYMPTOMS).fit(log).policy_


def value(clinic: Clinic, policy: DiscretePolicy) -> float:
    stage = iter(range(1, HORIZON + 1))

    def chances(symptoms: np.ndarray, last: np.ndarray) -> np.ndarray:
        return policy.probabilities(pd.DataFrame(symptoms, columns=SYMPTOMS), next(stage))

    return clinic.value(chances)


def values(clinic: Clinic, log: Logs) -> dict[str, float]:
    policy = learned(log)
    policies = {"learned": policy, "by Q alone": replace(policy, behaviour_weight=0.0), "apart": learned(log, False)}
    return {name: value(clinic, each) for name, each in policies.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=[50, 128, 256])
    parser.add_argument("--logs", type=int, default=5)
    parser.add_argument("--loggers", nargs="+", choices=LOGGERS, default=list(LOGGERS))
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/many_actions.json"))
    chosen = parser.parse_args()
    rows = []
    for logger in chosen.loggers:
        clinic = LOGGERS[logger]
        own, care = clinic.value(clinic.logging), clinic.value(clinic.care)
        print(f"{logger}: the log {own:.1f}, care {care:.1f}")
        for size in chosen.sizes:
            mine = []
            for seed in tqdm(range(FIRST_SEED, FIRST_SEED + chosen.logs), desc=f"{size} trajectories", disable=None):
                found = values(clinic, clinic.log(size, seed))
                mine.append({"logger": logger, "trajectories": size, "seed": seed, "log": own, "care": care, **found})
            rows += mine
            frame = pd.DataFrame(mine)
            shown = (f"{name} {frame[name].mean():5.1f}" for name in ("learned", "by Q alone", "apart"))
            above = (frame["learned"] - own).sem()
            print(f"  {size:4} trajectories: {', '.join(shown)} (± {above:.1f}, {len(mine)} logs)", flush=True)
    write_file(chosen.out, json.dumps(rows, indent=2).encode())


if __name__ == "__main__":
    main()
