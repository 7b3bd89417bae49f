"""The common base of both estimators: weighted rows → the choice of λ and γ → one fit, with its certificate."""

import warnings
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import psutil
from sklearn.base import BaseEstimator
from sklearn.utils.validation import _check_sample_weight, check_is_fitted, validate_data

from halfseen.arrays import RowIds, Rows
from halfseen.censoring import CensoringModel, WeightDiagnostics, warn_if_few, weight_diagnostics
from halfseen.censoring.inputs import refuse_other_order
from halfseen.errors import ArgumentError, HalfseenWarning
from halfseen.estimator import check_generator, is_number
from halfseen.learning.svm.kernels import SetKernel, all_objects, as_sets, checked_gram, named_kernel, scale_gamma
from halfseen.learning.svm.losses import CLASSIFICATION, Loss, named_loss, own_loss
from halfseen.learning.svm.newton import Coefficients, Features, Gram, Space
from halfseen.learning.svm.nystrom import Nystrom, fit_nystrom, inverse_root
from halfseen.learning.svm.rows import Ends, Fold, as_ends, folds_of_seen, hold_out, row_weights
from halfseen.learning.svm.solver import Problem, solve
from halfseen.progress import Progress
from halfseen.shapes import Float

REGS = np.logspace(0, -7, 8)
"""The λ that ``reg="cv"`` chooses from, in units that make the target's scale irrelevant (`_reg_unit`)."""

WIDTHS = 4.0 ** np.arange(-2, 3)
"""The γ that ``gamma="cv"`` chooses from, in units of `scale_gamma`."""

MOST_LANDMARKS_ADVISED = 1000
"""More landmarks rarely change a fit, and their cost grows quadratically."""

CONTAINER_LIMIT = Path("/sys/fs/cgroup/memory.max")
"""The container's memory limit; other interfaces report the memory of the whole machine."""


