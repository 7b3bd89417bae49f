"""How the rows are seen by the solver: through a Gram matrix, through features, or through low-rank features.

A design holds what was computed once from all rows, so that cross-validation only takes parts of it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
import scipy.linalg
from jaxtyping import Float, Int

from halfseen.arrays import RowIds, Rows
from halfseen.errors import ArgumentError
from halfseen.learning.svm.nystrom import Nystrom
from halfseen.learning.svm.spaces import Coefficients, FeatureSpace, GramSpace, Space
from halfseen.learning.svm.vector_kernels import Kernel, row_blocks

_PREDICTED_AT_ONCE = 2**22
_SINGULAR = 1e-12


Function: TypeAlias = Callable[[Any], Rows]
"""A fitted g, without its offset: from new rows to its values there."""


@runtime_checkable
class Design(Protocol):
    """All rows, as the solver sees them."""

    def space(self, rows: RowIds) -> Space:
        """The space that these rows span."""
        ...

    def values(self, coefficients: Coefficients, rows: RowIds, at: Int[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """At the rows `at`, g whose coefficients were fitted to `rows`."""
        ...

    def function(self, coefficients: Coefficients, rows: RowIds) -> Function:
        """The g whose coefficients were fitted to `rows`."""
        ...


@dataclass(frozen=True)
class KernelFunction:
    """g = Σ_i α_i k(z_i, ·) over the support rows."""

    kernel: Kernel
    support: Any
    coefficients: Coefficients

    def __call__(self, rows: Any) -> Rows:
        g = np.zeros(len(rows))
        for some in row_blocks(len(rows), len(self.coefficients), _PREDICTED_AT_ONCE):
            g[some] = self.kernel(rows[some], self.support) @ self.coefficients
        return g


@dataclass(frozen=True)
class LinearFunction:
    """g = z·θ."""

    coefficients: Coefficients

    def __call__(self, rows: Float[np.ndarray, "m c"]) -> Rows:
        return rows @ self.coefficients


@dataclass(frozen=True)
class LowRankFunction:
    """g = φ(z)·θ with φ of a few landmarks."""

    nystrom: Nystrom
    coefficients: Coefficients

    def __call__(self, rows: Any) -> Rows:
        g = np.zeros(len(rows))
        for some in row_blocks(len(rows), len(self.coefficients), _PREDICTED_AT_ONCE):
            g[some] = self.nystrom.transform(rows[some]) @ self.coefficients
        return g


@dataclass(frozen=True)
class GramDesign:
    """Rows by the values of the kernel between them."""

    kernel: Kernel
    rows: Any
    gram: Float[np.ndarray, "n n"]

    def space(self, rows: RowIds) -> GramSpace:
        return GramSpace(self._part(rows, rows))

    def values(self, coefficients: Coefficients, rows: RowIds, at: Int[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        return self._part(at, rows) @ coefficients

    def function(self, coefficients: Coefficients, rows: RowIds) -> KernelFunction:
        """Keep the rows that g leans on."""
        support = np.flatnonzero(coefficients)
        return KernelFunction(self.kernel, self.rows[rows[support]], coefficients[support])

    def _part(self, rows: Int[np.ndarray, " r"], columns: Int[np.ndarray, " c"]) -> Float[np.ndarray, "r c"]:
        is_whole = len(rows) == len(columns) == len(self.gram) and (rows == columns).all()
        return self.gram if is_whole and (rows == np.arange(len(rows))).all() else self.gram[np.ix_(rows, columns)]


@dataclass(frozen=True)
class RootDesign:
    """Rows by a square root of their Gram matrix, K = Φ Φᵀ, for λ = 0, where K must be of full rank."""

    kernel: Kernel
    rows: Any
    root: Float[np.ndarray, "n n"]

    @classmethod
    def of(cls, design: GramDesign) -> "RootDesign":
        """Factor the Gram matrix.

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
        return cls(design.kernel, design.rows, root)

    def space(self, rows: RowIds) -> FeatureSpace:
        return FeatureSpace(self.root[rows])

    def values(self, coefficients: Coefficients, rows: RowIds, at: Int[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        return self.root[at] @ coefficients

    def function(self, coefficients: Coefficients, rows: RowIds) -> KernelFunction:
        """Write g by the kernel again: Φ θ = K α."""
        return KernelFunction(self.kernel, self.rows, scipy.linalg.solve_triangular(self.root.T, coefficients))


@dataclass(frozen=True)
class LinearDesign:
    """Rows by themselves: the linear kernel, and where there are more rows than columns the faster way to it."""

    features: Float[np.ndarray, "n c"]

    def space(self, rows: RowIds) -> FeatureSpace:
        # Low-rank features of a large log are not copied for nothing.
        return FeatureSpace(self.features if len(rows) == len(self.features) else self.features[rows])

    def values(self, coefficients: Coefficients, rows: RowIds, at: Int[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        return self.features[at] @ coefficients

    def function(self, coefficients: Coefficients, rows: RowIds) -> Function:
        return LinearFunction(coefficients)


@dataclass(frozen=True)
class LowRankDesign(LinearDesign):
    """Rows by low-rank features of the kernel."""

    nystrom: Nystrom

    def function(self, coefficients: Coefficients, rows: RowIds) -> Function:
        return LowRankFunction(self.nystrom, coefficients)


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
