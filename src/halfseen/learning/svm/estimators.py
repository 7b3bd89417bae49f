"""The censored SVM as scikit-learn estimators (paper, eqs. 1 and 2): regression, and classification."""

from dataclasses import KW_ONLY, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import ClassifierMixin, RegressorMixin
from sklearn.utils.metaestimators import available_if
from sklearn.utils.multiclass import check_classification_targets
from sklearn.utils.validation import column_or_1d

from halfseen.arrays import RowMask, Rows
from halfseen.censoring.clocks import clock_tolerance_s
from halfseen.errors import ArgumentError
from halfseen.learning.svm.losses import CLASSIFICATION, REGRESSION
from halfseen.learning.svm.machine import CensoredSVM
from halfseen.learning.svm.rows import Ends, Sigmoid, as_ends, fit_sigmoid, hold_out, target_values
from halfseen.learning.svm.solver import best_constant
from halfseen.shapes import Float


@dataclass(eq=False, repr=False)
class CensoredSVR(RegressorMixin, CensoredSVM):
    """Support vector regression of Y(T) on covariates, with some times T right-censored [GoldbergKosorok2017]_.

    f = g + b is the exact minimiser of

        λ‖g‖² + (1/n) Σ_i w_i L(Y(T_i), f(Z_i)),   w_i = δ_i / Ĝ(T_i⁻ | Z_i)

    over g in the kernel's space and, with `fit_intercept`, an unpenalised b (paper, eqs. 1 and 2). n counts all rows,
    including cut ones; with sample weights s_i, n is Σ s_i and w_i becomes s_i w_i. With `tau` the target is
    Y(min(T, τ)), and δ_i is whether min(T_i, τ) was observed.

    Parameters
    ----------
    loss
        ``"squared"``: (y − f)²; ``"absolute"``: abs(y − f), for the median; ``"pinball"``: max(q (y − f),
        (1 − q)(f − y)), for the `quantile` q; ``"epsilon-insensitive"``: max(abs(y − f) − ε, 0); ``"huber"``:
        ½ (y − f)² up to `delta` and linear beyond; or an object with ``value(y, s)`` and ``proximal(y, v, step)`` or
        ``derivative(y, s)``, convex in s.
    epsilon, delta
        ε ≥ 0 and δ > 0 of the losses [unit of the target].
    quantile
        q in (0, 1) of the pinball loss.
    kernel
        ``"linear"``; ``"rbf"``: exp(−γ‖x − z‖²); ``"laplacian"``: exp(−γ‖x − z‖₁); ``"polynomial"``:
        (γ x·z + coef0)^degree; ``"set"``: rows are sets of objects, arrays of shape (number of objects, F), and k is
        the mean of rbf over pairs; a `SetKernel`; or any callable (X, Z) → (n, m).
    gamma
        γ > 0; ``"scale"``: 1 / (F · variance of X); ``"cv"``: chosen with λ by cross-validation.
    degree, coef0
        Parameters of the polynomial kernel.
    reg
        λ ≥ 0, or ``"cv"``: chosen by the weighted loss on held-out rows.
    fit_intercept
        Whether to fit b.
    num_landmarks
        None: the exact kernel, n × n numbers; a number: a low-rank kernel with that many landmarks, for large n.
    censoring
        ``"kaplan-meier"``, ``"cox"`` or ``"kernel"`` (both on X), ``"none"`` (equal weights for observed rows, which is
        biased), or a `CensoringModel`, which is fitted again.
    truncate_at
        Largest 1/Ĝ allowed, if any.
    target
        Y: ``"identity"``, ``"log"``, or a function of an array of times.
    tau
        τ [s]: times are restricted to min(T, τ); None for unrestricted times.
    cv
        Number of folds, a scikit-learn splitter, or the splits.
    tol
        Relative duality gap to reach.
    random_state
        Seed of folds and landmarks.

    Attributes
    ----------
    intercept_ : float
        b.
    function_ : Nystrom
        g, as a sum of kernels; its `transform` gives the values at new rows.
    reg_, gamma_ : float
        λ and γ used.
    weights_ : Float[ndarray, "n"]
        w, 0 where cut.
    diagnostics_ : WeightDiagnostics
        Effective sample size, largest weight, proportion truncated.
    censoring_ : CensoringModel
        Ĝ; None if nothing can be cut.
    objective_, duality_gap_ : float
        The objective, and its certificate: the optimum is at most `duality_gap_` lower. A `HalfseenWarning` is issued
        if the gap exceeds `tol` times the objective.
    cv_gammas_, cv_regs_ : Float[ndarray, "G"], Float[ndarray, "L"]
        Every γ and every λ tried, if they were chosen.
    cv_losses_ : Float[ndarray, "G L"]
        Their weighted mean losses on held-out rows; ∞ where a fold was stopped because its loss had risen a fifth above
        its minimum.

    Notes
    -----
    scikit-learn requires that a row of weight 2 is equivalent to two copies of the row. That holds without folds where
    Ĝ is not fitted, as Ĝ counts each row once. With ``reg="cv"`` or ``gamma="cv"`` rows are assigned to folds one by
    one, so two copies may be in different folds.

    Examples
    --------
    >>> from halfseen.learning import survival_array
    >>> rng = np.random.default_rng(0)
    >>> X = rng.uniform(size=(200, 1))
    >>> time, cut = np.exp(X[:, 0] + 0.1 * rng.normal(size=200)), rng.exponential(5.0, size=200)
    >>> y = survival_array(np.minimum(time, cut), time <= cut)
    >>> model = CensoredSVR(loss="absolute", target="log", reg=1e-3).fit(X, y)
    >>> model.predict([[0.5]]).round(1)
    array([0.5])
    """

    _losses = REGRESSION
    _loss_parameters = ("epsilon", "quantile", "delta")

    loss: Any = "epsilon-insensitive"
    _: KW_ONLY
    epsilon: float | int = 0.1
    quantile: float | int = 0.5
    delta: float | int = 1.0
    target: Any = "identity"

    def fit(self, X: Any, y: Any, sample_weight: ArrayLike | None = None) -> "CensoredSVR":
        """Fit to covariates and times.

        Parameters
        ----------
        X
            One row per trajectory, shape (n, F), or n sets.
        y
            Times and whether they were observed: a structured array as in scikit-survival (`survival_array` makes one),
            a frame with ``is_finished`` and ``time`` or ``time_s`` [s], or a tuple (time, is_finished). A plain column
            of numbers is an uncensored target.
        sample_weight
            Number of rows that each row represents in the objective, ≥ 0. Ĝ is fitted to rows of positive weight, each
            counted once.

        Raises
        ------
        ArgumentError
            A parameter or a value is invalid; the message names the row.
        PositivityError
            All trajectories were cut, or a weight is not identified.
        """
        self._fit(X, y, sample_weight)
        return self

    def predict(self, X: Any) -> Rows:
        """Estimate Y(T) by f(Z), in the target's unit: with ``target="log"``, logarithms of times.

        Parameters
        ----------
        X
            Rows to predict, shape (m, F), or m sets.
        """
        return self._values(X)

    def score(self, X: Any, y: Any, sample_weight: ArrayLike | None = None) -> float:
        """Proportion of the loss that f explains: 1 − Σ w L(Y, f) / Σ w L(Y, c), with c the best constant.

        With the squared loss this is R². The weights come from the same kind of censoring model, fitted to the scored
        rows.

        Raises
        ------
        ArgumentError
            Fewer than two rows were observed, or all targets are equal.
        """
        f, ends = self._values(X), self._ends(y)
        values = self._targets(y, ends)
        _, weights, _ = self._weigh(self._checked_rows(X, False, y), sample_weight, ends, values)
        seen, loss = weights > 0, self._checked_loss(values)
        constant = best_constant(values[seen], weights[seen], loss)
        left, most = (weights[seen] @ loss.value(values[seen], s[seen]) for s in (f, np.full(len(f), constant)))
        if most <= 0.0:
            raise ArgumentError(
                f"score has {int(seen.sum())} observed rows, whose targets a constant fits exactly; give more rows"
            )
        return float(1.0 - left / most)

    def _targets(self, y: Any, ends: Ends | None) -> Rows:
        """Y of every row; a cut row gets an arbitrary value, because its weight is 0."""
        time = column_or_1d(y, dtype=np.float64, warn=True) if ends is None else ends.time
        return target_values(time if self.tau is None else np.minimum(time, self.tau), self.target)


