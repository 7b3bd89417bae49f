"""Kernels between rows of numbers and between sets of objects, their widths, and checks of user-defined kernels.

A kernel takes n and m rows (or sets) and returns the (n, m) values of k; if both arguments are the same object, the
matrix is exactly symmetric. scikit-learn's kernels have the same values and serve as the reference in tests; importing
them takes longer than most fits. The Gaussian and the Laplacian kernel are bounded by 1, as the theory of the censored
SVM requires (design, §2); the linear and the polynomial kernel are bounded only on bounded rows.

A set A of objects, whose number varies between scenes, is represented by the mean of its objects in the feature space
of a kernel k₀ between objects,

    k(A, B) = 1/(|A|·|B|) Σ_{a∈A} Σ_{b∈B} k₀(a, b),

which is again a kernel, bounded if k₀ is [GartnerFlachKowalczykSmola2002]_ [SmolaGrettonSongScholkopf2007]_. The mean
depends on the proportions of the objects but not on their number; the sum depends on both and is bounded only if the
number of objects is. The empty set is the zero of that space: its k with everything is 0.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from halfseen.arrays import Rows
from halfseen.errors import ArgumentError
from halfseen.estimator import is_number
from halfseen.shapes import Float

Kernel: TypeAlias = Callable[[Any, Any], np.ndarray]
"""Takes n and m rows (or sets) and returns the (n, m) values of k."""

BLOCK_ENTRIES = 2**18
"""Entries computed at once, so that they stay in the cache (2 MiB)."""

SYMMETRY_TOLERANCE = 1e-8
"""Largest |k(x, z) − k(z, x)|, as a share of the largest |k|."""

SMALLEST_VARIANCE = 1e-300
"""Smallest variance whose inverse, with some margin, is finite."""

ROWS_OF_A_DIAGONAL = 32
"""Rows of each small Gram matrix whose diagonal is used."""


def row_blocks(num_rows: int, num_columns: int, block_entries: int = BLOCK_ENTRIES) -> Iterator[slice]:
    """Slices that cover the rows, each with at most `block_entries` entries (and at least one row)."""
    step = max(1, block_entries // max(num_columns, 1))
    for start in range(0, num_rows, step):
        yield slice(start, min(start + step, num_rows))


DISTANCES: dict[str, Any] = {"rbf": "sqeuclidean", "laplacian": "cityblock"}
KERNEL_NAMES = ("linear", "rbf", "laplacian", "polynomial")


@dataclass(frozen=True)
class VectorKernel:
    """A kernel between rows of numbers."""

    name: str
    """"linear": x·z; "rbf": exp(−γ‖x − z‖²), the Gaussian kernel; "laplacian": exp(−γ‖x − z‖₁); "polynomial": (γ x·z +
    c)^d."""
    gamma: float | int = 1.0
    """γ > 0 [1 / unit of the rows, squared except for "laplacian"]; ignored by "linear"."""
    degree: float | int = 3
    coef0: float | int = 1.0
    """Integer d ≥ 1 and c ≥ 0 of "polynomial"; otherwise it is not positive semidefinite."""

    def __post_init__(self) -> None:
        if self.name not in KERNEL_NAMES:
            raise ArgumentError(
                f"kernel {self.name!r} is unknown; give one of {', '.join(KERNEL_NAMES)}, or a callable; for sets, "
                "'set' or a SetKernel"
            )
        if self.name != "linear" and not (is_number(self.gamma) and self.gamma > 0.0):
            raise ArgumentError(f"gamma is {self.gamma}, not a kernel width; give a finite number > 0, such as 'scale'")
        if self.name == "polynomial" and not (is_number(self.degree) and self.degree >= 1 and self.degree % 1 == 0):
            raise ArgumentError(
                f"degree is {self.degree}: such a power is not a positive semidefinite kernel; give a whole number ≥ 1"
            )
        if self.name == "polynomial" and not (is_number(self.coef0) and self.coef0 >= 0.0):
            raise ArgumentError(
                f"coef0 is {self.coef0}: the polynomial is not a positive semidefinite kernel; give a finite number ≥ 0"
            )

    def __call__(self, first: Float[np.ndarray, "n F"], second: Float[np.ndarray, "m F"]) -> Float[np.ndarray, "n m"]:
        """Values of k for all pairs."""
        if self.name in DISTANCES:
            return self._decay(first, second)
        products = first @ second.T
        if self.name == "linear":
            return products
        base = self.gamma * products + self.coef0
        power = base.copy()
        # Products, because powers of floats take ten times as long.
        for _ in range(int(self.degree) - 1):
            power *= base
        return power

    def _decay(self, first: Float[np.ndarray, "n F"], second: Float[np.ndarray, "m F"]) -> Float[np.ndarray, "n m"]:
        """exp(−γ·distance), with distances that avoid the cancellation of ‖x‖² + ‖z‖² − 2 x·z."""
        # This import takes a quarter of a second.
        from scipy.spatial.distance import cdist

        distance: Any = cdist(first, second, DISTANCES[self.name])
        for rows in row_blocks(*distance.shape):
            distance[rows] *= -self.gamma
            np.exp(distance[rows], out=distance[rows])
        return distance


def named_kernel(kernel: str | Kernel, gamma: float | int, degree: float | int = 3, coef0: float | int = 1.0) -> Kernel:
    """Return the `VectorKernel` of that name; a callable is returned unchanged (see `checked_gram`)."""
    return kernel if callable(kernel) else VectorKernel(kernel, gamma, degree, coef0)


def checked_gram(
    kernel: Kernel, first: Sequence[Any] | np.ndarray, second: Sequence[Any] | np.ndarray
) -> Float[np.ndarray, "n m"]:
    """Check and return kernel(first, second); it must be symmetric if `first` is `second`."""
    shape = len(first), len(second)
    try:
        gram = np.asarray(kernel(first, second), dtype=np.float64)
    except (TypeError, ValueError) as error:
        if isinstance(error, ArgumentError):
            raise
        raise ArgumentError(
            f"the kernel cannot be computed on {shape[0]} and {shape[1]} rows ({error}); "
            "give a callable that takes two arrays and returns their (n, m) values"
        ) from error
    if gram.shape != shape:
        raise ArgumentError(
            f"the kernel gives shape {gram.shape} for {shape[0]} and {shape[1]} rows; let it return shape {shape}"
        )
    is_finite = np.isfinite(gram)
    if not is_finite.all():
        row, column = np.argwhere(~is_finite)[0]
        raise ArgumentError(
            f"the kernel of rows {row} and {column} is {gram[row, column]}; let it return finite numbers, "
            "and scale the rows if it overflows"
        )
    if first is second:
        _check_symmetric(gram)
    return gram


def _check_symmetric(gram: Float[np.ndarray, "n n"]) -> None:
    slack = SYMMETRY_TOLERANCE * max(gram.max(initial=0.0), -gram.min(initial=0.0))
    for rows in row_blocks(*gram.shape):
        wrong = np.abs(gram[rows] - gram[:, rows].T) > slack
        if wrong.any():
            row, column = np.argwhere(wrong)[0] + (rows.start, 0)
            raise ArgumentError(
                f"the kernel is not symmetric: k(row {row}, row {column}) = {gram[row, column]} and "
                f"k(row {column}, row {row}) = {gram[column, row]}; give a symmetric, positive semidefinite one"
            )
    diagonal = np.diagonal(gram)
    if diagonal.min(initial=0.0) < -slack:
        row = int(np.argmin(diagonal))
        raise ArgumentError(f"the kernel of row {row} with itself is {diagonal[row]}; give a positive semidefinite one")


def kernel_diagonal(kernel: Kernel, rows: Sequence[Any] | np.ndarray) -> Float[np.ndarray, " n"]:
    """k(x, x) of each row, without the full Gram matrix."""
    blocks = [rows[few] for few in row_blocks(len(rows), 1, ROWS_OF_A_DIAGONAL)]
    return np.concatenate([np.zeros(0), *(np.diagonal(kernel(block, block)) for block in blocks)])


def scale_gamma(rows: Float[np.ndarray, "n F"], counts: Rows | None = None) -> float:
    """γ = 1/(F·variance of all values), scikit-learn's "scale"; 1 if nothing varies.

    Parameters
    ----------
    rows
        Rows, or the objects of all sets.
    counts
        Number of rows that each row represents; 1 by default.

    Returns
    -------
    float
        γ [1 / squared unit of the rows].
    """
    if rows.size == 0:
        return 1.0
    with np.errstate(over="ignore", invalid="ignore"):
        mean = float(np.average(rows.mean(axis=1), weights=counts))
        variance = float(np.average(np.square(rows - mean).mean(axis=1), weights=counts))
    if not np.isfinite(variance):
        raise ArgumentError(f"the rows have the variance {variance}; give finite values whose squares are finite")
    # The mean of equal values is rounded, so their variance may be positive.
    rounding = float(8.0 * np.finfo(np.float64).eps * np.abs(rows).max()) ** 2
    return 1.0 if variance <= max(rounding, SMALLEST_VARIANCE) else 1.0 / (rows.shape[1] * variance)


PAIRS_AT_ONCE = 2**22
"""Values of k₀ held at once (32 MiB)."""


@dataclass(frozen=True)
class SetKernel:
    """Mean (or sum) of a kernel between objects over all pairs of objects.

    Attributes
    ----------
    base
        k₀: a name accepted by `named_kernel`, or a callable.
    gamma, degree, coef0
        Parameters of k₀.
    pooling
        "mean", or "sum" if the number of objects matters.

    Raises
    ------
    ArgumentError
        A parameter is invalid.
    """

    base: str | Kernel = "rbf"
    gamma: float | int = 1.0
    degree: float | int = 3
    coef0: float | int = 1.0
    pooling: str = "mean"

    def __post_init__(self) -> None:
        named_kernel(self.base, self.gamma, self.degree, self.coef0)
        if self.pooling not in ("mean", "sum"):
            raise ArgumentError(f"pooling {self.pooling!r} is unknown; give mean or sum")

    def __call__(
        self, first: Sequence[Any] | np.ndarray, second: Sequence[Any] | np.ndarray
    ) -> Float[np.ndarray, "n m"]:
        """Values of k for all pairs of sets, exactly symmetric if `first` is `second`.

        Parameters
        ----------
        first, second
            Sets: arrays of shape (number of objects, F).

        Raises
        ------
        ArgumentError
            An element is not a set; the message names its row.
        """
        kernel = named_kernel(self.base, self.gamma, self.degree, self.coef0)
        (objects, pool), (others, other_pool) = (self._pooled(as_sets(sets)) for sets in (first, second))
        if objects.shape[1] != others.shape[1] and len(objects) and len(others):
            raise ArgumentError(
                f"objects have {objects.shape[1]} and {others.shape[1]} features; give sets with the same features"
            )
        gram = np.zeros((len(first), len(second)))
        if len(others):
            for some in row_blocks(len(objects), len(others), PAIRS_AT_ONCE):
                gram += pool[:, some] @ (other_pool @ kernel(objects[some], others).T).T
        return 0.5 * (gram + gram.T) if first is second else gram

    def _pooled(self, sets: np.ndarray) -> tuple[Float[np.ndarray, "objects F"], Any]:
        """All objects, and the sparse matrix of shape (sets, objects) that pools them."""
        from scipy.sparse import csc_array

        counts = np.array([len(objects) for objects in sets], dtype=np.int64)
        owner = np.repeat(np.arange(len(sets)), counts)
        share = 1.0 / counts[owner] if self.pooling == "mean" else np.ones(len(owner))
        matrix = csc_array((share, (owner, np.arange(len(owner)))), shape=(len(sets), len(owner)))
        return all_objects(sets), matrix


def as_sets(rows: Sequence[Any] | np.ndarray) -> np.ndarray:
    """Check sets and return them as an array of arrays.

    Parameters
    ----------
    rows
        Sets: a sequence of arrays of shape (number of objects, F); an empty set may have any F.

    Returns
    -------
    ndarray
        Shape (n,), of float64 arrays, so that rows[indices] works as for numbers.
    """
    sets = np.empty(len(rows), dtype=object)
    num_features = None
    for row, value in enumerate(rows):
        sets[row] = objects = _as_objects(value, row)
        if len(objects):
            num_features = objects.shape[1] if num_features is None else num_features
            if objects.shape[1] != num_features:
                raise ArgumentError(
                    f"set in row {row}: objects have {objects.shape[1]} features, those of rows above {num_features}; "
                    "give every object the same features"
                )
    return sets


def all_objects(sets: np.ndarray) -> Float[np.ndarray, "objects F"]:
    """The objects of all checked sets, stacked."""
    filled = [objects for objects in sets if len(objects)]
    return np.concatenate(filled) if filled else np.empty((0, 0))


def _as_objects(value: Any, row: int) -> Float[np.ndarray, "objects F"]:
    try:
        objects = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ArgumentError(f"set in row {row} is not numeric ({error}); give an array of floats") from error
    if objects.size == 0 and objects.ndim < 2:
        return np.empty((0, 0))
    if objects.ndim != 2:
        raise ArgumentError(
            f"set in row {row} has shape {objects.shape}; give one row per object and one column per feature"
        )
    if not np.isfinite(objects).all():
        which, feature = np.argwhere(~np.isfinite(objects))[0]
        raise ArgumentError(
            f"set in row {row}, object {which}, feature {feature}: {objects[which, feature]} is not a finite "
            "number; fill it in or leave the object out"
        )
    return objects
