"""Models of the probability that an attempt of the physical cell holds, among them an SVM on sets of attempts.

Decided attempts have weight 1/Ĝ, held out or not; Ĝ is fitted to each of the two sets separately.

An attempt is a set of elements: itself, and earlier attempts at the same object, each
with the occlusion and the facts seen then. Between elements k₀(a, b) = 1{same kind} (1 + a·b + exp(−‖a − b‖² / d)),
where the kinds are: now, held in the past, missed in the past. The kernel of two sets is the sum over all pairs of
their elements, so that

    f = b + f_now(x) + Σ_{j held} f_held(x_j) + Σ_{j missed} f_missed(x_j):

each past attempt changes the log-odds by what was seen when it was made, as in Bayes' rule.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats
from scipy.special import expit, logit

from halfseen.arrays import RowMask, Rows
from halfseen.cell.calibration.attempts import FACTS
from halfseen.cell.calibration.fits import NAMES, GraspFit, fit_grasping, held_given_past, held_share
from halfseen.learning.svm.estimators import CensoredSVC
from halfseen.learning.svm.kernels import SetKernel
from halfseen.shapes import Float
from halfseen.study.compare import LEVEL, Frame
from halfseen.tables.grasp_attempts import can_hold_out, checked_attempts, splits_of
from halfseen.tables.grasp_models import BetaGrasp, SVMGrasp, linear_and_gaussian, smoothest
from halfseen.world.config import WorldConfig

MODELS = RATE, BETA, SVM, SVM_FACTS, SVM_SET, LAW = "rate", "beta", "svm", "svm-facts", "svm-set", "law"
SVMS = (SVM, SVM_FACTS, SVM_SET)
MEASURES = ("log_loss", "brier")
"""Scores of the models on unseen tables; smaller is better."""
COLUMNS = ["trajectory", "stage", "object", "occlusion", "successes", "failures", "succeeded", "time_s", "is_finished"]
COLUMNS += FACTS
SUREST = 1e-9  # log-loss clips predictions at this distance from 0 and 1: else a miss could cost infinitely much
SEEN = ["occlusion", *FACTS]
KINDS = NOW, HELD, MISSED = range(3)
NUM_LANDMARKS, NUM_SVM_FOLDS = 50, 5  # as in `SVMGrasp`

SHOWN: Float[np.ndarray, " shown"] = np.linspace(0.0, 0.8, 17)  # occlusions at which curves are drawn
Z = float(stats.norm.ppf(0.5 + LEVEL / 2))
_STEP = 1e-5
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(41)


def losses_of(probability: Rows, succeeded: RowMask) -> dict[str, Rows]:
    """Log-loss and Brier score of each attempt."""
    sure = np.clip(probability, SUREST, 1.0 - SUREST)
    return {"log_loss": -np.log(np.where(succeeded, sure, 1.0 - sure)), "brier": np.square(probability - succeeded)}


def predicted(model: str, learned: Frame, held_out: Frame) -> Rows:
    """Fit a model to attempts, and return the probability of each held-out attempt.

    If fewer than two objects were ever missed, an SVM cannot be fitted, and one rate for all replaces it.

    Parameters
    ----------
    model
        One of `MODELS`.
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


def said_by_set_svm(learned: Frame, held_out: Frame) -> Rows:
    """Fit to attempts, and return the probability of others; λ and bounds of probabilities as in `SVMGrasp`.

    Parameters
    ----------
    learned, held_out
        As returned by `halfseen.cell.calibration.attempts.trials`, with all past attempts at each object.
    """
    decided = checked_attempts(learned)
    values = learned.iloc[decided.row][SEEN].to_numpy(dtype=np.float64)
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


def sets_of(trials: Frame, centre: Float[np.ndarray, " d"], scale: Float[np.ndarray, " d"]) -> list[np.ndarray]:
    """Return the set of each attempt: rows of an indicator of the kind, and the scaled covariates."""
    seen = (trials[SEEN].to_numpy(dtype=np.float64) - centre) / scale
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


def assumed_share(occlusion: Float[np.ndarray, " shown"]) -> Float[np.ndarray, " shown"]:
    """P(held) under the assumed laws, with the offset of an object integrated out."""
    law: Any = WorldConfig().grasping
    log_failure = law.log_failure(occlusion[:, None], float(law.offset_std) * _NODES)
    return (1.0 - np.exp(np.asarray(log_failure, dtype=np.float64))) @ (_WEIGHTS / _WEIGHTS.sum())


def law_of(planner: str, fit: GraspFit) -> Frame:
    """Estimates of the regression, with normal 95 % confidence intervals clustered by table."""
    value, error = fit.estimate, fit.standard_error
    p_value = 2.0 * stats.norm.sf(np.abs(value) / error)
    law = {"planner": planner, "parameter": NAMES, "estimate": value, "se": error}
    return pd.DataFrame(law | {"low": value - Z * error, "high": value + Z * error, "p_value": p_value})


def slopes_of(fits: Mapping[str, GraspFit]) -> Frame:
    """P(held) by occlusion at the first attempt at a usual object: by each regression, and under the assumed laws."""
    curves = [
        pd.DataFrame({"law": planner, "is_lying": lies, "occlusion": SHOWN} | _curve(fit, lies))
        for planner, fit in fits.items()
        for lies in (False, True)
    ]
    assumed = {"law": "assumed", "is_lying": False, "occlusion": SHOWN, "share_held": assumed_share(SHOWN)}
    return pd.concat([*curves, pd.DataFrame(assumed)], ignore_index=True)


def _curve(fit: GraspFit, lies: bool) -> dict[str, Float[np.ndarray, " shown"]]:
    """P(held) by occlusion, with bands by the delta method on the logit scale."""
    covariates = np.zeros((len(SHOWN), len(NAMES) - 1))
    covariates[:, 0], covariates[:, 1], covariates[:, NAMES.index("is_lying")] = 1.0, SHOWN, float(lies)

    def log_odds(theta: Float[np.ndarray, " p"]) -> Float[np.ndarray, " shown"]:
        return logit(held_share(theta, covariates))

    steps = _STEP * np.eye(len(NAMES))
    gradient = [(log_odds(fit.estimate + step) - log_odds(fit.estimate - step)) / (2.0 * _STEP) for step in steps]
    reach = Z * np.sqrt(np.einsum("ps,pq,qs->s", gradient, fit.covariance, gradient))
    middle = log_odds(fit.estimate)
    return {"share_held": expit(middle), "low": expit(middle - reach), "high": expit(middle + reach)}
