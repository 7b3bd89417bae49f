"""Made-up pieces of the experiment on physical attempts, for the tests of what is drawn and written."""

from functools import cache

import numpy as np

from attempt_logs import attempt_log
from halfseen.cell.calibration.trials import trials
from halfseen.study.experiment import Pieces
from halfseen.study.experiments.attempts import Attempts
from halfseen.study.experiments.attempts.design import COMPLETED, MODEL_NAMES, VISIBLE_ONLY
from halfseen.study.experiments.attempts.sources import source_of
from halfseen.study.experiments.attempts.splits import split_of

NUM_TABLES = 30
ABOVE = {"rate": 0.02, "beta": 0.0, "svm-facts": -0.01, "svm-set": -0.005, "law": -0.012}


@cache
def source(seed=0):
    """Attempts at some tables, and the regression."""
    return source_of(trials(attempt_log(NUM_TABLES, seed), 12))


def example_pieces(gain=0.0, repetitions=8, has_both=True):
    """Make pieces in which the SVM gains so much over the Beta mean, in each attempt."""
    design, rng = Attempts(), np.random.default_rng(3)
    prepared = {COMPLETED: source(), **({VISIBLE_ONLY: source(1)} if has_both else {})}
    decided = np.flatnonzero(prepared[COMPLETED]["tried"]["is_finished"])
    path = np.array(prepared[COMPLETED]["tried"]["path"])[decided]
    hard = rng.normal(0.15, 0.05, NUM_TABLES)
    pieces = [_piece(design, index, decided, path, hard, gain, rng) for index in range(repetitions)]
    return Pieces(prepared, {}, pieces)


def _piece(design, index, decided, path, hard, gain, rng):
    tables = split_of(design, np.unique(path), 0, index).held_out
    rows = np.isin(path, tables)
    weight = np.array([np.sum(path == table) for table in tables], dtype=float)
    scores = []
    for size in design.num_tables:
        for model in MODEL_NAMES:
            loss = hard[tables] + ABOVE.get(model, -gain) + rng.normal(0.0, 0.002, len(tables))
            row = {"model": model, "num_tables": size, "stands_in": model == "svm" and size == 25 and index == 0}
            scores.append(row | {"log_loss": (weight * loss).tolist(), "brier": (weight * loss / 5).tolist()})
    said = {model: np.full(int(rows.sum()), 0.9).tolist() for model in MODEL_NAMES}
    said["law"] = rng.uniform(0.6, 1.0, int(rows.sum())).tolist()
    kept = {"rows": decided[rows].tolist(), "row_weight": np.ones(int(rows.sum())).tolist(), "said": said}
    return {"index": index, "tables": tables.tolist(), "weight": weight.tolist(), "scores": scores, **kept}
