"""The paper's grasp models (paper, §3): the mean of a Beta distributed probability, by maximum likelihood, and an SVM.

========  =================================================================================
symbol    here
========  =================================================================================
p         the object's own probability of a grasp, unobserved
m(occ)    prior mean of p: expit(intercept + slope · occlusion)
s         strength of the prior, as an equivalent number of past attempts
k, l      past successes and failures
========  =================================================================================

Prior: p ~ Beta(s·m, s·(1 − m)). Predictive: P(success | occ, k, l) = (s·m(occ) + k) / (s + k + l).
"""

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, field
from typing import Any

import numpy as np

from halfseen.arrays import Rows
from halfseen.censoring import CensoringModel, WeightDiagnostics
from halfseen.errors import ArgumentError
from halfseen.estimator import Estimator, check_fitted
from halfseen.learning.behaviour import Derivatives, minimise_each
from halfseen.learning.svm.estimators import CensoredSVC
from halfseen.logs.frames import FrameLike
from halfseen.shapes import Bool, Float
from halfseen.tables.grasp_attempts import (
    DecidedAttempts,
    checked_attempts,
    checked_covariates,
    checked_history,
    kinds,
    splits_of,
)
from halfseen.tables.grasp_table import History

CENTRE = np.array([0.0, 0.0, np.log(2.0)])
"""Mode of the weak normal prior on intercept, slope and log s: half succeed; strength of the rule of succession."""
SPREAD = np.array([5.0, 5.0, 2.0])
"""Its standard deviations: wide, but estimates stay finite if all grasps succeed, or no object was tried twice."""
Theta = Float[np.ndarray, "3"]
Weights = Float[np.ndarray, "K n"]


@dataclass(eq=False, repr=False)
class BetaGrasp(Estimator):
    """Probability of a grasp as the mean of a Beta distribution over the object's own probability.

    The object's past attempts update a prior Beta(s·m, s·(1 − m)) whose mean m depends on occlusion. Intercept, slope
    and log s maximise Σ_i w_i log P(outcome_i | occ_i, k_i, l_i) plus the log-density of a weak normal prior. At
    constant occlusion the product of the predictive probabilities of an object's attempts is exactly its Beta-binomial
    likelihood [Skellam1948]_. If occlusion changes between attempts, the predictive probabilities define the model. Cut
    attempts have weight 0, decided ones 1/Ĝ(time_s⁻) (paper, eq. 2).

    Without history in the data s is not identified, and stays at 2, the strength of the rule of succession.

    Parameters
    ----------
    censoring
        ``"kaplan-meier"``, ``"cox"`` or ``"kernel"`` (both on the history), ``"none"`` for equal weights of decided
        attempts (biased if some were cut), or a fitted or unfitted `CensoringModel`.
    truncate_at
        Largest weight allowed, if any.

    Attributes
    ----------
    intercept_, slope_ : float
        Of the prior mean on the logit scale; the slope is for occlusion from 0 to 1.
    strength_ : float
        s.
    classes_ : Bool[ndarray, "2"]
        Classes of the columns of `predict_proba`: failed, succeeded.
    diagnostics_ : WeightDiagnostics
        Effective sample size of the weights, and the largest of them.

    Examples
    --------
    >>> tried = {"occlusion": [0.0] * 6 + [0.9] * 6, "successes": [0] * 12, "failures": [0, 1] * 6}
    >>> model = BetaGrasp().fit(tried | {"succeeded": [True] * 5 + [False] * 6 + [True]})
    >>> model.predict_proba({"occlusion": [0.0, 0.9], "successes": [0, 0], "failures": [0, 0]})[:, 1].round(1)
    array([0.9, 0.2])
    """

    _: KW_ONLY
    censoring: str | CensoringModel = "kaplan-meier"
    truncate_at: float | int | None = None

    intercept_: float = field(init=False)
    slope_: float = field(init=False)
    strength_: float = field(init=False)
    classes_: Bool[np.ndarray, "2"] = field(init=False)
    diagnostics_: WeightDiagnostics = field(init=False)

    def fit(self, frame: FrameLike) -> "BetaGrasp":
        """Learn from attempts.

        Parameters
        ----------
        frame
            occlusion in [0, 1]; successes and failures (of the object, before the attempt); succeeded, read where the
            attempt was decided; optionally time_s (duration watched [s]) together with is_finished (False: cut before
            it was decided). Other columns are ignored.

        Raises
        ------
        ArgumentError
            A column or value is invalid, or no attempt was decided; the row is named.
        PositivityError
            A weight is not identified.
        """
        decided = checked_attempts(frame, self.censoring, self.truncate_at)
        theta = fitted_thetas(decided, decided.weight[None])[0]
        self.intercept_, self.slope_, self.strength_ = float(theta[0]), float(theta[1]), float(np.exp(theta[2]))
        self.classes_ = np.array([False, True])
        self.diagnostics_ = decided.diagnostics
        return self

    def predict_proba(self, frame: FrameLike) -> Float[np.ndarray, "m 2"]:
        """Probability that an attempt fails, and that it succeeds.

        Parameters
        ----------
        frame
            occlusion, successes and failures.

        Raises
        ------
        ArgumentError
            A column or value is invalid; the row is named.
        """
        check_fitted(self, "strength_")
        theta = np.array([self.intercept_, self.slope_, np.log(self.strength_)])
        probability = predictive(theta, checked_history(frame))
        return np.column_stack([1.0 - probability, probability])


