"""The logs that eq. 3 is recorded on, beside those of the examples; ran at commit a5c2804.

python tests/recorded/record_logs.py
"""

import sys
from pathlib import Path

import numpy as np

from halfseen.planners import GreedyPolicy
from halfseen.world import ExploringPolicy, Scene, TableWorld, WorldConfig

HERE = Path(__file__).parent
TRIAL = HERE.parents[1] / "examples" / "clinical_trial"


def scene(num_objects, seed):
    """A table on which some objects hide others."""
    rng = np.random.default_rng(seed)
    hides = rng.uniform(0.0, 0.6, (num_objects, num_objects)) * (rng.random((num_objects, num_objects)) < 0.4)
    return Scene(hides * ~np.eye(num_objects, dtype=bool), f"table-{seed}")


def main():
    """Write both logs."""
    logger = ExploringPolicy(GreedyPolicy(WorldConfig(), uses_history=True, counts_penalty=True), 0.5)
    tables = TableWorld().simulate([scene(4, 1), scene(5, 2)], logger, episodes=100, seed=5, cut_share=0.33)
    tables.write(HERE / "tables_100", overwrite=True)
    sys.path.insert(0, str(TRIAL))
    from trial_patients import trial

    trial(300, 0.3, seed=0).write(HERE / "trial_300", overwrite=True)


if __name__ == "__main__":
    main()
