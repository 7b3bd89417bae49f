"""The censored SVM behind scikit-learn's habits (paper, eqs. 1 and 2): regression, and classification.

Read down: rows and weights → the choice of λ and γ → one fit, with its certificate → f at new rows; then what each of
both predicts.
"""

import warnings
from dataclasses import KW_ONLY, dataclass, field
from functools import partial
from numbers import Real
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator, ClassifierMixin, RegressorMixin
from sklearn.utils.metaestimators import available_if
from sklearn.utils.multiclass import check_classification_targets
from sklearn.utils.validation import _check_sample_weight, check_is_fitted, column_or_1d, validate_data

from halfseen.arrays import RowIds, RowMask, Rows
from halfseen.censoring import CensoringModel, WeightDiagnostics, warn_if_few, weight_diagnostics
from halfseen.errors import ArgumentError, HalfseenWarning
from halfseen.learning.svm.cross_validation import Fold, Sigmoid, Task, choose, dealt, fit_sigmoid, hold_out
from halfseen.learning.svm.kernels import SetKernel, as_sets, candidate_gammas, checked_gram, named_kernel, scale_gamma
from halfseen.learning.svm.losses import CLASSIFICATION, REGRESSION, ProximalLoss, SmoothLoss, named_loss, own_loss
from halfseen.learning.svm.nystrom import fit_nystrom
from halfseen.learning.svm.solver import Solution, best_constant, solve
from halfseen.learning.svm.spaces import (
    Design,
    Function,
    GramDesign,
    check_gram_fits,
    linear_design,
    low_rank_design,
    refuse_dependent,
    root_design,
)
from halfseen.learning.svm.targets import Ends, as_ends, check_lengths, checked_tau, row_weights, target_values

REGS = np.logspace(-7, 0, 8)
"""The λ that ``reg="cv"`` chooses from, in units in which the target's scale does not matter (`_reg_unit`)."""


@dataclass(frozen=True)
class _Fitted:
    """What a fit leaves for the calibration."""

    task: Task
    design: Design
    seen: RowIds
    num_rows: float
    held_out: Rows | None
    """f of each row by cross-validation's fits, if there were any."""


