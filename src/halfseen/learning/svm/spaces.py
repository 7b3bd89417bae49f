"""How the solver sees rows: by a Gram matrix, f = K α + b, or by features, f = Φ θ + b.

A *design* holds what was computed once from all rows, so that cross-validation only takes parts of it: `GramDesign`, or
`FeatureDesign` (columns of the rows themselves, low-rank features, a root of the Gram matrix). The *space* of some rows
answers the solver's questions: the values of g, its squared norm, and the Newton step of λ‖g‖² + Σ φ_i(g_i + b), where
φ has the derivatives −p and the second derivatives D on the rows.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import psutil
import scipy.linalg
from jaxtyping import Bool, Float, Int

from halfseen.arrays import RowIds, Rows
from halfseen.errors import ArgumentError
from halfseen.learning.svm.kernels import Kernel, row_blocks
from halfseen.learning.svm.nystrom import Nystrom

Coefficients = Float[np.ndarray, " c"]

MOST_LANDMARKS_ADVISED = 1000
"""More landmarks rarely change a fit, and their cost grows with the square."""

CONTAINER_LIMIT = Path("/sys/fs/cgroup/memory.max")

_BYTES_A_NUMBER = 8
_PREDICTED_AT_ONCE = 2**22
_FEATURES_AT_ONCE = 2**22
_SINGULAR = 1e-12
_NO_CURVATURE = 1e-12
_JITTER = 1e-13


@dataclass(frozen=True)
class GramSpace:
    """g = Σ_i α_i k(z_i, ·), λ > 0; K need not be of full rank.

    The optimality condition 2 λ α = p is kept in this form, without a factor K. Rows without curvature are solved at
    once, α_i = p_i / 2λ; the others, A, solve (K_AA + 2 λ D_A⁻¹) Δα_A + Δb = …, whose matrix is as large as A only.
    """

    gram: Float[np.ndarray, "n n"]

    @property
    def num_coefficients(self) -> int:
        return len(self.gram)

    def values(self, coefficients: Coefficients) -> Rows:
        """Values of g on the rows."""
        return self.gram @ coefficients

    def inner(self, coefficients: Coefficients, others: Coefficients, other_values: Rows) -> float:
        """⟨g, g'⟩ in H, where `other_values` are the values of g'."""
        return float(coefficients @ other_values)

    def of_pull(self, pull: Rows, reg: float) -> Coefficients:
        """Coefficients of the g with 2 λ g = Σ_i pull_i k(z_i, ·); 0 where λ = 0."""
        return pull / (2.0 * reg)

    def unpenalised(self, reg: float) -> Float[np.ndarray, "n k"]:
        """Columns of f that cost nothing, the offset's apart: all if λ = 0, else none."""
        return np.zeros((len(self.gram), 0))

    def newton_step(
        self, coefficients: Coefficients, pull: Rows, curvature: Rows, reg: float, has_offset: bool
    ) -> tuple[Coefficients, float]:
        """Step of the coefficients and of the offset."""
        is_curved = _is_curved(curvature)
        step = pull / (2.0 * reg) - coefficients
        curved = np.flatnonzero(is_curved)
        if len(curved) == 0:
            return step, 0.0
        ridge = 2.0 * reg / curvature[curved]
        rest = np.where(is_curved, 0.0, step)
        wanted = ridge * step[curved]
        if len(curved) < len(self.gram):
            wanted = wanted - (self.gram @ rest)[curved]
        system = self.gram[np.ix_(curved, curved)]
        system[np.diag_indices_from(system)] += ridge
        right = np.column_stack([wanted, np.ones(len(curved))])[:, : 1 + has_offset]
        solved = scipy.linalg.cho_solve(factored(system), right, check_finite=False)
        offset = 0.0
        step[curved] = solved[:, 0]
        if has_offset:
            # Σ α = 0 is the optimality condition of the offset.
            missing = -coefficients.sum() - rest.sum()
            offset = float((solved[:, 0].sum() - missing) / solved[:, 1].sum())
            step[curved] -= offset * solved[:, 1]
        return step, offset


