"""One repetition: models learn from the attempts at some tables, and are scored on other tables.

Decided attempts have weight 1/Ĝ, held out or not; Ĝ is fitted to each of the two sets separately.

*The SVM on sets of attempts.* An attempt is a set of elements: itself, and earlier attempts at the same object, each
with the occlusion and the facts seen then. Between elements k₀(a, b) = 1{same kind} (1 + a·b + exp(−‖a − b‖² / d)),
where the kinds are: now, held in the past, missed in the past. The kernel of two sets is the sum over all pairs of
their elements, so that

    f = b + f_now(x) + Σ_{j held} f_held(x_j) + Σ_{j missed} f_missed(x_j):

each past attempt changes the log-odds by what was seen when it was made, as in Bayes' rule.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from halfseen.arrays import RowMask, Rows
from halfseen.cell.calibration import law
from halfseen.cell.calibration.attempts import FACTS, HORIZON, trials
from halfseen.cell.calibration.fits import GraspFit, fit_grasping, held_given_past
from halfseen.learning.svm.estimators import CensoredSVC
from halfseen.learning.svm.kernels import SetKernel
from halfseen.logs import read_logs
from halfseen.shapes import Float, Int
from halfseen.study.experiment import PieceOf, Row
from halfseen.study.setting import Setting
from halfseen.tables.grasp_attempts import can_hold_out, checked_attempts, splits_of
from halfseen.tables.grasp_models import BetaGrasp, SVMGrasp, linear_and_gaussian, smoothest
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
"""Model of the probability that an attempt holds → its name in text."""
SVMS = (SVM, SVM_FACTS, SVM_SET)
MEASURES = {"log_loss": "log-loss", "brier": "Brier score"}
"""Scores of the models on unseen tables; smaller is better."""
SCORE = "log_loss"  # the measure that decides the answer
PAIRS = ((SVM, BETA), (SVM_FACTS, BETA), (SVM_SET, BETA), (LAW, BETA), (SVM_SET, LAW))
"""Pairs of models that are tested; the first is the paper's claim."""
SUREST = 1e-9  # log-loss clips predictions at this distance from 0 and 1: else a miss could cost infinitely much
COMPLETED, VISIBLE_ONLY = "completed", "visible-only"
PLANNERS = {COMPLETED: law.ATTEMPTS, VISIBLE_ONLY: law.VISIBLE_ONLY}
"""Way to plan grasps, with completed shape or by the visible part only → folder of its attempts within a law's."""
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
SEEN = ("occlusion", *FACTS)
KINDS = NOW, HELD, MISSED = range(3)
NUM_LANDMARKS, NUM_SVM_FOLDS = 50, 5  # as in `SVMGrasp`
Source = Mapping[str, Any]  # attempts of one planner of grasps, and the regression


class Split(NamedTuple):
    """Numbers of tables; no table is both learned from and held out.

    The learning tables are in the order in which they join the log: smaller logs are prefixes. The held-out tables are
    sorted.
    """

    learned: Int[np.ndarray, " l"]
    held_out: Int[np.ndarray, " h"]


