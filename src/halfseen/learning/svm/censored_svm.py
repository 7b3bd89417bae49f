"""What the censored SVM's regressor and classifier share: weights, kernel, λ and certificate (paper, eqs. 1 and 2).

Read down: rows and weights → the choice of λ and γ → one fit, with its certificate → f at new rows.
"""

import warnings
from dataclasses import dataclass
from functools import partial
from numbers import Real
from typing import Any

import numpy as np
from jaxtyping import Float
from sklearn.base import BaseEstimator
from sklearn.utils.validation import _check_sample_weight, check_is_fitted, validate_data

from halfseen.arrays import RowIds, Rows
from halfseen.censoring import CensoringModel, WeightDiagnostics, warn_if_few, weight_diagnostics
from halfseen.errors import ArgumentError, HalfseenWarning
from halfseen.learning.svm.cross_validation import Fold, Task, choose
from halfseen.learning.svm.designs import (
    Design,
    Function,
    GramDesign,
    LinearDesign,
    LowRankDesign,
    RootDesign,
    refuse_dependent,
)
from halfseen.learning.svm.folds import dealt
from halfseen.learning.svm.kernels import candidate_gammas, checked_gram, named_kernel, scale_gamma
from halfseen.learning.svm.losses import CLASSIFICATION, ProximalLoss, SmoothLoss, named_loss
from halfseen.learning.svm.memory import check_gram_fits
from halfseen.learning.svm.nystrom import fit_nystrom
from halfseen.learning.svm.set_kernel import SetKernel, as_sets
from halfseen.learning.svm.solver import Solution, solve
from halfseen.learning.svm.targets import Ends, checked_tau
from halfseen.learning.svm.user_loss import own_loss
from halfseen.learning.svm.weighting import row_weights

REGS = np.logspace(-7, 0, 8)
"""The λ that ``reg="cv"`` chooses from, in units in which the target's scale does not matter (`_reg_unit`)."""


@dataclass(frozen=True)
class Fitted:
    """What a fit leaves for the calibration."""

    task: Task
    design: Design
    seen: RowIds
    num_rows: float
    held_out: Rows | None
    """f of each row by cross-validation's fits, if there were any."""


class CensoredSVM(BaseEstimator):
    """Base of `CensoredSVR` and `CensoredSVC`; the parameters are theirs."""

    intercept_: float
    reg_: float
    gamma_: float
    weights_: Rows
    diagnostics_: WeightDiagnostics
    censoring_: CensoringModel | None
    objective_: float
    duality_gap_: float
    cv_gammas_: Float[np.ndarray, " G"]
    cv_regs_: Float[np.ndarray, " L"]
    cv_losses_: Float[np.ndarray, "G L"]
    function_: Function
    n_features_in_: int

    loss: Any
    kernel: Any
    gamma: Any
    degree: int
    coef0: float
    reg: Any
    fit_intercept: bool
    num_landmarks: int | None
    censoring: Any
    truncate_at: float | None
    tau: float | None
    cv: Any
    tol: float
    random_state: int

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

    def _fit_function(self, rows: np.ndarray, y: Rows, counts: Rows) -> "Fitted":
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
        return Fitted(task, design, seen, num_rows, held_out)

    def _folds(self, task: Task, seen: RowIds) -> list[Fold]:
        classes = task.y if self._losses == CLASSIFICATION else None
        return dealt(self.cv, seen, len(self.weights_), np.random.default_rng(self.random_state), classes)

    def _design(self, kept: np.ndarray, weight: Rows, gamma: float) -> Design:
        kernel = named_kernel(self.kernel, gamma, self.degree, self.coef0)
        if self.num_landmarks is not None:
            rng = np.random.default_rng(self.random_state)
            nystrom = fit_nystrom(kernel, kept, self.num_landmarks, rng, weight)
            return LowRankDesign(nystrom.transform(kept), nystrom)
        if self.kernel == "linear" and kept.shape[1] <= len(kept):
            if self.reg == 0:
                refuse_dependent(kept, bool(self.fit_intercept))
            return LinearDesign(kept)
        check_gram_fits(len(kept))
        design = GramDesign(kernel, kept, checked_gram(kernel, kept, kept))
        return RootDesign.of(design) if self.reg != "cv" and self.reg == 0 else design

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


def _reg_unit(task: Task) -> float:
    """The loss that the best constant leaves, over the targets' variance: λ in this unit knows no unit of y."""
    share = task.weight / task.weight.sum()
    mean = float(share @ task.y)
    variance = float(share @ np.square(task.y - mean))
    left = float(share @ task.loss.value(task.y, np.full_like(task.y, mean)))
    return left / variance if variance > 0.0 and left > 0.0 else 1.0


def _is_number(value: Any) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)
