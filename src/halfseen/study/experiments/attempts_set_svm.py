"""The censored SVM on sets of attempts: what is tried now, and what came of each past attempt at the same object.

An attempt is a set of elements: itself, and those before it, each with the occlusion and the facts that were seen then.
Between elements k₀(a, b) = 1{same kind} (1 + a·b + exp(−‖a − b‖² / d)), where kinds are: now, held in the past, missed
in the past. The kernel of two sets is the sum over all pairs of their elements, so that

    f = b + f_now(x) + Σ_{j held} f_held(x_j) + Σ_{j missed} f_missed(x_j):

each past attempt moves the odds by what was seen when it was made, as in Bayes' rule.
"""

import numpy as np
import pandas as pd

from halfseen.arrays import Rows
from halfseen.cell.calibration.attempts import FACTS
from halfseen.learning.svm.estimators import CensoredSVC
from halfseen.learning.svm.kernels import SetKernel
from halfseen.shapes import Float
from halfseen.tables.grasp_attempts import checked_attempts, splits_of
from halfseen.tables.grasp_models import linear_and_gaussian, smoothest

SEEN = ("occlusion", *FACTS)
KINDS = NOW, HELD, MISSED = range(3)
NUM_FOLDS, NUM_LANDMARKS = 5, 50
"""As `SVMGrasp` has them."""


def said_by_set_svm(learned: pd.DataFrame, held_out: pd.DataFrame) -> Rows:
    """Fit to attempts, and give the probability of others; λ is chosen and probabilities are bounded as in `SVMGrasp`.

    Parameters
    ----------
    learned, held_out
        As `halfseen.cell.calibration.attempts.trials` gives them, with all past attempts at each object.
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
        cv=splits_of(decided, NUM_FOLDS, 0),
    )
    rows = [sets[row] for row in decided.row]
    svc.fit(rows, decided.succeeded, sample_weight=decided.weight)
    if smoothest(svc) > svc.reg_:
        svc.set_params(gamma=svc.gamma_, reg=smoothest(svc))
        svc.fit(rows, decided.succeeded, sample_weight=decided.weight)
    surest = 1.0 / (2.0 + decided.diagnostics.effective_sample_size)
    return np.clip(svc.predict_proba(asked)[:, 1], surest, 1.0 - surest)


def sets_of(trials: pd.DataFrame, centre: Float[np.ndarray, " d"], scale: Float[np.ndarray, " d"]) -> list[np.ndarray]:
    """Give the set of each attempt: rows of an indicator of the kind, and what was seen, scaled.

    Parameters
    ----------
    trials
        Attempts, all past ones among them.
    centre, scale
        Of what is seen.
    """
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
    """k₀ of elements."""
    num = len(KINDS)
    return (X[:, :num] @ Z[:, :num].T) * (1.0 + linear_and_gaussian(X[:, num:], Z[:, num:]))
