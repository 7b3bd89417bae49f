"""One repetition: models learn from the attempts at some tables, and are scored on those at tables apart.

Decided attempts that were held out count 1/Ĝ, as those that are learned from do; Ĝ is fitted to either apart.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from halfseen.arrays import RowMask, Rows
from halfseen.cell.calibration import law_folder
from halfseen.cell.calibration.attempts import FACTS, trials
from halfseen.cell.calibration.calibrate import HORIZON
from halfseen.cell.calibration.grasping import GraspFit, fit_grasping, held_given_past
from halfseen.logs import read_logs
from halfseen.shapes import Int
from halfseen.study.experiment import PieceOf, Row
from halfseen.study.experiments.attempts_set_svm import said_by_set_svm
from halfseen.study.setting import Setting
from halfseen.tables.grasp_attempts import can_hold_out, checked_attempts
from halfseen.tables.grasp_models import BetaGrasp, SVMGrasp
from halfseen.workers.threads import one_thread

RATE, BETA, SVM, SVM_FACTS, SVM_SET, LAW = "rate", "beta", "svm", "svm-facts", "svm-set", "law"
MODEL_NAMES = {
    RATE: "one rate for all",
    BETA: "Beta mean",
    SVM: "SVM",
    SVM_FACTS: "SVM with pose, width, room",
    SVM_SET: "SVM, set kernel",
    LAW: "logistic law",
}
"""Model of the probability that an attempt holds → name for people."""
SVMS = (SVM, SVM_FACTS, SVM_SET)
MEASURES = {"log_loss": "log-loss", "brier": "Brier score"}
"""What models are judged by, on tables that they have not seen; smaller is better."""
SCORE = "log_loss"
"""The measure that the answer is told by."""
PAIRS = ((SVM, BETA), (SVM_FACTS, BETA), (SVM_SET, BETA), (LAW, BETA), (SVM_SET, LAW))
"""Who is tested against whom; the first is the paper's claim."""
SUREST = 1e-9
"""No prediction counts as surer than this in the log-loss: one miss would cost endlessly much."""
COMPLETED, VISIBLE_ONLY = "completed", "visible-only"
PLANNERS = {COMPLETED: law_folder.ATTEMPTS, VISIBLE_ONLY: law_folder.VISIBLE_ONLY}
"""Way to plan grasps, with hidden shape completed or by what is visible → folder of its attempts within a law's."""
COLUMNS = (
    "trajectory",
    "stage",
    "object",
    "occlusion",
    "successes",
    "failures",
    "succeeded",
    "time_s",
    "is_finished",
    *FACTS,
)
Source = Mapping[str, Any]
"""Attempts of one planner of grasps, and the regression."""


class Split(NamedTuple):
    """Numbers of tables; none is ever both learned from and held out."""

    learned: Int[np.ndarray, " l"]
    """In the order in which they join the log that is learned from: smaller logs are their beginnings."""
    held_out: Int[np.ndarray, " h"]
    """Sorted."""


