"""Kernels between rows of numbers: each gives k(x, z) for all pairs at once, exactly symmetric and in one buffer.

scikit-learn's give the same values, and are what the tests compare with; they take 0.2 ms or more to check a handful of
rows, and two to four times as long for a power.

The Gaussian and the Laplacian kernel are bounded by 1, as the theory of the censored SVM asks (design, §2); the linear
and the polynomial kernel are bounded only where the rows are.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float
from scipy.spatial.distance import cdist

from halfseen.errors import ArgumentError

Kernel: TypeAlias = Callable[[Any, Any], np.ndarray]
"""Takes n and m rows (or sets), gives the (n, m) values of k; `diagonal`, where there is one, gives each k(x, x)."""

BLOCK_ENTRIES = 2**18
"""Entries handled at once, so that they stay in the cache (2 MiB)."""

DISTANCE_TOLERANCE = 1e-10
"""Largest error of γ‖x − z‖² for which it may come from a product of matrices."""


@dataclass(frozen=True)
class LinearKernel:
    """k(x, z) = x·z."""

    def __call__(self, first: Float[np.ndarray, "n F"], second: Float[np.ndarray, "m F"]) -> Float[np.ndarray, "n m"]:
        return first @ second.T

    def diagonal(self, rows: Float[np.ndarray, "n F"]) -> Float[np.ndarray, " n"]:
        return np.einsum("nf,nf->n", rows, rows)


@dataclass(frozen=True)
class DecayingKernel(ABC):
    """k(x, z) = exp(−γ d(x, z)) for a distance d.

    Attributes
    ----------
    gamma
        γ > 0 [1 / unit of d].

    Raises
    ------
    ArgumentError
        γ is no finite number > 0.
    """

    gamma: float | int

    def __post_init__(self) -> None:
        _check_gamma(self.gamma)

    @abstractmethod
    def __call__(self, first: Float[np.ndarray, "n F"], second: Float[np.ndarray, "m F"]) -> Float[np.ndarray, "n m"]:
        """Values of k for all pairs."""

    def diagonal(self, rows: Float[np.ndarray, "n F"]) -> Float[np.ndarray, " n"]:
        """Values of k(x, x): 1."""
        return np.ones(len(rows))


class RbfKernel(DecayingKernel):
    """k(x, z) = exp(−γ‖x − z‖²), the Gaussian kernel; γ in [1 / squared unit of the rows]."""

    def __call__(self, first: Float[np.ndarray, "n F"], second: Float[np.ndarray, "m F"]) -> Float[np.ndarray, "n m"]:
        """Values of k for all pairs; exactly 1 on the diagonal where `first` is `second`."""
        centre = second.sum(axis=0) / max(len(second), 1)
        scale = np.sqrt(2.0 * self.gamma)
        scaled = (first - centre) * scale
        other = scaled if first is second else (second - centre) * scale
        half, other_half = (0.5 * np.einsum("nf,nf->n", rows, rows) for rows in (scaled, other))
        # ‖x‖² + ‖z‖² − 2 x·z cancels where rows are far from their centre, measured in kernel widths.
        largest = max(half.max(initial=0.0), other_half.max(initial=0.0))
        if np.finfo(np.float64).eps * largest > DISTANCE_TOLERANCE:
            return _decay(cdist(first, second, "sqeuclidean"), self.gamma)
        gram = scaled @ other.T
        for rows in row_blocks(*gram.shape):
            # One sum of both halves: subtracting them in turn rounds k(x, z) and k(z, x) differently.
            gram[rows] -= half[rows, None] + other_half
            np.minimum(gram[rows], 0.0, out=gram[rows])
            np.exp(gram[rows], out=gram[rows])
        if first is second:
            np.fill_diagonal(gram, 1.0)
        return gram


class LaplacianKernel(DecayingKernel):
    """k(x, z) = exp(−γ Σ_f |x_f − z_f|); γ in [1 / unit of the rows]."""

    def __call__(self, first: Float[np.ndarray, "n F"], second: Float[np.ndarray, "m F"]) -> Float[np.ndarray, "n m"]:
        return _decay(cdist(first, second, "cityblock"), self.gamma)


@dataclass(frozen=True)
class PolynomialKernel:
    """k(x, z) = (γ x·z + c)^d, positive semidefinite for whole d ≥ 1 and c ≥ 0.

    Attributes
    ----------
    gamma
        γ > 0 [1 / squared unit of the rows].
    degree
        d.
    coef0
        c: how much the lower powers count.

    Raises
    ------
    ArgumentError
        A parameter makes this no kernel.
    """

    gamma: float | int
    degree: float | int = 3
    coef0: float | int = 1.0

    def __post_init__(self) -> None:
        _check_gamma(self.gamma)
        if not (self.degree >= 1 and self.degree % 1 == 0):
            raise ArgumentError(
                f"degree is {self.degree}: such a power is no positive semidefinite kernel; give a whole number ≥ 1"
            )
        if not 0.0 <= self.coef0 < np.inf:
            raise ArgumentError(
                f"coef0 is {self.coef0}: the polynomial is no positive semidefinite kernel; give a finite number ≥ 0"
            )

    def __call__(self, first: Float[np.ndarray, "n F"], second: Float[np.ndarray, "m F"]) -> Float[np.ndarray, "n m"]:
        gram = first @ second.T
        for rows in row_blocks(*gram.shape):
            gram[rows] = self._power(gram[rows])
        return gram

    def diagonal(self, rows: Float[np.ndarray, "n F"]) -> Float[np.ndarray, " n"]:
        return self._power(np.einsum("nf,nf->n", rows, rows))

    def _power(self, products: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        base = self.gamma * products + self.coef0
        power = base.copy()
        # Products, since powers of floats take ten times as long.
        for _ in range(int(self.degree) - 1):
            power *= base
        return power


VECTOR_KERNELS = ("linear", "rbf", "laplacian", "polynomial")
"""Names that `vector_kernel` takes."""


def vector_kernel(
    kernel: str | Kernel, gamma: float | int, degree: float | int = 3, coef0: float | int = 1.0
) -> Kernel:
    """The kernel of that name; a callable passes through.

    Raises
    ------
    ArgumentError
        There is no such kernel, or a parameter that it uses makes it none.
    """
    if callable(kernel):
        return kernel
    if kernel == "linear":
        return LinearKernel()
    if kernel == "rbf":
        return RbfKernel(gamma)
    if kernel == "laplacian":
        return LaplacianKernel(gamma)
    if kernel == "polynomial":
        return PolynomialKernel(gamma, degree, coef0)
    raise ArgumentError(f"kernel {kernel!r} is unknown; give one of {', '.join(VECTOR_KERNELS)}, or a callable")


def row_blocks(num_rows: int, num_columns: int, block_entries: int = BLOCK_ENTRIES) -> Iterator[slice]:
    """Slices that cover the rows, each of at most `block_entries` entries (and at least one row)."""
    step = max(1, block_entries // max(num_columns, 1))
    for start in range(0, num_rows, step):
        yield slice(start, min(start + step, num_rows))


def _decay(distance: Float[np.ndarray, "n m"], gamma: float | int) -> Float[np.ndarray, "n m"]:
    """exp(−γ·distance), in place."""
    for rows in row_blocks(*distance.shape):
        distance[rows] *= -gamma
        np.exp(distance[rows], out=distance[rows])
    return distance


def _check_gamma(gamma: float | int) -> None:
    if not 0.0 < gamma < np.inf:
        raise ArgumentError(
            f"gamma is {gamma}, which is no width of a kernel; give a finite number > 0, such as scale_gamma(X)"
        )