@dataclass(eq=False, repr=False)
class CensoredSVM(BaseEstimator):
    """Base of `CensoredSVR` and `CensoredSVC`; the parameters are theirs."""

    loss: Any
    _: KW_ONLY
    kernel: Any = "rbf"
    gamma: Any = "scale"
    degree: int = 3
    coef0: float | int = 1.0
    reg: Any = "cv"
    fit_intercept: bool = True
    num_landmarks: int | None = None
    censoring: str | CensoringModel = "kaplan-meier"
    truncate_at: float | int | None = None
    tau: float | int | None = None
    cv: Any = 5
    tol: float = 1e-8
    random_state: Any = 0

    intercept_: float = field(init=False)
    reg_: float = field(init=False)
    gamma_: float = field(init=False)
    weights_: Rows = field(init=False)
    diagnostics_: WeightDiagnostics = field(init=False)
    censoring_: CensoringModel | None = field(init=False)
    objective_: float = field(init=False)
    duality_gap_: float = field(init=False)
    cv_gammas_: Float[np.ndarray, " G"] = field(init=False)
    cv_regs_: Float[np.ndarray, " L"] = field(init=False)
    cv_losses_: Float[np.ndarray, "G L"] = field(init=False)
    function_: Function = field(init=False)
    n_features_in_: int = field(init=False)

    def _checked_rows(self, X: Any, is_fit: bool) -> np.ndarray:
        if self.kernel == "set" or isinstance(self.kernel, SetKernel):
            return as_sets(X)
        rows: Any = validate_data(
            self, X, reset=is_fit, dtype=np.float64, ensure_all_finite=False, ensure_min_samples=int(is_fit)
        )
        wrong = np.argwhere(~np.isfinite(rows))
        if len(wrong):
            row, column = wrong[0]
            value = "NaN" if np.isnan(rows[row, column]) else "infinity (inf)"
            raise ArgumentError(f"X, row {row}, column {column} is {value}; fill it in or leave the row out knowingly")
        return rows

    def _checked_sample_weight(self, sample_weight: Any, rows: np.ndarray) -> Rows:
        if sample_weight is None:
            return np.ones(len(rows))
        numbers = np.zeros((len(rows), 1))
        return _check_sample_weight(sample_weight, numbers, dtype=np.float64, ensure_non_negative=True)

    def _fit_weights(self, ends: Ends | None, rows: np.ndarray, counts: Rows) -> None:
        """Weigh every row, and tell how much evidence that leaves."""
        self.weights_, self.censoring_ = row_weights(
            ends, rows, counts, self.censoring, checked_tau(self.tau), self.truncate_at
        )
        self.diagnostics_ = weight_diagnostics(self.weights_, self.truncate_at)
        if ends is not None:
            warn_if_few(self.diagnostics_, stacklevel=4)

    def _fit_function(self, rows: np.ndarray, y: Rows, counts: Rows) -> _Fitted:
        """Choose λ and γ, fit f to the rows of positive weight, and keep the certificate."""
        self._check_parameters()
        seen = np.flatnonzero(self.weights_)
        num_rows = float(counts.sum())
        if len(seen) == 0:
            raise ArgumentError("every sample_weight is 0; give some row weight")
        task = Task(y[seen], self.weights_[seen], self._checked_loss(y[seen]), bool(self.fit_intercept))
        kept = rows[seen]
        gammas = self._gammas(rows[counts > 0], counts[counts > 0])
        held_out = None
        if self.reg == "cv" or len(gammas) > 1:
            regs = REGS * _reg_unit(task) if self.reg == "cv" else np.array([float(self.reg)])
            design_of = partial(self._design, kept, task.weight)
            choice = choose(task, design_of, gammas, regs, self._folds(task, seen), num_rows, seen)
            self.gamma_, self.reg_ = choice.gamma, choice.reg
            self.cv_gammas_, self.cv_regs_, self.cv_losses_ = gammas, choice.regs, choice.losses
            held_out = choice.held_out
        else:
            self.gamma_, self.reg_ = float(gammas[0]), float(self.reg)
        design = self._design(kept, self.weights_[seen], self.gamma_)
        every = np.arange(len(kept))
        solution = solve(task.problem(design, every, num_rows, self.reg_), self.tol)
        self._keep(solution, design, every)
        return _Fitted(task, design, seen, num_rows, held_out)

    def _folds(self, task: Task, seen: RowIds) -> list[Fold]:
        classes = task.y if self._losses == CLASSIFICATION else None
        return dealt(self.cv, seen, len(self.weights_), np.random.default_rng(self.random_state), classes)

    def _design(self, kept: np.ndarray, weight: Rows, gamma: float) -> Design:
        kernel = named_kernel(self.kernel, gamma, self.degree, self.coef0)
        if self.num_landmarks is not None:
            rng = np.random.default_rng(self.random_state)
            return low_rank_design(fit_nystrom(kernel, kept, self.num_landmarks, rng, weight), kept)
        if self.kernel == "linear" and kept.shape[1] <= len(kept):
            if self.reg == 0:
                refuse_dependent(kept, bool(self.fit_intercept))
            return linear_design(kept)
        check_gram_fits(len(kept))
        design = GramDesign(kernel, kept, checked_gram(kernel, kept, kept))
        return root_design(design) if self.reg != "cv" and self.reg == 0 else design

    def _keep(self, solution: Solution, design: Design, rows: RowIds) -> None:
        self.function_ = design.function(solution.coefficients, rows)
        self.intercept_ = solution.offset
        self.objective_, self.duality_gap_ = solution.objective, solution.gap
        if not solution.relative_gap <= self.tol:
            warnings.warn(
                f"the duality gap is {solution.gap:.2g}, {solution.relative_gap:.1g} of the objective and above "
                f"tol={self.tol:g}, so f is near the optimum but not at it; raise reg from {self.reg_:.2g}, scale the "
                "columns of X alike, or accept it with a larger tol",
                HalfseenWarning,
                stacklevel=4,
            )

    def _values(self, X: Any) -> Rows:
        """Values of f at new rows."""
        check_is_fitted(self, "function_")
        return self.function_(self._checked_rows(X, is_fit=False)) + self.intercept_

    def _gammas(self, rows: np.ndarray, counts: Rows) -> Float[np.ndarray, " G"]:
        if self.gamma == "cv":
            return candidate_gammas(rows, counts)
        return np.array([scale_gamma(rows, counts) if self.gamma == "scale" else float(self.gamma)])

    def _checked_loss(self, y: Rows) -> SmoothLoss | ProximalLoss:
        if not isinstance(self.loss, str):
            return own_loss(self.loss, y)
        if self.loss not in self._losses:
            raise ArgumentError(
                f"loss is {self.loss!r}; {type(self).__name__} has {', '.join(self._losses)}, or takes one of your own"
            )
        return named_loss(self.loss, **self._loss_parameters)

    @property
    def _losses(self) -> tuple[str, ...]:
        raise NotImplementedError

    @property
    def _loss_parameters(self) -> dict[str, float | int]:
        """Parameters of the named losses."""
        return {}

    def _check_parameters(self) -> None:
        if self.reg != "cv" and not (_is_number(self.reg) and 0 <= self.reg < np.inf):
            raise ArgumentError(f"reg is {self.reg!r}; it is a λ ≥ 0, or 'cv'")
        if self.gamma not in ("scale", "cv") and not (_is_number(self.gamma) and 0 < self.gamma < np.inf):
            raise ArgumentError(
                f"gamma is {self.gamma!r}; a kernel's width is 1/√gamma, so give a number > 0, 'scale' or 'cv'"
            )
        if self.reg == 0 and self.fit_intercept and self.kernel != "linear" and self.num_landmarks is None:
            raise ArgumentError(
                "reg is 0, and with an intercept the kernel matrix determines no single function; give reg > 0, for "
                "example 1e-6, or fit_intercept=False"
            )
        if not 0 < self.tol < 1:
            raise ArgumentError(f"tol is {self.tol}; it is a share of the objective, in (0, 1)")


