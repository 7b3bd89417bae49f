"""The paper's second grasp model: a support vector machine that tells whether an attempt will succeed (paper, §3)."""

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, field
from typing import Any

import numpy as np

from halfseen.censoring import CensoringModel, WeightDiagnostics
from halfseen.errors import ArgumentError
from halfseen.estimator import Estimator, check_fitted
from halfseen.learning.svm.estimators import CensoredSVC
from halfseen.logs.frames import FrameLike
from halfseen.shapes import Bool, Float
from halfseen.tables.grasp.grasp_table import History
from halfseen.tables.grasp.inputs import (
    checked_attempts,
    checked_covariates,
    checked_history,
    splits_of,
)

LINEAR_AND_GAUSSIAN = "linear+gaussian"
SLACK = 0.01
"""Held-out losses that differ by less than this share of the least are taken as equal."""


@dataclass(eq=False, repr=False)
class SVMGrasp(Estimator):
    """Probability of a grasp by the censored SVM (paper, eqs. 1 and 2), with logistic loss, calibrated.

    It looks at the occlusion and at log(1 + successes) and log(1 + failures), each scaled to unit weighted variance:
    the first failure tells more than the fifth. In these features the log odds of a Beta mean,
    log(s·m + k) − log(s·(1 − m) + l), are nearly linear. So the kernel is x·z + exp(−‖x − z‖² / d), d being the number
    of features: the linear part says that much from few attempts, and the Gaussian part adds what departs from it.

    Cut attempts weigh nothing, and decided ones 1/Ĝ(time_s⁻). λ is chosen by the weighted loss on attempts that were
    held out, never splitting the attempts of one object: the largest λ whose loss is within 1 % of the least, because
    below it f changes most where no attempt was made. Values of held-out attempts calibrate the probabilities
    [Platt1999]_. None is surer than the rule of succession after as many attempts, all alike, as the effective sample
    size.

    Parameters
    ----------
    censoring, truncate_at
        As in `BetaGrasp`.
    kernel, gamma
        ``"linear+gaussian"``, which has no gamma; or any of `CensoredSVC`.
    reg
        λ, or ``"cv"``.
    num_folds
        Folds of the cross-validation.
    num_landmarks
        Rank of the kernel's low-rank form; None for the exact kernel.
    covariates
        Columns that tell what else is seen of each attempt, numbers; they join the features. A model that has any
        cannot be tabulated for a policy, as those numbers are not among what `GraspTable` is asked.
    random_state
        Seed of folds and landmarks.

    Attributes
    ----------
    svc_ : CensoredSVC
        The classifier, on scaled features.
    centre_, scale_ : Float[ndarray, "d"]
        Of the features.
    classes_ : Bool[ndarray, "2"]
        What the columns of `predict_proba` stand for: failed, succeeded.
    diagnostics_ : WeightDiagnostics
        Effective sample size of the weights, and the largest of them.

    Examples
    --------
    >>> tried = {"occlusion": [0.0] * 6 + [0.9] * 6, "successes": [0] * 12, "failures": [0, 1] * 6}
    >>> model = SVMGrasp().fit(tried | {"succeeded": [True] * 5 + [False] * 6 + [True]})
    >>> probability = model.predict_proba({"occlusion": [0.0, 0.9], "successes": [0, 0], "failures": [0, 0]})[:, 1]
    >>> bool(probability[0] > probability[1])
    True
    """

    _: KW_ONLY
    censoring: str | CensoringModel = "kaplan-meier"
    truncate_at: float | int | None = None
    kernel: Any = LINEAR_AND_GAUSSIAN
    gamma: float | int | str = "scale"
    reg: float | int | str = "cv"
    num_folds: int = 5
    num_landmarks: int | None = 50
    random_state: int = 0
    covariates: Sequence[str] = ()

    svc_: CensoredSVC = field(init=False)
    centre_: Float[np.ndarray, " d"] = field(init=False)
    scale_: Float[np.ndarray, " d"] = field(init=False)
    classes_: Bool[np.ndarray, "2"] = field(init=False)
    diagnostics_: WeightDiagnostics = field(init=False)

    def fit(self, frame: FrameLike) -> "SVMGrasp":
        """Learn from attempts.

        Parameters
        ----------
        frame
            As in `BetaGrasp.fit`; and optionally object, whose attempts cross-validation keeps together. Without it,
            every attempt counts as one of an object of its own. And the columns `covariates`.

        Raises
        ------
        ArgumentError
            A column or value is none that attempts can have, none was decided, or only one outcome was seen.
        PositivityError
            A weight is not identified.
        """
        decided = checked_attempts(frame, self.censoring, self.truncate_at)
        if len(np.unique(decided.succeeded)) < 2:
            word = "succeeded" if decided.succeeded.all() else "failed"
            raise ArgumentError(
                f"all {len(decided.succeeded)} decided attempts {word}; an SVM needs both outcomes: record more, or "
                "use BetaGrasp"
            )
        features = self._features(decided.history, checked_covariates(frame, self.covariates)[decided.row])
        share = decided.weight / decided.weight.sum()
        self.centre_ = share @ features
        variance = share @ np.square(features - self.centre_)
        self.scale_ = np.where(variance > 0.0, np.sqrt(variance), 1.0)
        num_landmarks = None if self.num_landmarks is None else min(self.num_landmarks, len(features))
        svc = CensoredSVC(
            "logistic",
            kernel=linear_and_gaussian if self.kernel == LINEAR_AND_GAUSSIAN else self.kernel,
            gamma=self.gamma,
            reg=self.reg,
            num_landmarks=num_landmarks,
            cv=splits_of(decided, self.num_folds, self.random_state),
            random_state=self.random_state,
        )
        scaled = (features - self.centre_) / self.scale_
        self.svc_ = svc.fit(scaled, decided.succeeded, sample_weight=decided.weight)
        if self.reg == "cv" and smoothest(svc) > svc.reg_:
            svc.set_params(gamma=svc.gamma_, reg=smoothest(svc))
            svc.fit(scaled, decided.succeeded, sample_weight=decided.weight)
        self.classes_ = self.svc_.classes_
        self.diagnostics_ = decided.diagnostics
        return self

    def predict_proba(self, frame: FrameLike) -> Float[np.ndarray, "m 2"]:
        """Probability that an attempt fails, and that it succeeds.

        It is asked as `BetaGrasp.predict_proba` is, and told `covariates`.
        """
        check_fitted(self, "svc_")
        features = self._features(checked_history(frame), checked_covariates(frame, self.covariates))
        probabilities = self.svc_.predict_proba((features - self.centre_) / self.scale_)
        surest = 1.0 / (2.0 + self.diagnostics_.effective_sample_size)
        return np.clip(probabilities, surest, 1.0 - surest)

    def _features(self, history: History, covariates: Float[np.ndarray, "rows k"]) -> Float[np.ndarray, "rows d"]:
        counts = np.log1p(history.successes), np.log1p(history.failures)
        return np.column_stack([history.occlusion, *counts, covariates])


def smoothest(svc: CensoredSVC) -> float:
    """The largest λ whose held-out loss is about the least, of those with the γ that was chosen."""
    losses = svc.cv_losses_[np.argmax(svc.cv_gammas_ == svc.gamma_)]
    return float(svc.cv_regs_[np.argmax(losses <= (1.0 + SLACK) * losses.min())])


def linear_and_gaussian(X: Float[np.ndarray, "n d"], Z: Float[np.ndarray, "m d"]) -> Float[np.ndarray, "n m"]:
    """x·z + exp(−‖x − z‖² / d) of scaled features."""
    from scipy.spatial.distance import cdist

    return X @ Z.T + np.exp(-cdist(X, Z, "sqeuclidean") / X.shape[1])