@dataclass(eq=False, repr=False)
class CensoredSVM(BaseEstimator):
    """Base of `CensoredSVR` and `CensoredSVC`, which document the parameters."""

    _losses: ClassVar[tuple[str, ...]]
    _loss_parameters: ClassVar[tuple[str, ...]] = ()

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
    function_: Nystrom = field(init=False)
    n_features_in_: int = field(init=False)

    def _check_parameters(self) -> None:
        if self.reg != "cv" and not (is_number(self.reg) and self.reg >= 0):
            raise ArgumentError(f"reg is {self.reg!r}; give a λ ≥ 0, or 'cv'")
        if self.gamma not in ("scale", "cv") and not (is_number(self.gamma) and self.gamma > 0):
            raise ArgumentError(
                f"gamma is {self.gamma!r}; a kernel's width is 1/√gamma, so give a number > 0, 'scale' or 'cv'"
            )
        if self.reg == 0 and self.fit_intercept and self.kernel != "linear" and self.num_landmarks is None:
            raise ArgumentError(
                "reg is 0, so the solution with an intercept is not unique; give reg > 0, for example 1e-6, or "
                "fit_intercept=False"
            )
        if self.tau is not None and not (is_number(self.tau) and self.tau > 0.0):
            raise ArgumentError(f"tau is {self.tau!r}; give a time > 0 s, or None for times that are not restricted")
        if not (is_number(self.tol) and 0 < self.tol < 1):
            raise ArgumentError(f"tol is {self.tol!r}; give a share of the objective, in (0, 1)")
        check_generator(self.random_state)

    def _checked_rows(self, X: Any, is_fit: bool, y: Any = None) -> np.ndarray:
        refuse_other_order(X=X, y=y[0] if isinstance(y, tuple) and y else y)
        if self.kernel == "set" or isinstance(self.kernel, SetKernel):
            return as_sets(X)
        rows: Any = validate_data(
            self, X, reset=is_fit, dtype=np.float64, ensure_all_finite=False, ensure_min_samples=int(is_fit)
        )
        wrong = np.argwhere(~np.isfinite(rows))
        if len(wrong):
            row, column = wrong[0]
            value = "NaN" if np.isnan(rows[row, column]) else "infinity (inf)"
            raise ArgumentError(f"X, row {row}, column {column} is {value}; fill it in or leave the row out")
        return rows

    def _ends(self, y: Any) -> Ends | None:
        """Observed ends, if y holds times that may be cut."""
        return as_ends(y)

    def _targets(self, y: Any, ends: Ends | None) -> Rows:
        """Target of every row."""
        raise NotImplementedError

    def _check_seen(self, targets: Rows) -> None:
        """Refuse observed rows that do not determine a fit."""

    def _weigh(
        self, rows: np.ndarray, sample_weight: Any, ends: Ends | None, targets: np.ndarray
    ) -> tuple[Rows, Rows, CensoringModel | None]:
        """Number of rows that each row represents, its weight, and the censoring model of the weights."""
        numbers = np.zeros((len(rows), 1))
        counts = _check_sample_weight(sample_weight, numbers, dtype=np.float64, ensure_non_negative=True)
        if len(rows) != len(targets):
            raise ArgumentError(f"X has {len(rows)} rows and y has {len(targets)}; give one target a row")
        return counts, *row_weights(ends, rows, counts, self.censoring, self.tau, self.truncate_at)

    def _fit(self, X: Any, y: Any, sample_weight: Any) -> tuple[Problem, Float[np.ndarray, " seen"] | None]:
        """Weigh every row, report the effective sample size, and fit f to the rows of positive weight.

        Returns
        -------
        tuple
            As returned by `_fit_function`.
        """
        self._check_parameters()
        refuse_other_order(X=X, sample_weight=sample_weight)
        rows, ends = self._checked_rows(X, True, y), self._ends(y)
        targets = self._targets(y, ends)
        counts, self.weights_, self.censoring_ = self._weigh(rows, sample_weight, ends, targets)
        self.diagnostics_ = weight_diagnostics(self.weights_, self.truncate_at)
        if ends is not None:
            warn_if_few(self.diagnostics_, stacklevel=4)
        if not self.weights_.any():
            raise ArgumentError("every sample_weight is 0; give some row weight")
        self._check_seen(targets)
        return self._fit_function(rows, targets, counts)

    def _fit_function(
        self, rows: np.ndarray, y: Rows, counts: Rows
    ) -> tuple[Problem, Float[np.ndarray, " seen"] | None]:
        """Choose λ and γ, fit f to the rows of positive weight, and keep the certificate.

        Returns
        -------
        tuple
            The problem that was solved, and f of its rows by the fits of cross-validation, if there were any.
        """
        seen = np.flatnonzero(self.weights_)
        kept, y, mass = rows[seen], y[seen], self.weights_[seen] / counts.sum()
        loss, has_offset = self._checked_loss(y), bool(self.fit_intercept)

        def prepared(gamma: float) -> tuple[Problem, Callable[[Coefficients], Nystrom]]:
            space, function_of = self._space(kept, gamma)
            return Problem(space, y, mass, loss, float(self.reg_), has_offset), function_of

        gammas = self._gammas(rows[counts > 0], counts[counts > 0])
        regs = REGS * _reg_unit(y, mass, loss) if self.reg == "cv" else np.array([float(self.reg)])
        self.gamma_, self.reg_, held_out = float(gammas[0]), float(regs[0]), None
        if len(gammas) * len(regs) > 1:
            held_out = self._choose(lambda gamma: prepared(gamma)[0], gammas, regs, self._folds(seen, y))
        problem, function_of = prepared(self.gamma_)
        found = solve(problem, self.tol)
        self.function_, self.intercept_ = function_of(found.coefficients), found.offset
        self.objective_, self.duality_gap_ = found.objective, found.gap
        if not found.relative_gap <= self.tol:
            warnings.warn(
                f"the duality gap is {found.gap:.2g}, {found.relative_gap:.1g} of the objective and above "
                f"tol={self.tol:g}, so f is near the optimum but not at it; raise reg from {self.reg_:.2g}, scale the "
                "columns of X alike, or accept it with a larger tol",
                HalfseenWarning,
                stacklevel=4,
            )
        return problem, held_out

    def _choose(
        self,
        problem_of: Callable[[float], Problem],
        gammas: Float[np.ndarray, " G"],
        regs: Float[np.ndarray, " L"],
        folds: list[Fold],
    ) -> Rows:
        """Try every γ and λ, the largest λ first; return the first with the smallest loss, and its held-out f."""
        self.cv_gammas_, self.cv_regs_, self.cv_losses_ = gammas, regs, np.full((len(gammas), len(regs)), np.inf)
        held_out, least = np.zeros(0), np.inf
        with Progress(len(gammas) * len(folds), "cross-validation", "folds") as bar:
            for g, gamma in enumerate(gammas):
                values, self.cv_losses_[g] = hold_out(problem_of(gamma), regs, folds, bar)
                k = int(np.argmin(self.cv_losses_[g]))
                if g == 0 or self.cv_losses_[g, k] < least:
                    held_out, least = values[k], self.cv_losses_[g, k]
                    self.gamma_, self.reg_ = float(gamma), float(regs[k])
        return held_out

    def _folds(self, seen: RowIds, y: Rows) -> list[Fold]:
        return folds_of_seen(
            self.cv, seen, len(self.weights_), self.random_state, y if self._losses == CLASSIFICATION else None
        )

    def _gammas(self, rows: np.ndarray, counts: Rows) -> Float[np.ndarray, " G"]:
        if self.gamma not in ("scale", "cv"):
            return np.array([float(self.gamma)])
        scale = scale_gamma(all_objects(rows)) if rows.dtype == object else scale_gamma(rows, counts)
        return scale * WIDTHS if self.gamma == "cv" else np.array([scale])

    def _space(self, kept: np.ndarray, gamma: float) -> tuple[Space, Callable[[Coefficients], Nystrom]]:
        """Rows in the form for the solver, and the constructor of a function from its coefficients."""
        is_set = self.kernel == "set"
        kernel = SetKernel("rbf", gamma) if is_set else named_kernel(self.kernel, gamma, self.degree, self.coef0)
        if self.num_landmarks is not None:
            low_rank = fit_nystrom(kernel, kept, self.num_landmarks, np.random.default_rng(self.random_state))
        elif self.kernel == "linear" and kept.shape[1] <= len(kept):
            if self.reg == 0:
                _refuse_dependent(kept, bool(self.fit_intercept))
            unit = np.eye(kept.shape[1])
            low_rank = Nystrom(kernel, unit, unit)
        else:
            check_gram_fits(len(kept))
            gram = checked_gram(kernel, kept, kept)
            if self.reg != 0:
                return Gram(gram), lambda alpha: Nystrom(kernel, kept[alpha != 0.0], alpha[alpha != 0.0])
            low_rank = Nystrom(kernel, kept, inverse_root(gram))
            if low_rank.projection.shape[1] < len(kept):
                raise ArgumentError(
                    f"reg is 0 and the kernel matrix of {len(kept)} rows is singular, so the solution is not "
                    "unique; give reg > 0, for example 1e-6"
                )
        return Features(low_rank.transform(kept)), low_rank.function

    def _checked_loss(self, y: Rows) -> Loss:
        if not isinstance(self.loss, str):
            return own_loss(self.loss, y)
        if self.loss not in self._losses:
            raise ArgumentError(
                f"loss is {self.loss!r}; {type(self).__name__} has {', '.join(self._losses)}, or takes one of your own"
            )
        return named_loss(self.loss, **{name: getattr(self, name) for name in self._loss_parameters})

    def _values(self, X: Any) -> Rows:
        """Values of f at new rows."""
        check_is_fitted(self, "function_")
        return self.function_.transform(self._checked_rows(X, is_fit=False)) + self.intercept_


