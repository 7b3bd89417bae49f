"""The models: each is fitted to the attempts at some tables, and predicts those at others."""

from collections.abc import Callable
from functools import partial

import numpy as np
import pandas as pd

from halfseen.arrays import Rows
from halfseen.cell.calibration.grasp_fit import fit_grasping
from halfseen.cell.calibration.held_given_past import held_given_past
from halfseen.cell.calibration.trials import FACTS
from halfseen.study.experiments.attempts.design import BETA, LAW, RATE, SVM, SVM_FACTS, SVM_SET, SVMS
from halfseen.study.experiments.attempts.set_svm import said_by_set_svm
from halfseen.tables.grasp_attempts import can_hold_out, checked_attempts
from halfseen.tables.grasp_models import BetaGrasp, SVMGrasp


def predicted(model: str, learned: pd.DataFrame, held_out: pd.DataFrame) -> Rows:
    """Fit a model to attempts, and give the probability of each attempt that was held out.

    Where misses were seen of fewer than two objects, an SVM cannot be fitted; one rate for all stands in for it.

    Parameters
    ----------
    model
        One of `design.MODEL_NAMES`.
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


def _law(learned: pd.DataFrame, held_out: pd.DataFrame) -> Rows:
    return held_given_past(fit_grasping(learned).estimate, held_out)


_PREDICTED: dict[str, Callable[[pd.DataFrame, pd.DataFrame], Rows]] = {
    RATE: _rate,
    BETA: partial(_estimator, BetaGrasp),
    SVM: partial(_estimator, SVMGrasp),
    SVM_FACTS: partial(_estimator, partial(SVMGrasp, covariates=FACTS)),
    SVM_SET: said_by_set_svm,
    LAW: _law,
}
