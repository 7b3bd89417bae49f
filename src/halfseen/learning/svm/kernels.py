"""Kernels between rows of numbers and between sets of objects: by name, their widths, and what one's own must pass.

Each gives k(x, z) for all pairs at once, exactly symmetric and in one buffer. scikit-learn's give the same values, and
are what the tests compare with; they take 0.2 ms or more to check a handful of rows, and two to four times as long for
a power. The Gaussian and the Laplacian kernel are bounded by 1, as the theory of the censored SVM asks (design, §2);
the linear and the polynomial kernel are bounded only where the rows are.

For scenes whose number of objects varies, a set A is represented by the mean of its objects in the feature space of a
kernel k₀ between objects,

    k(A, B) = 1/(|A|·|B|) Σ_{a∈A} Σ_{b∈B} k₀(a, b),

which is a kernel again, bounded where k₀ is [GartnerFlachKowalczykSmola2002]_ [SmolaGrettonSongScholkopf2007]_. The
mean knows in which shares the objects come and not how many they are; the sum knows both and is bounded only where
the number of objects is. The empty set is the zero of that space: its k with everything is 0.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from jaxtyping import Float, Int

from halfseen.arrays import Rows
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
class DecayingKernel:
    """k(x, z) = exp(−γ d(x, z)) for a distance d; γ > 0 [1 / unit of d], or an `ArgumentError`."""

    gamma: float | int

    def __post_init__(self) -> None:
        _check_gamma(self.gamma)

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
            return _decay(first, second, "sqeuclidean", self.gamma)
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
        return _decay(first, second, "cityblock", self.gamma)


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
    if kernel not in VECTOR_KERNELS:
        raise ArgumentError(f"kernel {kernel!r} is unknown; give one of {', '.join(VECTOR_KERNELS)}, or a callable")
    if kernel == "polynomial":
        return PolynomialKernel(gamma, degree, coef0)
    if kernel == "linear":
        return LinearKernel()
    return RbfKernel(gamma) if kernel == "rbf" else LaplacianKernel(gamma)


def row_blocks(num_rows: int, num_columns: int, block_entries: int = BLOCK_ENTRIES) -> Iterator[slice]:
    """Slices that cover the rows, each of at most `block_entries` entries (and at least one row)."""
    step = max(1, block_entries // max(num_columns, 1))
    for start in range(0, num_rows, step):
        yield slice(start, min(start + step, num_rows))


def _decay(
    first: Float[np.ndarray, "n F"],
    second: Float[np.ndarray, "m F"],
    metric: Literal["sqeuclidean", "cityblock"],
    gamma: float | int,
) -> Float[np.ndarray, "n m"]:
    """exp(−γ·distance)."""
    # SciPy's distances take a quarter of a second to load.
    from scipy.spatial.distance import cdist

    distance: Any = cdist(first, second, metric)
    for rows in row_blocks(*distance.shape):
        distance[rows] *= -gamma
        np.exp(distance[rows], out=distance[rows])
    return distance


def _check_gamma(gamma: float | int) -> None:
    if not 0.0 < gamma < np.inf:
        raise ArgumentError(
            f"gamma is {gamma}, which is no width of a kernel; give a finite number > 0, such as scale_gamma(X)"
        )


OBJECTS_AT_ONCE = 2048
"""Objects on either side of a block of k₀ (32 MiB)."""


@dataclass(frozen=True)
class SetKernel:
    """Mean (or sum) over all pairs of objects of a kernel between objects.

    Attributes
    ----------
    base
        k₀: a name that `vector_kernel` takes, or a callable.
    gamma, degree, coef0
        Parameters of k₀.
    pooling
        "mean", or "sum" where the number of objects counts.

    Raises
    ------
    ArgumentError
        A parameter is none of a kernel.
    """

    base: str | Kernel = "rbf"
    gamma: float | int = 1.0
    degree: float | int = 3
    coef0: float | int = 1.0
    pooling: Literal["mean", "sum"] = "mean"

    def __post_init__(self) -> None:
        _ = self.object_kernel
        if self.pooling not in ("mean", "sum"):
            raise ArgumentError(f"pooling {self.pooling!r} is unknown; give mean or sum")

    @property
    def object_kernel(self) -> Kernel:
        """k₀."""
        return vector_kernel(self.base, self.gamma, self.degree, self.coef0)

    def __call__(
        self, first: Sequence[Any] | np.ndarray, second: Sequence[Any] | np.ndarray
    ) -> Float[np.ndarray, "n m"]:
        """Values of k for all pairs of sets, exactly symmetric where `first` is `second`.

        Parameters
        ----------
        first, second
            Sets: arrays of shape (number of objects, F).

        Raises
        ------
        ArgumentError
            An element is no set; its row is named.
        """
        is_same = first is second
        left = _Pool.of(as_sets(first))
        right = left if is_same else _Pool.of(as_sets(second))
        if left.objects.shape[1] != right.objects.shape[1] and len(left.objects) and len(right.objects):
            raise ArgumentError(
                f"objects have {left.objects.shape[1]} and {right.objects.shape[1]} features; give sets of the same"
            )
        gram = self._sums(left, right, is_same)
        if self.pooling == "mean":
            for rows in row_blocks(*gram.shape):
                gram[rows] *= left.share[rows, None] * right.share
        return gram

    def _sums(self, left: "_Pool", right: "_Pool", is_same: bool) -> Float[np.ndarray, "n m"]:
        """Σ k₀ over pairs of objects, by blocks of objects; of a symmetric one half the blocks."""
        gram = np.zeros((left.num_sets, right.num_sets))
        kernel = self.object_kernel
        for rows in row_blocks(len(left.objects), 1, OBJECTS_AT_ONCE):
            for columns in row_blocks(len(right.objects), 1, OBJECTS_AT_ONCE):
                if is_same and columns.start < rows.start:
                    continue
                own = left.objects[rows]
                sets, summed = left.summing(rows)
                other_sets, other_summed = right.summing(columns)
                on_diagonal = is_same and columns == rows
                values = kernel(own, own if on_diagonal else right.objects[columns])
                block = (other_summed @ (summed @ values).T).T
                if on_diagonal:
                    block = 0.5 * (block + block.T)
                gram[sets, other_sets] += block
                if is_same and not on_diagonal:
                    gram[other_sets, sets] += block.T
        return gram


def as_sets(rows: Sequence[Any] | np.ndarray) -> np.ndarray:
    """Checked sets, as an array of arrays.

    Parameters
    ----------
    rows
        Sets: a sequence of arrays of shape (number of objects, F); a set without objects may have any F.

    Returns
    -------
    ndarray
        Shape (n,), of float64 arrays: rows[indices] works as for numbers.

    Raises
    ------
    ArgumentError
        An element has not two axes or not F features, or a value is not finite; the row is named.
    """
    sets = np.empty(len(rows), dtype=object)
    num_features = None
    for row, value in enumerate(rows):
        objects = _as_objects(value, row)
        if len(objects):
            num_features = objects.shape[1] if num_features is None else num_features
            if objects.shape[1] != num_features:
                raise ArgumentError(
                    f"set in row {row}: objects have {objects.shape[1]} features, those of rows above {num_features}; "
                    "give every object the same features"
                )
        sets[row] = objects
    return sets


def all_objects(rows: Sequence[Any] | np.ndarray) -> Float[np.ndarray, "objects F"]:
    """The objects of all sets, one below the other.

    Raises
    ------
    ArgumentError
        An element is no set; its row is named.
    """
    filled = [objects for objects in as_sets(rows) if len(objects)]
    return np.concatenate(filled) if filled else np.empty((0, 0))


def _as_objects(value: Any, row: int) -> Float[np.ndarray, "objects F"]:
    try:
        objects = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ArgumentError(f"set in row {row} is not made of numbers ({error}); give an array of floats") from error
    if objects.size == 0 and objects.ndim < 2:
        return np.empty((0, 0))
    if objects.ndim != 2:
        raise ArgumentError(
            f"set in row {row} has shape {objects.shape}; give one row per object and one column per feature"
        )
    if not np.isfinite(objects).all():
        which, feature = np.argwhere(~np.isfinite(objects))[0]
        raise ArgumentError(
            f"set in row {row}, object {which}, feature {feature}: {objects[which, feature]} is no finite number; "
            "fill it in or leave the object out"
        )
    return objects


@dataclass(frozen=True)
class _Pool:
    """The objects of sets, one below the other."""

    objects: Float[np.ndarray, "objects F"]
    owner: Int[np.ndarray, " objects"]
    """Set of each object, increasing."""
    share: Float[np.ndarray, " sets"]
    """Of one object in its set; 0 where the set is empty."""

    @classmethod
    def of(cls, sets: np.ndarray) -> "_Pool":
        counts = np.array([len(objects) for objects in sets], dtype=np.int64)
        share = np.where(counts > 0, 1.0 / np.maximum(counts, 1), 0.0)
        filled = [objects for objects in sets if len(objects)]
        objects = np.concatenate(filled) if filled else np.empty((0, 0))
        return cls(objects, np.repeat(np.arange(len(sets)), counts), share)

    @property
    def num_sets(self) -> int:
        return len(self.share)

    def summing(self, objects: slice) -> tuple[slice, Any]:
        """The sets that own these objects, and the matrix of shape (sets, objects) that sums over them."""
        from scipy.sparse import csr_array

        owner = self.owner[objects]
        local = owner - owner[0]
        matrix = csr_array((np.ones(len(owner)), (local, np.arange(len(owner)))), shape=(local[-1] + 1, len(owner)))
        return slice(int(owner[0]), int(owner[-1]) + 1), matrix


KERNEL_NAMES = (*VECTOR_KERNELS, "set")
"""Names that `named_kernel` takes."""

SYMMETRY_TOLERANCE = 1e-8
"""Largest |k(x, z) − k(z, x)|, as a share of the largest |k|."""

SMALLEST_VARIANCE = 1e-300
"""Whose inverse, and some times that, is finite."""

ROWS_OF_A_DIAGONAL = 32
"""Rows of each small Gram matrix whose diagonal is read."""


def named_kernel(kernel: str | Kernel, gamma: float | int, degree: float | int = 3, coef0: float | int = 1.0) -> Kernel:
    """The kernel of that name.

    Parameters
    ----------
    kernel
        "linear": x·z; "rbf": exp(−γ‖x − z‖²); "laplacian": exp(−γ‖x − z‖₁); "polynomial": (γ x·z + c)^d; "set": the
        mean of "rbf" over pairs of objects (`SetKernel`). A callable passes through; see `checked_gram`.
    gamma
        γ > 0 [1 / unit of the rows, squared but for "laplacian"]; "linear" and callables don't read it.
    degree, coef0
        d ≥ 1 and c ≥ 0 of "polynomial".

    Returns
    -------
    Kernel
        Takes n and m rows, gives the (n, m) values; pass the same object twice for an exactly symmetric matrix.

    Raises
    ------
    ArgumentError
        There is no such kernel, or a parameter that it uses makes it none.
    """
    if not callable(kernel) and kernel not in KERNEL_NAMES:
        raise ArgumentError(f"kernel {kernel!r} is unknown; give one of {', '.join(KERNEL_NAMES)}, or a callable")
    if kernel == "set":
        return SetKernel("rbf", gamma)
    return vector_kernel(kernel, gamma, degree, coef0)


def checked_gram(
    kernel: Kernel, first: Sequence[Any] | np.ndarray, second: Sequence[Any] | np.ndarray
) -> Float[np.ndarray, "n m"]:
    """kernel(first, second), refused where it is no part of a Gram matrix.

    Parameters
    ----------
    kernel
        Any kernel; one of the user's own is meant.
    first, second
        n and m rows; where they are the same object, symmetry is asked for.

    Raises
    ------
    ArgumentError
        The values have another shape or are not finite, or, where `first` is `second`, are not symmetric within
        `SYMMETRY_TOLERANCE`, or negative on the diagonal.
    """
    try:
        gram = np.asarray(kernel(first, second), dtype=np.float64)
    except (TypeError, ValueError) as error:
        if isinstance(error, ArgumentError):
            raise
        raise ArgumentError(
            f"the kernel cannot be computed on {len(first)} and {len(second)} rows ({error}); "
            "give a callable that takes two arrays and returns their (n, m) values"
        ) from error
    if gram.shape != (len(first), len(second)):
        raise ArgumentError(
            f"the kernel gives shape {gram.shape} for {len(first)} and {len(second)} rows; "
            f"let it return shape {(len(first), len(second))}"
        )
    for rows in row_blocks(*gram.shape):
        _check_finite(gram, rows)
    if first is second:
        _check_symmetric(gram)
    return gram


def kernel_diagonal(kernel: Kernel, rows: Sequence[Any] | np.ndarray) -> Float[np.ndarray, " n"]:
    """k(x, x) of each row, without the Gram matrix.

    Parameters
    ----------
    kernel
        Any kernel; its method `diagonal` is used where it has one.
    rows
        n rows or sets.
    """
    own = getattr(kernel, "diagonal", None)
    if own is not None:
        return own(rows)
    diagonal = np.empty(len(rows))
    for few in row_blocks(len(rows), 1, ROWS_OF_A_DIAGONAL):
        block = rows[few]
        diagonal[few] = np.diagonal(kernel(block, block))
    return diagonal


def scale_gamma(rows: Sequence[Any] | np.ndarray, counts: Rows | None = None) -> float:
    """γ = 1/(F·variance of all values), scikit-learn's "scale"; 1 where nothing varies.

    Parameters
    ----------
    rows
        An array of shape (n, F), or sets, whose objects count one by one.
    counts
        How many rows each one stands for; one by default. Sets count once each.

    Returns
    -------
    float
        γ [1 / squared unit of the rows].

    Raises
    ------
    ArgumentError
        A value, or the variance, is not finite.
    """
    is_matrix = isinstance(rows, np.ndarray) and rows.dtype != object and rows.ndim == 2
    values = np.asarray(rows) if is_matrix else all_objects(rows)
    if values.size == 0:
        return 1.0
    share = np.ones(len(values)) if counts is None or not is_matrix else counts
    with np.errstate(over="ignore", invalid="ignore"):
        mean = float(np.average(values.mean(axis=1), weights=share))
        variance = float(np.average(np.square(values - mean).mean(axis=1), weights=share))
    if not np.isfinite(variance):
        raise ArgumentError(f"the rows have the variance {variance}; give finite values whose squares are finite")
    # The mean of equal values is rounded, and their variance with it.
    rounding = float(8.0 * np.finfo(np.float64).eps * np.abs(values).max()) ** 2
    if variance <= max(rounding, SMALLEST_VARIANCE):
        return 1.0
    return 1.0 / (values.shape[1] * variance)


def candidate_gammas(rows: Sequence[Any] | np.ndarray, counts: Rows | None = None) -> Float[np.ndarray, "5"]:
    """Widths to choose from by cross-validation: `scale_gamma(rows)` · 4^{−2, …, 2}, increasing.

    Parameters
    ----------
    rows
        An array of shape (n, F), or sets.
    counts
        How many rows each one stands for; one by default.
    """
    return scale_gamma(rows, counts) * 4.0 ** np.arange(-2, 3)


def _check_finite(gram: Float[np.ndarray, "n m"], rows: slice) -> None:
    wrong = ~np.isfinite(gram[rows])
    if wrong.any():
        row, column = np.argwhere(wrong)[0] + (rows.start, 0)
        raise ArgumentError(
            f"the kernel of rows {row} and {column} is {gram[row, column]}; let it return finite numbers, "
            "and scale the rows if it overflows"
        )


def _check_symmetric(gram: Float[np.ndarray, "n n"]) -> None:
    largest = max(gram.max(initial=0.0), -gram.min(initial=0.0))
    for rows in row_blocks(*gram.shape):
        gap = np.abs(gram[rows] - gram[:, rows].T)
        if gap.max(initial=0.0) > SYMMETRY_TOLERANCE * largest:
            row, column = np.argwhere(gap > SYMMETRY_TOLERANCE * largest)[0] + (rows.start, 0)
            raise ArgumentError(
                f"the kernel is not symmetric: k(row {row}, row {column}) = {gram[row, column]} and "
                f"k(row {column}, row {row}) = {gram[column, row]}; give a symmetric, positive semidefinite one"
            )
    diagonal = np.diagonal(gram)
    if diagonal.min(initial=0.0) < -SYMMETRY_TOLERANCE * largest:
        row = int(np.argmin(diagonal))
        raise ArgumentError(f"the kernel of row {row} with itself is {diagonal[row]}; give a positive semidefinite one")
