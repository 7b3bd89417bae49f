"""Classification: of labels, or of whether T ≤ τ where some times were cut."""

from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike
from sklearn.base import ClassifierMixin
from sklearn.utils.metaestimators import available_if
from sklearn.utils.multiclass import check_classification_targets
from sklearn.utils.validation import check_is_fitted, column_or_1d

from halfseen.arrays import RowMask, Rows
from halfseen.censoring import CensoringModel
from halfseen.errors import ArgumentError
from halfseen.learning.svm.calibration import Sigmoid, fit_sigmoid
from halfseen.learning.svm.censored_svm import CensoredSVM, Fitted
from halfseen.learning.svm.cross_validation import hold_out
from halfseen.learning.svm.losses import CLASSIFICATION
from halfseen.learning.svm.targets import Ends, as_ends, checked_tau
from halfseen.learning.svm.weighting import check_lengths, row_weights


def _gives_probabilities(estimator: "CensoredSVC") -> bool:
    if not estimator.calibrate:
        raise AttributeError("predict_proba needs calibrate=True")
    return True


class CensoredSVC(ClassifierMixin, CensoredSVM):
    """Support vector classification of 1{T ≤ τ}, T right-censored for some rows, or of labels [GoldbergKosorok2017]_.

    f = g + b minimises exactly

        λ‖g‖² + (1/n) Σ_i w_i L(Y_i, f(Z_i)),   w_i = δ_i / Ĝ(min(T_i, τ)⁻ | Z_i),   Y_i = +1 if T_i ≤ τ, else −1

    over g in the kernel's space and, if `fit_intercept`, an unpenalised b (paper, eqs. 1 and 2). δ_i tells whether
    min(T_i, τ) was seen: a path that is cut at τ or later is known to be late. n counts all rows, the cut ones too;
    with sample weights s_i it is Σ s_i and w_i becomes s_i w_i. For plain labels every w_i is 1.

    Parameters
    ----------
    loss
        ``"hinge"``: max(1 − y f, 0); ``"squared-hinge"``: its square; ``"logistic"``: log(1 + exp(−y f)); or an object
        with ``value(y, s)`` and ``proximal(y, v, step)`` or ``derivative(y, s)``, convex in s.
    kernel, gamma, degree, coef0, reg, fit_intercept, num_landmarks, censoring, truncate_at, cv, tol, random_state
        As in `CensoredSVR`.
    tau
        τ [s]; None if y holds labels.
    calibrate
        Whether `predict_proba` is fitted: a sigmoid of f on rows that were held out [Platt1999]_. It costs a fit for
        each fold, or nothing if cross-validation has made them.

    Attributes
    ----------
    classes_ : ndarray
        The two classes; [False, True] for T ≤ τ. A value f > 0 speaks for the second.
    sigmoid_ : Sigmoid
        The calibration.
    intercept_, function_, reg_, gamma_, weights_, diagnostics_, censoring_, objective_, duality_gap_, cv_gammas_, \
    cv_regs_, cv_losses_
        As in `CensoredSVR`.

    Notes
    -----
    scikit-learn asks that a row of weight 2 do what the same row does twice. That holds where nothing is dealt into
    folds; with ``reg="cv"``, ``gamma="cv"`` or ``calibrate=True`` rows are dealt one by one, and a row that is there
    twice may be dealt to two folds.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> X = rng.uniform(size=(200, 1))
    >>> time, cut = rng.exponential(1.0 + 5.0 * X[:, 0]), rng.exponential(5.0, size=200)
    >>> y = (np.minimum(time, cut), time <= cut)
    >>> CensoredSVC(tau=2.0).fit(X, y).predict([[0.0], [1.0]])
    array([ True, False])
    """

    classes_: np.ndarray
    sigmoid_: Sigmoid

    def __init__(
        self,
        loss: Any = "hinge",
        *,
        kernel: Any = "rbf",
        gamma: Any = "scale",
        degree: int = 3,
        coef0: float | int = 1.0,
        reg: Any = "cv",
        fit_intercept: bool = True,
        num_landmarks: int | None = None,
        censoring: str | CensoringModel = "kaplan-meier",
        truncate_at: float | int | None = None,
        tau: float | int | None = None,
        calibrate: bool = True,
        cv: Any = 5,
        tol: float = 1e-8,
        random_state: Any = 0,
    ) -> None:
        self.loss = loss
        self.kernel = kernel
        self.gamma = gamma
        self.degree = degree
        self.coef0 = coef0
        self.reg = reg
        self.fit_intercept = fit_intercept
        self.num_landmarks = num_landmarks
        self.censoring = censoring
        self.truncate_at = truncate_at
        self.tau = tau
        self.calibrate = calibrate
        self.cv = cv
        self.tol = tol
        self.random_state = random_state

    def fit(self, X: Any, y: Any, sample_weight: ArrayLike | None = None) -> "CensoredSVC":
        """Fit to covariates and times, or to covariates and labels.

        Parameters
        ----------
        X
            One row for each path, shape (n, F), or n sets.
        y
            With `tau`: times and whether they were seen, as in `CensoredSVR.fit`, or plain times. Without: two kinds of
            labels.
        sample_weight
            How many rows each one stands for in the objective, ≥ 0. Ĝ is fitted to those above 0, each once.

        Raises
        ------
        ArgumentError
            A parameter or a value is none that it can be; the row is named.
        PositivityError
            All paths were cut, or a weight is not identified.
        """
        rows = self._checked_rows(X, is_fit=True)
        counts = self._checked_sample_weight(sample_weight, rows)
        ends = self._ends(y)
        is_second = self._fit_classes(y, ends)
        check_lengths(rows, is_second)
        self._fit_weights(ends, rows, counts)
        self._check_both_seen(is_second)
        fitted = self._fit_function(rows, np.where(is_second, 1.0, -1.0), counts)
        if self.calibrate:
            self._fit_sigmoid(fitted)
        return self

    def decision_function(self, X: Any) -> Rows:
        """f(Z): positive where the second class is predicted."""
        return self._values(X)

    def predict(self, X: Any) -> np.ndarray:
        """Class of each row."""
        f = self._values(X)
        return self.classes_[(f > 0).astype(int)]

    @available_if(_gives_probabilities)
    def predict_proba(self, X: Any) -> Float[np.ndarray, "m 2"]:
        """Probability of each class, in the order of `classes_`: the calibrated sigmoid of f."""
        f = self._values(X)
        probability = self.sigmoid_.probability(f)
        return np.stack([1.0 - probability, probability], axis=1)

    def score(self, X: Any, y: Any, sample_weight: ArrayLike | None = None) -> float:
        """Accuracy, weighted; the weights come from the rows that are scored."""
        check_is_fitted(self, "function_")
        rows = self._checked_rows(X, is_fit=False)
        counts, ends = self._checked_sample_weight(sample_weight, rows), self._ends(y)
        weights, _ = row_weights(ends, rows, counts, self.censoring, checked_tau(self.tau), self.truncate_at)
        truth = column_or_1d(y) if ends is None else self.classes_[self._is_early(ends).astype(int)]
        check_lengths(rows, truth)
        return float(weights @ (truth == self.predict(X)) / weights.sum())

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.classifier_tags.multi_class = False
        return tags

    @property
    def _losses(self) -> tuple[str, ...]:
        return CLASSIFICATION

    def _ends(self, y: Any) -> Ends | None:
        ends, tau = as_ends(y), checked_tau(self.tau)
        if ends is not None and tau is None:
            raise ArgumentError("y holds times and tau is None; give the tau that tells early from late, or labels")
        if ends is None and tau is not None:
            times = column_or_1d(y, dtype=np.float64)
            return Ends(times, np.ones(len(times), dtype=bool))
        return ends

    def _is_early(self, ends: Ends) -> RowMask:
        """T ≤ τ; a path that was cut at τ had not come to its end by then."""
        return (ends.time < self.tau) | ((ends.time == self.tau) & ends.is_finished)

    def _fit_classes(self, y: Any, ends: Ends | None) -> RowMask:
        """Name the classes, and tell which rows are of the second."""
        if ends is not None:
            self.classes_ = np.array([False, True])
            return self._is_early(ends)
        labels = column_or_1d(y, warn=True)
        check_classification_targets(labels)
        self.classes_ = np.unique(labels)
        if len(self.classes_) > 2:
            raise ArgumentError(
                f"Only binary classification is supported: y has {len(self.classes_)} classes; tell two apart, or use "
                "sklearn.multiclass.OneVsRestClassifier"
            )
        if len(self.classes_) < 2:
            raise ArgumentError(f"y holds only one class, {self.classes_[0]!r}; give labels of two classes")
        return labels == self.classes_[1]

    def _check_both_seen(self, is_second: RowMask) -> None:
        seen = is_second[self.weights_ > 0]
        if len(seen) == 0 or seen.all() or not seen.any():
            shown = "no class" if len(seen) == 0 else f"one class, {self.classes_[int(seen[0])]!r},"
            raise ArgumentError(
                f"only {shown} was seen among {len(is_second)} rows; both are needed to tell them apart"
            )

    def _fit_sigmoid(self, fitted: Fitted) -> None:
        held_out = fitted.held_out
        if held_out is None:
            folds = self._folds(fitted.task, fitted.seen)
            held_out = hold_out(fitted.task, fitted.design, self.reg_, folds, fitted.num_rows, fitted.seen)
        self.sigmoid_ = fit_sigmoid(held_out, fitted.task.y, fitted.task.weight)