def _gives_probabilities(estimator: "CensoredSVC") -> bool:
    if not estimator.calibrate:
        raise AttributeError("predict_proba needs calibrate=True")
    return True


@dataclass(eq=False, repr=False)
class CensoredSVC(ClassifierMixin, CensoredSVM):
    """Support vector classification of 1{T ≤ τ}, with some T right-censored, or of labels [GoldbergKosorok2017]_.

    f = g + b is the exact minimiser of

        λ‖g‖² + (1/n) Σ_i w_i L(Y_i, f(Z_i)),   w_i = δ_i / Ĝ(min(T_i, τ)⁻ | Z_i),   Y_i = +1 if T_i ≤ τ, else −1

    over g in the kernel's space and, with `fit_intercept`, an unpenalised b (paper, eqs. 1 and 2). δ_i is whether
    min(T_i, τ) was observed: a trajectory cut at τ or later is known to be late. n counts all rows, including cut ones;
    with sample weights s_i, n is Σ s_i and w_i becomes s_i w_i. For plain labels every w_i is 1.

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
        Whether to fit `predict_proba`: a sigmoid of f on held-out rows [Platt1999]_. It costs a fit for each fold, or
        nothing if cross-validation has already made these fits.

    Attributes
    ----------
    classes_ : ndarray
        The two classes; [False, True] for T ≤ τ. f > 0 predicts the second.
    sigmoid_ : Sigmoid
        The calibration.
    intercept_, function_, reg_, gamma_, weights_, diagnostics_, censoring_, objective_, duality_gap_, cv_gammas_, \
    cv_regs_, cv_losses_
        As in `CensoredSVR`.

    Notes
    -----
    A row of weight 2 is two copies of the row where it is for `CensoredSVR`, and ``calibrate=False``. scikit-learn's
    ``cross_val_score(…, cv=5)`` and searches stratify by y, which fails for times; give them ``cv=KFold(5)``.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> X = rng.uniform(size=(200, 1))
    >>> time, cut = rng.exponential(1.0 + 5.0 * X[:, 0]), rng.exponential(5.0, size=200)
    >>> y = (np.minimum(time, cut), time <= cut)
    >>> CensoredSVC(tau=2.0).fit(X, y).predict([[0.0], [1.0]])
    array([ True, False])
    """

    _losses = CLASSIFICATION

    loss: Any = "hinge"
    _: KW_ONLY
    calibrate: bool = True

    classes_: np.ndarray = field(init=False)
    sigmoid_: Sigmoid = field(init=False)

    def fit(self, X: Any, y: Any, sample_weight: ArrayLike | None = None) -> "CensoredSVC":
        """Fit to covariates and times, or to covariates and labels.

        Parameters
        ----------
        X
            One row per trajectory, shape (n, F), or n sets.
        y
            With `tau`: times and whether they were observed, as in `CensoredSVR.fit`, or plain times. Without: labels
            of two classes.
        sample_weight
            Number of rows that each row represents in the objective, ≥ 0. Ĝ is fitted to rows of positive weight, each
            counted once.

        Raises
        ------
        ArgumentError
            A parameter or a value is invalid; the message names the row.
        PositivityError
            All trajectories were cut, or a weight is not identified.
        """
        problem, held_out = self._fit(X, y, sample_weight)
        if self.calibrate:
            if held_out is None:
                folds = self._folds(np.flatnonzero(self.weights_), problem.y)
                held_out = hold_out(problem, np.array([self.reg_]), folds)[0][0]
            self.sigmoid_ = fit_sigmoid(held_out, problem.y, problem.mass)
        return self

    def decision_function(self, X: Any) -> Rows:
        """f(Z); a positive value predicts the second class."""
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
        """Weighted accuracy; the weights come from the scored rows."""
        predicted, ends = self.predict(X), self._ends(y)
        truth = column_or_1d(y) if ends is None else self._is_early(ends)
        _, weights, _ = self._weigh(self._checked_rows(X, False, y), sample_weight, ends, truth)
        return float(weights @ (truth == predicted) / weights.sum())

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.classifier_tags.multi_class = False
        return tags

    def _ends(self, y: Any) -> Ends | None:
        ends = as_ends(y)
        if ends is not None and self.tau is None:
            raise ArgumentError("y holds times and tau is None; give the tau that separates early from late, or labels")
        if ends is None and self.tau is not None:
            times = column_or_1d(y, dtype=np.float64)
            return Ends(times, np.ones(len(times), dtype=bool))
        return ends

    def _is_early(self, ends: Ends) -> RowMask:
        """T ≤ τ; a trajectory cut at τ had not finished by then."""
        after_s = ends.time - (np.inf if self.tau is None else self.tau)
        tolerance_s = clock_tolerance_s(ends.time)
        return (after_s < -tolerance_s) | ((after_s <= tolerance_s) & ends.is_finished)

    def _targets(self, y: Any, ends: Ends | None) -> Rows:
        """Name the classes; return ±1, with +1 for the second class."""
        labels = column_or_1d(y, warn=True) if ends is None else self._is_early(ends)
        if ends is None:
            check_classification_targets(labels)
        self.classes_ = np.unique(labels) if ends is None else np.array([False, True])
        if len(self.classes_) > 2:
            raise ArgumentError(
                f"Only binary classification is supported: y has {len(self.classes_)} classes; choose two, or "
                "use sklearn.multiclass.OneVsRestClassifier"
            )
        if len(self.classes_) < 2:
            raise ArgumentError(f"y holds only one class, {self.classes_.tolist()[0]!r}; give labels of two classes")
        return np.where(labels == self.classes_[1], 1.0, -1.0)

    def _check_seen(self, targets: Rows) -> None:
        """Refuse rows of positive weight that are all of one class."""
        seen = targets[self.weights_ > 0]
        if len(np.unique(seen)) < 2:
            raise ArgumentError(
                f"only one class, {self.classes_[int(seen[0] > 0)]!r}, was observed among {len(targets)} rows; "
                "both classes are needed"
            )