def _reg_unit(y: Rows, weight: Rows, loss: Loss) -> float:
    """Loss of the best constant divided by the variance of the targets; λ in this unit does not depend on that of y."""
    share = weight / weight.sum()
    mean = float(share @ y)
    variance, left = float(share @ np.square(y - mean)), float(share @ loss.value(y, np.full_like(y, mean)))
    return left / variance if variance > 0.0 and left > 0.0 else 1.0


def _refuse_dependent(rows: Float[np.ndarray, "n F"], has_offset: bool) -> None:
    """Refuse linearly dependent columns, for which λ = 0 has no unique solution."""
    columns = np.column_stack([rows, np.ones(len(rows))]) if has_offset else rows
    lengths = np.linalg.norm(columns, axis=0)
    rank = int(np.linalg.matrix_rank(columns / np.where(lengths > 0.0, lengths, 1.0)))
    if rank < columns.shape[1]:
        raise ArgumentError(
            f"reg is 0 and the {columns.shape[1]} columns of "
            f"X{', the intercept counted,' if has_offset else ''} have rank {rank}, so the solution is not "
            "unique; leave columns out, or give reg > 0, for example 1e-6"
        )


def check_gram_fits(num_rows: int, available_bytes: int | None = None) -> None:
    """Refuse n × n matrices, three of which are held at once, that do not fit in the free memory [B].

    The message says how many landmarks would fit.
    """
    free = free_bytes() if available_bytes is None else available_bytes
    needed = 3 * 8 * num_rows**2
    if needed <= free:
        return
    landmarks = advised_landmarks(num_rows, free)
    low_rank = f"num_landmarks={landmarks} (a low-rank kernel, {8e-9 * num_rows * landmarks:.3g} GB), or "
    raise ArgumentError(
        f"the kernel matrix of {num_rows:,} rows takes {1e-9 * needed:.3g} GB and {1e-9 * free:.3g} GB are free; "
        f"give {low_rank if landmarks else ''}kernel='linear'"
    )


def advised_landmarks(num_rows: int, available_bytes: int) -> int:
    """Landmarks whose features take at most half of the memory [B], rounded to one digit and zeros; 0 if none fits."""
    most = min(MOST_LANDMARKS_ADVISED, num_rows, available_bytes // (2 * 8 * max(num_rows, 1)))
    unit = 10 ** (len(str(most)) - 1)
    return int(most // unit * unit)


def free_bytes() -> int:
    """Memory available without swapping [B], by the machine and by the container's limit."""
    available = psutil.virtual_memory().available
    limit = CONTAINER_LIMIT.read_text().strip() if CONTAINER_LIMIT.exists() else "max"
    return available if limit == "max" else min(available, int(limit))