@dataclass(frozen=True)
class FeatureSpace:
    """g = Φ θ, ‖g‖² = θᵀθ; its methods are those of `GramSpace`."""

    features: Float[np.ndarray, "n c"]

    @property
    def num_coefficients(self) -> int:
        return self.features.shape[1]

    def values(self, coefficients: Coefficients) -> Rows:
        return self.features @ coefficients

    def inner(self, coefficients: Coefficients, others: Coefficients, other_values: Rows) -> float:
        return float(coefficients @ others)

    def of_pull(self, pull: Rows, reg: float) -> Coefficients:
        return self.features.T @ pull / (2.0 * reg) if reg > 0.0 else np.zeros(self.num_coefficients)

    def unpenalised(self, reg: float) -> Float[np.ndarray, "n k"]:
        return self.features[:, : 0 if reg > 0.0 else None]

    def newton_step(
        self, coefficients: Coefficients, pull: Rows, curvature: Rows, reg: float, has_offset: bool
    ) -> tuple[Coefficients, float]:
        size = self.num_coefficients
        system, gradient = np.zeros((size + 1, size + 1)), np.zeros(size + 1)
        curved = np.flatnonzero(_is_curved(curvature))
        for rows in np.array_split(curved, 1 + len(curved) * size // _FEATURES_AT_ONCE):
            weighted = self.features[rows] * np.sqrt(curvature[rows])[:, None]
            system[:size, :size] += weighted.T @ weighted
            system[:size, size] += weighted.T @ np.sqrt(curvature[rows])
        system[size, :size] = system[:size, size]
        system[size, size] = curvature.sum()
        gradient[:size] = self.features.T @ pull - 2.0 * reg * coefficients
        gradient[size] = pull.sum()
        system[np.arange(size), np.arange(size)] += 2.0 * reg
        used = size + (has_offset and system[size, size] > 0.0)
        step = np.zeros(size + 1)
        if system[:used, :used].diagonal().max(initial=0.0) > 0.0:
            step[:used] = scipy.linalg.cho_solve(factored(system[:used, :used]), gradient[:used], check_finite=False)
        return step[:size], float(step[size])


Space: TypeAlias = GramSpace | FeatureSpace


def _is_curved(curvature: Rows) -> Bool[np.ndarray, " n"]:
    return curvature > _NO_CURVATURE * curvature.max(initial=0.0)


def factored(system: Float[np.ndarray, "k k"]) -> tuple[Float[np.ndarray, "k k"], bool]:
    """Factor a positive semidefinite system, which is changed, for `scipy.linalg.cho_solve`.

    A direction that it does not see gets as much curvature as rounding has.
    """
    jitter = _JITTER * system.diagonal().max(initial=0.0)
    while True:
        try:
            return scipy.linalg.cho_factor(system, lower=True, check_finite=False)
        except np.linalg.LinAlgError:
            system[np.diag_indices_from(system)] += jitter
            jitter *= 100.0


@dataclass(frozen=True)
class Function:
    """A fitted g, without its offset: features of new rows times coefficients."""

    features: Callable[[Any], Float[np.ndarray, "m c"]]
    coefficients: Coefficients

    def __call__(self, rows: Any) -> Rows:
        g = np.zeros(len(rows))
        for some in row_blocks(len(rows), len(self.coefficients), _PREDICTED_AT_ONCE):
            g[some] = self.features(rows[some]) @ self.coefficients
        return g


def _to_support(kernel: Kernel, support: Any, rows: Any) -> Float[np.ndarray, "m c"]:
    return kernel(rows, support)


@dataclass(frozen=True)
class GramDesign:
    """Rows by the values of the kernel between them."""

    kernel: Kernel
    rows: Any
    gram: Float[np.ndarray, "n n"]

    def space(self, rows: RowIds) -> GramSpace:
        """The space that these rows span."""
        return GramSpace(self._part(rows, rows))

    def values(self, coefficients: Coefficients, rows: RowIds, at: Int[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """At the rows `at`, g whose coefficients were fitted to `rows`."""
        return self._part(at, rows) @ coefficients

    def function(self, coefficients: Coefficients, rows: RowIds) -> Function:
        """The g whose coefficients were fitted to `rows`; those that it leans on are kept."""
        support = np.flatnonzero(coefficients)
        return Function(partial(_to_support, self.kernel, self.rows[rows[support]]), coefficients[support])

    def _part(self, rows: Int[np.ndarray, " r"], columns: Int[np.ndarray, " c"]) -> Float[np.ndarray, "r c"]:
        is_whole = len(rows) == len(columns) == len(self.gram) and (rows == columns).all()
        return self.gram if is_whole and (rows == np.arange(len(rows))).all() else self.gram[np.ix_(rows, columns)]


@dataclass(frozen=True)
class FeatureDesign:
    """Rows by features, where g is a function of its coefficients alone."""

    features: Float[np.ndarray, "n c"]
    of_coefficients: Callable[[Coefficients], Function]

    def space(self, rows: RowIds) -> FeatureSpace:
        # Low-rank features of a large log are not copied for nothing.
        return FeatureSpace(self.features if len(rows) == len(self.features) else self.features[rows])

    def values(self, coefficients: Coefficients, rows: RowIds, at: Int[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        return self.features[at] @ coefficients

    def function(self, coefficients: Coefficients, rows: RowIds) -> Function:
        return self.of_coefficients(coefficients)


Design: TypeAlias = GramDesign | FeatureDesign


def linear_design(rows: Float[np.ndarray, "n c"]) -> FeatureDesign:
    """Rows by themselves: the linear kernel, and where there are more rows than columns the faster way to it."""
    return FeatureDesign(rows, partial(Function, np.asarray))


def low_rank_design(nystrom: Nystrom, rows: Any) -> FeatureDesign:
    """Rows by low-rank features of the kernel."""
    return FeatureDesign(nystrom.transform(rows), partial(Function, nystrom.transform))


def root_design(design: GramDesign) -> FeatureDesign:
    """Rows by a square root of their Gram matrix, K = Φ Φᵀ, for λ = 0, where K must be of full rank.

    Raises
    ------
    ArgumentError
        It is singular.
    """
    try:
        root = scipy.linalg.cholesky(design.gram, lower=True)
    except np.linalg.LinAlgError:
        root = np.zeros_like(design.gram)
    diagonal = np.square(np.diagonal(root))
    if diagonal.min() <= _SINGULAR * diagonal.max():
        raise ArgumentError(
            f"reg is 0 and the kernel matrix of {len(root)} rows is singular, so that many functions fit alike; "
            "give reg > 0, for example 1e-6"
        )
    support = partial(_to_support, design.kernel, design.rows)
    # Φ θ = K α.
    return FeatureDesign(root, lambda theta: Function(support, scipy.linalg.solve_triangular(root.T, theta)))


def refuse_dependent(features: Float[np.ndarray, "n c"], has_offset: bool) -> None:
    """Refuse columns that are combinations of one another, where λ = 0 would leave many functions alike.

    Raises
    ------
    ArgumentError
        The columns, with that of the intercept, are not of full rank.
    """
    columns = np.column_stack([features, np.ones(len(features))]) if has_offset else features
    lengths = np.linalg.norm(columns, axis=0)
    rank = int(np.linalg.matrix_rank(columns / np.where(lengths > 0.0, lengths, 1.0)))
    if rank < columns.shape[1]:
        raise ArgumentError(
            f"reg is 0 and the {columns.shape[1]} columns of X{', the intercept counted,' if has_offset else ''} have "
            f"rank {rank}, so that many functions fit alike; leave columns out, or give reg > 0, for example 1e-6"
        )


def check_gram_fits(num_rows: int, num_buffers: int = 3, available_bytes: int | None = None) -> None:
    """Refuse n × n matrices that would not fit in the free memory.

    Parameters
    ----------
    num_rows
        n.
    num_buffers
        Matrices of n × n that are held at once: the Gram matrix, and what the solver needs on top.
    available_bytes
        Free memory [B]; None asks the machine.

    Raises
    ------
    ArgumentError
        They don't fit; the message says how many landmarks would.
    """
    free = free_bytes() if available_bytes is None else available_bytes
    needed = _BYTES_A_NUMBER * num_buffers * num_rows**2
    if needed <= free:
        return
    landmarks = advised_landmarks(num_rows, free)
    low_rank = f"num_landmarks={landmarks} (a low-rank kernel, {_size(_BYTES_A_NUMBER * num_rows * landmarks)}), or "
    raise ArgumentError(
        f"the kernel matrix of {num_rows:,} rows takes {_size(needed)} and {_size(free)} are free; "
        f"give {low_rank if landmarks else ''}kernel='linear'"
    )


def advised_landmarks(num_rows: int, available_bytes: int) -> int:
    """Landmarks whose features take at most half of the memory [B], one digit and zeros; 0 where none fits."""
    most = min(MOST_LANDMARKS_ADVISED, num_rows, available_bytes // (2 * _BYTES_A_NUMBER * max(num_rows, 1)))
    unit = 10 ** (len(str(most)) - 1)
    return int(most // unit * unit)


def free_bytes() -> int:
    """Memory that can be taken without swapping [B], by the machine and by the container's limit."""
    available = psutil.virtual_memory().available
    # Inside a container, the machine's memory is told, not the container's.
    limit = CONTAINER_LIMIT.read_text().strip() if CONTAINER_LIMIT.exists() else "max"
    return available if limit == "max" else min(available, int(limit))


def _size(num_bytes: int) -> str:
    for unit, size in (("GB", 1e9), ("MB", 1e6)):
        if num_bytes >= size:
            return f"{num_bytes / size:.3g} {unit}" if num_bytes < 1000 * size else f"{num_bytes / size:,.0f} {unit}"
    return f"{num_bytes / 1e3:.3g} kB"
