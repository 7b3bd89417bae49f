"""Regression on targets of right-censored times."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import RegressorMixin
from sklearn.utils.validation import check_is_fitted, column_or_1d

from halfseen.arrays import Rows
from halfseen.censoring import CensoringModel
from halfseen.errors import ArgumentError
from halfseen.learning.svm.censored_svm import CensoredSVM
from halfseen.learning.svm.losses import REGRESSION
from halfseen.learning.svm.solver import best_constant
from halfseen.learning.svm.targets import Ends, as_ends, checked_tau, target_values
from halfseen.learning.svm.weighting import check_lengths, row_weights


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

    def __init__(
        self,
        loss: Any = "epsilon-insensitive",
        *,
        epsilon: float | int = 0.1,
        quantile: float | int = 0.5,
        delta: float | int = 1.0,
        kernel: Any = "rbf",
        gamma: Any = "scale",
        degree: int = 3,
        coef0: float | int = 1.0,
        reg: Any = "cv",
        fit_intercept: bool = True,
        num_landmarks: int | None = None,
        censoring: str | CensoringModel = "kaplan-meier",
        truncate_at: float | int | None = None,
        target: str | Callable[[Rows], Any] = "identity",
        tau: float | int | None = None,
        cv: Any = 5,
        tol: float = 1e-8,
        random_state: Any = 0,
    ) -> None:
        self.loss = loss
        self.epsilon = epsilon
        self.quantile = quantile
        self.delta = delta
        self.kernel = kernel
        self.gamma = gamma
        self.degree = degree
        self.coef0 = coef0
        self.reg = reg
        self.fit_intercept = fit_intercept
        self.num_landmarks = num_landmarks
        self.censoring = censoring
        self.truncate_at = truncate_at
        self.target = target
        self.tau = tau
        self.cv = cv
        self.tol = tol
        self.random_state = random_state

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
