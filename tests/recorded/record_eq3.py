"""Eq. 3 as it was: fits, bootstrap and off-policy evaluation; ran at commit a5c2804 (JAX, float64).

python tests/recorded/record_eq3.py
"""

import json
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from halfseen.evaluation import evaluate
from halfseen.learning import bootstrap
from halfseen.logs import read_logs
from halfseen.tables import TableTask
from recorded.eq3_cases import CASES, FOLDERS, HERE, fitted, numbers_of, q_of_cell


def encode_given():
    """Write the features of the tables that are given: they are float32, and so are kept exactly."""
    encoded = TableTask(grasp=None).encode(read_logs(FOLDERS["tables"]), 10)
    assert (encoded.features == encoded.features.astype(np.float32)).all()
    kept = {"features": encoded.features.astype(np.float32), "is_possible": encoded.is_possible}
    np.savez_compressed(HERE / "tables_encoded.npz", **kept, action=encoded.action.astype(np.int32))


def main():
    """Fit all, and write eq3.npz and eq3.json."""
    encode_given()
    arrays, words = {}, {}
    for name in CASES:
        began = time.process_time()
        learner = fitted(name)
        found = numbers_of(learner)
        if name.startswith(("cell", "trial")):
            found |= q_of_cell(learner)
        arrays |= {f"{name}/{what}": value for what, value in found.items()}
        words[name] = {
            "chosen": list(learner.chosen_),
            "pessimism": learner.model_.pessimism,
            "largest_weight": learner.diagnostics_.largest_weight,
            "effective_sample_size": learner.diagnostics_.effective_sample_size,
        }
        print(name, {k: v.shape for k, v in found.items()}, round(time.process_time() - began, 1), flush=True)
        if name == "cell/auto":
            again = bootstrap(learner, read_logs(FOLDERS["cell"]), 20)
            arrays["cell/bootstrap/coefficients"] = np.asarray(again.replicates.coefficients)[:3]
            words["cell/evaluation"] = evaluate(learner.policy_, read_logs(FOLDERS["later"])).as_dict()
    np.savez_compressed(HERE / "eq3.npz", **arrays)
    (HERE / "eq3.json").write_text(json.dumps(words, indent=1, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main()