@dataclass(eq=False, repr=False)
class CensoredSVR(RegressorMixin, CensoredSVM):
    """Support vector regression of Y(T) on covariates, where some times T are right-censored [GoldbergKosorok2017]_.

    f = g + b minimises exactly

        λ‖g‖² + (1/n) Σ_i w_i L(Y(T_i), f(Z_i)),   w_i = δ_i / Ĝ(T_i⁻ | Z_i)

    over g in the kernel's space and, if `fit_intercept`, an unpenalised b (paper, eqs. 1 and 2). n counts all rows, the
    cut ones too; with sample weights s_i it is Σ s_i and w_i becomes s_i w_i. With `tau` the target is Y(min(T, τ)) and
    δ_i tells whether min(T_i, τ) was seen.

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
        Of the polynomial kernel.
    reg
        λ ≥ 0, or ``"cv"``: chosen by the weighted loss on held-out rows.
    fit_intercept
        Whether there is a b.
    num_landmarks
        None: the exact kernel, n × n numbers; a number: a low-rank kernel by that many landmarks, for large n.
    censoring
        ``"kaplan-meier"``, ``"cox"`` or ``"kernel"`` (both on X), ``"none"`` (rows that were seen count alike, which is
        biased), or a `CensoringModel`, which is fitted anew.
    truncate_at
        Largest 1/Ĝ allowed, if any.
    target
        Y: ``"identity"``, ``"log"``, or a function of an array of times.
    tau
        τ [s]: times are restricted to min(T, τ); None for all of the time.
    cv
        Number of folds, a scikit-learn splitter, or the splits.
    tol
        Relative duality gap asked for.
    random_state
        Seed of folds and landmarks.

    Attributes
    ----------
    intercept_ : float
        b.
    function_ : Function
        g.
    reg_, gamma_ : float
        λ and γ used.
    weights_ : Float[ndarray, "n"]
        w, 0 where cut.
    diagnostics_ : WeightDiagnostics
        Effective sample size, largest weight, proportion truncated.
    censoring_ : CensoringModel
        Ĝ; None where nothing could be cut.
    objective_, duality_gap_ : float
        The objective, and the certificate: the optimum lies at most `duality_gap_` below. A `HalfseenWarning` says so
        if that is more than `tol` of it.
    cv_gammas_, cv_regs_ : Float[ndarray, "G"], Float[ndarray, "L"]
        Every γ and every λ tried, if they were chosen.
    cv_losses_ : Float[ndarray, "G L"]
        Their weighted mean losses on held-out rows; ∞ where a fold had given up: its loss had risen a fifth above its
        least.

    Notes
    -----
    scikit-learn asks that a row of weight 2 do what the same row does twice. That holds where nothing is dealt into
    folds; with ``reg="cv"`` or ``gamma="cv"`` rows are dealt one by one, and a row that is there twice may be dealt
    to two folds.

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
            One row for each path, shape (n, F), or n sets.
        y
            Times and whether they were seen: a structured array as scikit-survival has it (`survival_array` makes one),
            a frame with ``is_finished`` and ``time`` or ``time_s`` [s], or a tuple (time, is_finished). A plain column
            of numbers is a target of which nothing was cut.
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
        ends = as_ends(y)
        values = self._targets(y, ends)
        check_lengths(rows, values)
        self._fit_weights(ends, rows, counts)
        self._fit_function(rows, values, counts)
        return self

    def predict(self, X: Any) -> Rows:
        """Estimate Y(T) by f(Z), in the target's unit: with ``target="log"``, logarithms of times.

        Parameters
        ----------
        X
            Rows asked about, shape (m, F), or m sets.
        """
        return self._values(X)

    def score(self, X: Any, y: Any, sample_weight: ArrayLike | None = None) -> float:
        """Proportion of the loss that f explains: 1 − Σ w L(Y, f) / Σ w L(Y, c), with c the best constant.

        With the squared loss that is R². The weights come from the same kind of censoring model, fitted to the rows
        that are scored.

        Raises
        ------
        ArgumentError
            Fewer than two rows were seen, or the targets do not differ, so that there is nothing to explain.
        """
        check_is_fitted(self, "function_")
        rows = self._checked_rows(X, is_fit=False)
        counts, ends = self._checked_sample_weight(sample_weight, rows), as_ends(y)
        values = self._targets(y, ends)
        check_lengths(rows, values)
        weights, _ = row_weights(ends, rows, counts, self.censoring, checked_tau(self.tau), self.truncate_at)
        seen = weights > 0
        loss = self._checked_loss(values)
        constant = best_constant(values[seen], weights[seen], loss)
        left = float(weights[seen] @ loss.value(values[seen], self._values(X)[seen]))
        most = float(weights[seen] @ loss.value(values[seen], np.full(seen.sum(), constant)))
        if most <= 0.0:
            raise ArgumentError(
                f"score has {int(seen.sum())} rows to look at, whose targets a constant fits; give more rows"
            )
        return 1.0 - left / most

    @property
    def _losses(self) -> tuple[str, ...]:
        return REGRESSION

    @property
    def _loss_parameters(self) -> dict[str, float | int]:
        return {"epsilon": self.epsilon, "quantile": self.quantile, "delta": self.delta}

    def _targets(self, y: Any, ends: Ends | None) -> Rows:
        """Y of every row; what was cut gets a value that no weight will touch."""
        time = column_or_1d(y, dtype=np.float64, warn=True) if ends is None else ends.time
        tau = checked_tau(self.tau)
        return target_values(time if tau is None else np.minimum(time, tau), self.target)


def _gives_probabilities(estimator: "CensoredSVC") -> bool:
    if not estimator.calibrate:
        raise AttributeError("predict_proba needs calibrate=True")
    return True


@dataclass(eq=False, repr=False)
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

    def _fit_sigmoid(self, fitted: _Fitted) -> None:
        held_out = fitted.held_out
        if held_out is None:
            folds = self._folds(fitted.task, fitted.seen)
            held_out = hold_out(fitted.task, fitted.design, self.reg_, folds, fitted.num_rows, fitted.seen)
        self.sigmoid_ = fit_sigmoid(held_out, fitted.task.y, fitted.task.weight)


def _reg_unit(task: Task) -> float:
    """The loss that the best constant leaves, over the targets' variance: λ in this unit knows no unit of y."""
    share = task.weight / task.weight.sum()
    mean = float(share @ task.y)
    variance = float(share @ np.square(task.y - mean))
    left = float(share @ task.loss.value(task.y, np.full_like(task.y, mean)))
    return left / variance if variance > 0.0 and left > 0.0 else 1.0


def _is_number(value: Any) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)
