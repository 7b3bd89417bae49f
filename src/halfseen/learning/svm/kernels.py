"""Kernels by name, their widths, and the checks that a kernel of one's own must pass.

Read down: `vector_kernels` (rows of numbers) → `set_kernel` (sets of objects) → this → `nystrom` (a low-rank form).
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from halfseen.arrays import Rows
from halfseen.errors import ArgumentError
from halfseen.learning.svm.set_kernel import SetKernel, all_objects
from halfseen.learning.svm.vector_kernels import VECTOR_KERNELS, Kernel, row_blocks, vector_kernel

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
