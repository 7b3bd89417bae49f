"""The paper's simple grasp model: mean of a Beta distributed probability (paper, §3), learned by maximum likelihood.

========  =================================================================================
symbol    here
========  =================================================================================
p         the object's own probability of a grasp, never seen
m(occ)    prior mean of p: expit(intercept + slope · occlusion)
s         strength of the prior: as many past attempts weigh as much as it does
k, l      past successes and failures
========  =================================================================================

Prior: p ~ Beta(s·m, s·(1 − m)). Predictive: P(success | occ, k, l) = (s·m(occ) + k) / (s + k + l).
"""

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import minimize
from scipy.special import expit
from sklearn.base import BaseEstimator
from sklearn.utils.validation import check_is_fitted

from halfseen.arrays import Rows
from halfseen.censoring import CensoringModel, WeightDiagnostics
from halfseen.logs.frames import FrameLike
from halfseen.tables.grasp.inputs import Decided, History, checked_attempts, checked_history

CENTRE = np.array([0.0, 0.0, np.log(2.0)])
"""Mode of the weak normal prior on intercept, slope and log s: half succeed; strength of the rule of succession."""

SPREAD = np.array([5.0, 5.0, 2.0])
"""Its standard deviations: wide, yet nothing runs away when all grasps succeed, or no object was tried twice."""

Theta = Float[np.ndarray, "3"]


class BetaGrasp(BaseEstimator):
    """Probability of a grasp as the mean of a Beta distribution over the object's own probability.

    The object's past attempts update a prior Beta(s·m, s·(1 − m)) whose mean m falls or rises with occlusion.
    Intercept, slope and log s maximise Σ_i w_i log P(outcome_i | occ_i, k_i, l_i) plus a weak normal prior. At constant
    occlusion the product of the predictive probabilities along an object's attempts is its Beta-binomial likelihood
    [Skellam1948]_, exactly; where occlusion changes between them it is what the model means by its predictive. Cut
    attempts weigh nothing, and decided ones 1/Ĝ(time_s⁻) (paper, eq. 2).

    Without history in the data s is not identified, and stays at 2, the strength of the rule of succession.

    Parameters
    ----------
    censoring
        ``"kaplan-meier"``, ``"cox"`` or ``"kernel"`` (both on the history), ``"none"`` to count decided attempts alike
        (which is biased where some were cut), or a fitted or unfitted `CensoringModel`.
    truncate_at
        Largest weight allowed, if any.

    Attributes
    ----------
    intercept_, slope_ : float
        Of the prior mean on the logit scale; the slope is for occlusion from 0 to 1.
    strength_ : float
        s.
    classes_ : Bool[ndarray, "2"]
        What the columns of `predict_proba` stand for: failed, succeeded.
    diagnostics_ : WeightDiagnostics
        Effective sample size of the weights, and the largest of them.

    Examples
    --------
    >>> tried = {"occlusion": [0.0] * 6 + [0.9] * 6, "successes": [0] * 12, "failures": [0, 1] * 6}
    >>> model = BetaGrasp().fit(tried | {"succeeded": [True] * 5 + [False] * 6 + [True]})
    >>> model.predict_proba({"occlusion": [0.0, 0.9], "successes": [0, 0], "failures": [0, 0]})[:, 1].round(1)
    array([0.9, 0.2])
    """

    intercept_: float
    slope_: float
    strength_: float
    classes_: Bool[np.ndarray, "2"]
    diagnostics_: WeightDiagnostics

    def __init__(
        self,
        *,
        censoring: str | CensoringModel = "kaplan-meier",
        truncate_at: float | int | None = None,
    ) -> None:
        self.censoring = censoring
        self.truncate_at = truncate_at

    def fit(self, frame: FrameLike) -> "BetaGrasp":
        """Learn from attempts.

        Parameters
        ----------
        frame
            occlusion in [0, 1]; successes and failures (of the object, before the attempt); succeeded, read where the
            attempt was decided; optionally time_s (duration watched [s]) together with is_finished (False: cut before
            it was decided). Other columns are not read.

        Raises
        ------
        ArgumentError
            A column or value is none that attempts can have, or none was decided; the row is named.
        PositivityError
            A weight is not identified.
        """
        decided = checked_attempts(frame, self.censoring, self.truncate_at)
        theta = fitted_theta(decided)
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
            A column or value is none that an attempt can have; the row is named.
        """
        check_is_fitted(self, "strength_")
        theta = np.array([self.intercept_, self.slope_, np.log(self.strength_)])
        probability = predictive(theta, checked_history(frame))
        return np.column_stack([1.0 - probability, probability])


def predictive(theta: Theta, history: History) -> Rows:
    """P(success) of each attempt, (s·m + k) / (s + k + l); `theta` is intercept, slope, log s."""
    strength, tries = np.exp(theta[2]), history.successes + history.failures
    return (strength * _prior_mean(theta, history) + history.successes) / (strength + tries)


def negative_log_posterior(theta: Theta, decided: Decided) -> tuple[float, Theta]:
    """What `BetaGrasp` minimises, and its gradient."""
    history, strength = decided.history, np.exp(theta[2])
    tries = history.successes + history.failures
    mean, shift = _prior_mean(theta, history), (theta - CENTRE) / SPREAD
    # Of the outcome that was seen: 1 − probability would round to 0 where a success is all but sure.
    prior = np.where(decided.succeeded, mean, _prior_mean(-theta, history))
    seen = (strength * prior + np.where(decided.succeeded, history.successes, history.failures)) / (strength + tries)
    likelihood = decided.weight @ np.log(seen)
    per_probability = np.where(decided.succeeded, decided.weight, -decided.weight) / seen
    per_logit = per_probability * strength / (strength + tries) * mean * (1.0 - mean)
    per_log_strength = per_probability * strength * (mean * tries - history.successes) / (strength + tries) ** 2
    gradient = np.array([per_logit.sum(), per_logit @ history.occlusion, per_log_strength.sum()])
    return float(shift @ shift / 2.0 - likelihood), shift / SPREAD - gradient


def _prior_mean(theta: Theta, history: History) -> Rows:
    return expit(theta[0] + theta[1] * history.occlusion)


def fitted_theta(decided: Decided) -> Theta:
    """Intercept, slope and log s of the largest posterior density."""
    bounds = [(-15.0, 15.0), (-15.0, 15.0), (-10.0, 10.0)]
    options = {"ftol": 1e-15, "gtol": 1e-9, "maxiter": 1000}
    found = minimize(
        negative_log_posterior, CENTRE, args=(decided,), jac=True, method="L-BFGS-B", bounds=bounds, options=options
    )
    return np.asarray(found.x, dtype=np.float64)