@dataclass(frozen=True)
class AttemptsRepetition:
    """Models that are learned from the attempts at `num_tables` tables, and scored on other tables.

    All tables are dealt into `num_folds` folds, and each fold is held out in turn; after that all are dealt again. A
    repetition is one fold.
    """

    num_tables: tuple[int, ...] = (25, 50, 100, 200, 400, 600)
    num_folds: int = 4
    most_repetitions: int | None = 20

    def prepare(self, setting: Setting) -> PieceOf:
        """Read the attempts of a law, and fit the regression to all of them; empty without attempts."""
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
        """Deal tables, by their numbers; `num_folds` consecutive repetitions hold out each of them once."""
        deal, fold = divmod(index, self.num_folds)
        order = np.random.default_rng([seed, deal]).permutation(np.sort(tables))
        is_held_out = np.arange(len(order)) % self.num_folds == fold
        learned = np.random.default_rng([seed, deal, fold + 1]).permutation(order[~is_held_out])
        return Split(learned, np.sort(order[is_held_out]))

    def sizes(self, num_tables: int) -> tuple[int, ...]:
        """Log sizes available in every repetition; the largest possible size if none of the design's is."""
        most = num_tables - -(-num_tables // self.num_folds)
        return tuple(size for size in self.num_tables if size <= most) or (most,)


def _at(tried: pd.DataFrame, tables: Int[np.ndarray, " t"]) -> pd.DataFrame:
    """Attempts at these tables."""
    return pd.DataFrame(tried[np.isin(tried["trajectory"].to_numpy(), tables)])


def losses_of(probability: Rows, succeeded: RowMask) -> dict[str, Rows]:
    """Log-loss and Brier score of each attempt."""
    sure = np.clip(probability, SUREST, 1.0 - SUREST)
    return {"log_loss": -np.log(np.where(succeeded, sure, 1.0 - sure)), "brier": np.square(probability - succeeded)}


def predicted(model: str, learned: pd.DataFrame, held_out: pd.DataFrame) -> Rows:
    """Fit a model to attempts, and return the probability of each held-out attempt.

    If fewer than two objects were ever missed, an SVM cannot be fitted, and one rate for all replaces it.

    Parameters
    ----------
    model
        One of `MODEL_NAMES`.
    learned
        Attempts, as returned by `halfseen.cell.calibration.attempts.trials`; decided ones have weight 1/Ĝ.
    held_out
        Attempts at other tables, including the earlier ones at the same object.
    """
    if model == RATE or (model in SVMS and not can_hold_out(learned)):
        decided = checked_attempts(learned)
        # The rule of succession over all attempts, weighted.
        share = (1.0 + decided.weight @ decided.succeeded) / (2.0 + decided.weight.sum())
        return np.full(len(held_out), share)
    if model == SVM_SET:
        return said_by_set_svm(learned, held_out)
    if model == LAW:
        return held_given_past(fit_grasping(learned).estimate, held_out)
    estimator = {BETA: BetaGrasp(), SVM: SVMGrasp(), SVM_FACTS: SVMGrasp(covariates=FACTS)}[model]
    return estimator.fit(learned).predict_proba(held_out)[:, 1]


def said_by_set_svm(learned: pd.DataFrame, held_out: pd.DataFrame) -> Rows:
    """Fit to attempts, and return the probability of others; λ and bounds of probabilities as in `SVMGrasp`.

    Parameters
    ----------
    learned, held_out
        As returned by `halfseen.cell.calibration.attempts.trials`, with all past attempts at each object.
    """
    decided = checked_attempts(learned)
    values = learned.iloc[decided.row][list(SEEN)].to_numpy(dtype=np.float64)
    share = decided.weight / decided.weight.sum()
    centre = share @ values
    spread = np.sqrt(share @ np.square(values - centre))
    scale = np.where(spread > 0.0, spread, 1.0)
    sets, asked = (sets_of(each, centre, scale) for each in (learned, held_out))
    svc = CensoredSVC(
        "logistic",
        kernel=SetKernel(base=of_one_kind, pooling="sum"),
        num_landmarks=min(NUM_LANDMARKS, len(values)),
        cv=splits_of(decided, NUM_SVM_FOLDS, 0),
    )
    rows = [sets[row] for row in decided.row]
    svc.fit(rows, decided.succeeded, sample_weight=decided.weight)
    if smoothest(svc) > svc.reg_:
        svc.set_params(gamma=svc.gamma_, reg=smoothest(svc))
        svc.fit(rows, decided.succeeded, sample_weight=decided.weight)
    surest = 1.0 / (2.0 + decided.diagnostics.effective_sample_size)
    return np.clip(svc.predict_proba(asked)[:, 1], surest, 1.0 - surest)


def sets_of(trials: pd.DataFrame, centre: Float[np.ndarray, " d"], scale: Float[np.ndarray, " d"]) -> list[np.ndarray]:
    """Return the set of each attempt: rows of an indicator of the kind, and the scaled covariates."""
    seen = (trials[list(SEEN)].to_numpy(dtype=np.float64) - centre) / scale
    kind = np.where(trials["succeeded"].isin([True]).to_numpy(), HELD, MISSED)
    objects, stages = trials["object"].to_numpy(), trials["stage"].to_numpy()
    sets: list[np.ndarray] = [np.empty(0)] * len(trials)
    past: dict[int, list[int]] = {}
    for row in np.argsort(stages, kind="stable").tolist():
        before = past.setdefault(int(objects[row]), [])
        kinds = np.eye(len(KINDS))[[NOW, *kind[before]]]
        sets[row] = np.column_stack([kinds, seen[[row, *before]]])
        before.append(row)
    return sets


def of_one_kind(X: Float[np.ndarray, "n e"], Z: Float[np.ndarray, "m e"]) -> Float[np.ndarray, "n m"]:
    """k₀ of elements of one kind."""
    num = len(KINDS)
    return (X[:, :num] @ Z[:, :num].T) * (1.0 + linear_and_gaussian(X[:, num:], Z[:, num:]))


def source_of(tried: pd.DataFrame) -> Source:
    """Bundle attempts with the regression fitted to them."""
    fit = fit_grasping(tried)
    return {
        "tried": {name: [None if pd.isna(value) else value for value in tried[name].tolist()] for name in COLUMNS},
        "estimate": fit.estimate.tolist(),
        "covariance": fit.covariance.tolist(),
        "effective_sample_size": fit.effective_sample_size,
    }


def frame_of(source: Source) -> pd.DataFrame:
    """Return the attempts, one row each."""
    tried = pd.DataFrame(source["tried"])
    return tried.assign(succeeded=tried["succeeded"].astype("boolean"))


def fit_of(source: Source) -> GraspFit:
    """Return the regression."""
    num_decided = int(np.sum(source["tried"]["is_finished"]))
    num_cut = len(source["tried"]["is_finished"]) - num_decided
    estimate, covariance = (np.array(source[name], dtype=np.float64) for name in ("estimate", "covariance"))
    return GraspFit(estimate, covariance, num_decided, num_cut, source["effective_sample_size"])