def predictive(theta: Theta, history: History) -> Rows:
    """P(success) of each attempt, (s·m + k) / (s + k + l); `theta` is intercept, slope, log s."""
    from scipy.special import expit

    strength, tries = np.exp(theta[2]), history.successes + history.failures
    mean = expit(theta[0] + theta[1] * history.occlusion)
    return (strength * mean + history.successes) / (strength + tries)


def negative_log_posteriors(theta: Float[np.ndarray, "K 3"], decided: DecidedAttempts, weight: Weights) -> Derivatives:
    """Loss of `BetaGrasp`, its gradient and its Hessian, for K weightings of the same attempts at once.

    With η the logit of m, μ the mean of the observed outcome (m or 1 − m) and c its count (k or l), an attempt has
    probability q = (s·μ + c) / (s + k + l) and adds −log q to the loss.
    """
    from scipy.special import expit

    history, sign = decided.history, np.where(decided.succeeded, 1.0, -1.0)
    tries, count = history.successes + history.failures, np.where(decided.succeeded, *history[1:])
    strength = np.exp(theta[:, 2:])
    # Mean of the observed outcome: 1 − probability would round to 0 where a success is almost certain.
    mean = expit(sign * (theta[:, :1] + theta[:, 1:2] * history.occlusion))
    own, other = strength / (strength + tries), tries / (strength + tries)
    above = strength * mean + count
    share, rest = strength * mean / above, count / above
    # ∂ log q / ∂η is sign·per_logit, and ∂ log q / ∂ log s is share − own.
    per_logit = share * (1.0 - mean)
    log_seen = np.log(above) - np.log(strength + tries)
    shift = (theta - CENTRE) / SPREAD
    loss = (shift**2).sum(axis=1) / 2.0 - (weight * log_seen).sum(axis=1)
    first = np.stack([weight * sign * per_logit, weight * (share - own)])
    bend = weight * (per_logit * (1.0 - 2.0 * mean) - per_logit**2)
    twist, swell = weight * sign * per_logit * rest, weight * (share * rest - own * other)
    occluded = history.occlusion
    gradient = np.stack([first[0].sum(axis=1), first[0] @ occluded, first[1].sum(axis=1)], axis=1)
    entries = (bend.sum(axis=1), bend @ occluded, twist.sum(axis=1))
    entries += (bend @ occluded**2, twist @ occluded, swell.sum(axis=1))
    hessian = np.stack(entries, axis=1)[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
    return loss, shift / SPREAD - gradient, np.diag(SPREAD**-2.0) - hessian


def fitted_thetas(decided: DecidedAttempts, weight: Weights) -> Float[np.ndarray, "K 3"]:
    """Posterior mode of intercept, slope and log s under each of K weightings."""
    first, kind = kinds(*decided.history, decided.succeeded)
    each = decided.among(first)
    of_kind = np.stack([np.bincount(kind, row, len(first)) for row in weight])
    return minimise_each(lambda theta: negative_log_posteriors(theta, each, of_kind), np.tile(CENTRE, (len(weight), 1)))


LINEAR_AND_GAUSSIAN = "linear+gaussian"
SLACK = 0.01
"""Held-out losses within this share of the smallest count as equal."""


@dataclass(eq=False, repr=False)
class SVMGrasp(Estimator):
    """Probability of a grasp by the censored SVM (paper, eqs. 1 and 2), with logistic loss, calibrated.

    The features are occlusion, log(1 + successes) and log(1 + failures), each scaled to unit weighted variance: the
    first failure is more informative than the fifth. In these features the log-odds of a Beta mean,
    log(s·m + k) − log(s·(1 − m) + l), are nearly linear. So the kernel is x·z + exp(−‖x − z‖² / d), d being the number
    of features: the linear part learns from few attempts, and the Gaussian part adds deviations from it.

    Cut attempts have weight 0, decided ones 1/Ĝ(time_s⁻). λ is chosen by the weighted loss on held-out attempts; the
    attempts at one object are never split. It is the largest λ whose loss is within 1 % of the smallest, because a
    smaller λ changes f most where no attempt was made. Values of held-out attempts calibrate the probabilities
    [Platt1999]_. They are limited to those of the rule of succession after as many equal outcomes as the effective
    sample size.

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
        Further numeric columns of the attempts, added to the features. A model with covariates cannot be tabulated for
        a policy, because `GraspTable` does not have them.
    random_state
        Seed of folds and landmarks.

    Attributes
    ----------
    svc_ : CensoredSVC
        The classifier, on scaled features.
    centre_, scale_ : Float[ndarray, "d"]
        Mean and scale of the features.
    classes_ : Bool[ndarray, "2"]
        Classes of the columns of `predict_proba`: failed, succeeded.
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
            As in `BetaGrasp.fit`; optionally object, whose attempts cross-validation keeps together; and the columns
            `covariates`. Without object, every attempt has an object of its own.

        Raises
        ------
        ArgumentError
            A column or value is invalid, no attempt was decided, or only one outcome occurred.
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

        The argument is that of `BetaGrasp.predict_proba`, with the columns `covariates`.
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
    """Largest λ whose held-out loss is close to the smallest, for the chosen γ."""
    losses = svc.cv_losses_[np.argmax(svc.cv_gammas_ == svc.gamma_)]
    return float(svc.cv_regs_[np.argmax(losses <= (1.0 + SLACK) * losses.min())])


def linear_and_gaussian(X: Float[np.ndarray, "n d"], Z: Float[np.ndarray, "m d"]) -> Float[np.ndarray, "n m"]:
    """x·z + exp(−‖x − z‖² / d) of scaled features."""
    from scipy.spatial.distance import cdist

    return X @ Z.T + np.exp(-cdist(X, Z, "sqeuclidean") / X.shape[1])
