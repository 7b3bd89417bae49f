"""One repetition: models learn from the attempts at some tables, and are scored on those at tables apart.

Decided attempts that were held out count 1/Ĝ, as those that are learned from do; Ĝ is fitted to either apart.
"""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from halfseen.arrays import RowMask, Rows
from halfseen.shapes import Int
from halfseen.study.experiment import PieceOf, Setting
from halfseen.study.experiments.attempts.design import COMPLETED, MODEL_NAMES, PLANNERS, SVMS, AttemptsDesign
from halfseen.study.experiments.attempts.models import predicted
from halfseen.study.experiments.attempts.section import section_of
from halfseen.study.experiments.attempts.sources import frame_of, read_attempts, source_of
from halfseen.study.experiments.attempts.splits import sizes_of, split_of
from halfseen.study.experiments.attempts.tables import tables_of
from halfseen.tables.grasp_attempts import can_hold_out, checked_attempts
from halfseen.workers.threads import one_thread

SUREST = 1e-9
"""No prediction counts as surer than this in the log-loss: one miss would cost endlessly much."""


@dataclass(frozen=True)
class Attempts(AttemptsDesign):
    """The experiment; its parameters are those of `AttemptsDesign`."""

    name: ClassVar[str] = "attempts"
    tabulate = tables_of
    section = section_of

    def prepare(self, setting: Setting) -> PieceOf:
        """Read the attempts of a law, and fit the regression to all of them; nothing where there are none."""
        if setting.law is None:
            return {}
        folders = {name: setting.law / planner.folder for name, planner in PLANNERS.items()}
        return {name: source_of(read_attempts(folder)) for name, folder in folders.items() if folder.is_dir()}

    def repeat(self, setting: Setting, prepared: PieceOf, index: int) -> PieceOf:
        """Learn and score: one row for each model and size of log."""
        if COMPLETED not in prepared:
            return {"index": index}
        tried = frame_of(prepared[COMPLETED])
        tables = np.unique(tried["trajectory"].to_numpy())
        split = split_of(self, tables, setting.seed, index)
        held_out = _at(tried, split.held_out)
        decided = checked_attempts(held_out)
        table = np.searchsorted(split.held_out, held_out["trajectory"].to_numpy()[decided.row])
        scores: list[dict[str, Any]] = []
        said: dict[str, list[float]] = {}
        for size in sizes_of(self, len(tables)):
            learned = _at(tried, split.learned[:size])
            for model in MODEL_NAMES:
                # As in the experiment `grasp`: threads would only wait for one another.
                with one_thread():
                    probability = predicted(model, learned, held_out)[decided.row]
                row = {"model": model, "num_tables": size, "stands_in": model in SVMS and not can_hold_out(learned)}
                for measure, loss in losses_of(probability, decided.succeeded).items():
                    row[measure] = np.bincount(table, decided.weight * loss, len(split.held_out)).tolist()
                scores.append(row)
                # The next size replaces them: the largest log stays.
                said[model] = probability.tolist()
        return {
            "index": index,
            "tables": split.held_out.tolist(),
            "weight": np.bincount(table, decided.weight, len(split.held_out)).tolist(),
            "scores": scores,
            "rows": np.asarray(held_out.index)[decided.row].tolist(),
            "row_weight": decided.weight.tolist(),
            "said": said,
        }


def _at(tried: pd.DataFrame, tables: Int[np.ndarray, " t"]) -> pd.DataFrame:
    """Attempts at these tables."""
    return pd.DataFrame(tried[np.isin(tried["trajectory"].to_numpy(), tables)])


def losses_of(probability: Rows, succeeded: RowMask) -> dict[str, Rows]:
    """Log-loss and Brier score of each attempt."""
    sure = np.clip(probability, SUREST, 1.0 - SUREST)
    return {
        "log_loss": -np.log(np.where(succeeded, sure, 1.0 - sure)),
        "brier": np.square(probability - succeeded),
    }