@dataclass(frozen=True)
class AttemptsRepetition:
    """Models that are learned from the attempts at `num_tables` tables, and scored on tables apart.

    All tables are dealt into `num_folds`; each fold is held out in turn, and after that all are dealt anew. A
    repetition is one fold.
    """

    num_tables: tuple[int, ...] = (25, 50, 100, 200, 400, 600)
    num_folds: int = 4
    most_repetitions: int | None = 20

    def prepare(self, setting: Setting) -> PieceOf:
        """Read the attempts of a law, and fit the regression to all of them; nothing where there are none."""
        if setting.law is None:
            return {}
        folders = {name: setting.law / folder for name, folder in PLANNERS.items()}
        found = {name: folder for name, folder in folders.items() if folder.is_dir()}
        return {name: source_of(trials(read_logs(folder), HORIZON)) for name, folder in found.items()}

    def repeat(self, setting: Setting, prepared: PieceOf, index: int) -> PieceOf:
        """Learn and score: one row for each model and size of log."""
        if COMPLETED not in prepared:
            return {"index": index}
        tried = frame_of(prepared[COMPLETED])
        tables = np.unique(tried["trajectory"].to_numpy())
        split = self.split(tables, setting.seed, index)
        held_out = _at(tried, split.held_out)
        decided = checked_attempts(held_out)
        table = np.searchsorted(split.held_out, held_out["trajectory"].to_numpy()[decided.row])
        scores: list[Row] = []
        said: dict[str, list[float]] = {}
        for size in self.sizes(len(tables)):
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

    def split(self, tables: Int[np.ndarray, " t"], seed: int, index: int) -> Split:
        """Deal tables, by their numbers; `num_folds` repetitions in a row hold out each of them once."""
        deal, fold = divmod(index, self.num_folds)
        order = np.random.default_rng([seed, deal]).permutation(np.sort(tables))
        is_held_out = np.arange(len(order)) % self.num_folds == fold
        learned = np.random.default_rng([seed, deal, fold + 1]).permutation(order[~is_held_out])
        return Split(learned, np.sort(order[is_held_out]))

    def sizes(self, num_tables: int) -> tuple[int, ...]:
        """Sizes of logs that can be learned from in every repetition; all there is if none of the design's can."""
        most = num_tables - -(-num_tables // self.num_folds)
        return tuple(size for size in self.num_tables if size <= most) or (most,)


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


def predicted(model: str, learned: pd.DataFrame, held_out: pd.DataFrame) -> Rows:
    """Fit a model to attempts, and give the probability of each attempt that was held out.

    Where misses were seen of fewer than two objects, an SVM cannot be fitted; one rate for all stands in for it.

    Parameters
    ----------
    model
        One of `MODEL_NAMES`.
    learned
        Attempts, as `halfseen.cell.calibration.trials.trials` gives them; decided ones weigh 1/Ĝ.
    held_out
        Attempts at other tables, those before each at the same object among them.
    """
    is_rate = model in SVMS and not can_hold_out(learned)
    return _PREDICTED[RATE if is_rate else model](learned, held_out)


def _rate(learned: pd.DataFrame, held_out: pd.DataFrame) -> Rows:
    """The rule of succession over all attempts, each weighted."""
    decided = checked_attempts(learned)
    share = (1.0 + decided.weight @ decided.succeeded) / (2.0 + decided.weight.sum())
    return np.full(len(held_out), share)


def _estimator(make: Callable[[], BetaGrasp | SVMGrasp], learned: pd.DataFrame, held_out: pd.DataFrame) -> Rows:
    return make().fit(learned).predict_proba(held_out)[:, 1]


_PREDICTED: dict[str, Callable[[pd.DataFrame, pd.DataFrame], Rows]] = {
    RATE: _rate,
    BETA: partial(_estimator, BetaGrasp),
    SVM: partial(_estimator, SVMGrasp),
    SVM_FACTS: partial(_estimator, partial(SVMGrasp, covariates=FACTS)),
    SVM_SET: said_by_set_svm,
    LAW: lambda learned, held_out: held_given_past(fit_grasping(learned).estimate, held_out),
}


def source_of(tried: pd.DataFrame) -> Source:
    """Keep attempts, and the regression that is fitted to them."""
    fit = fit_grasping(tried)
    return {
        "tried": {name: [None if pd.isna(value) else value for value in tried[name].tolist()] for name in COLUMNS},
        "estimate": fit.estimate.tolist(),
        "covariance": fit.covariance.tolist(),
        "effective_sample_size": fit.effective_sample_size,
    }


def frame_of(source: Source) -> pd.DataFrame:
    """Give the attempts, one row each."""
    tried = pd.DataFrame(source["tried"])
    return tried.assign(succeeded=tried["succeeded"].astype("boolean"))


def fit_of(source: Source) -> GraspFit:
    """Give the regression."""
    num_decided = int(np.sum(source["tried"]["is_finished"]))
    num_cut = len(source["tried"]["is_finished"]) - num_decided
    estimate, covariance = (np.array(source[name], dtype=np.float64) for name in ("estimate", "covariance"))
    return GraspFit(estimate, covariance, num_decided, num_cut, source["effective_sample_size"])
