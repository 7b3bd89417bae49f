"""Kernels between sets of objects, for scenes whose number of objects varies.

A set A is represented by the mean of its objects in the feature space of a kernel k₀ between objects,

    k(A, B) = 1/(|A|·|B|) Σ_{a∈A} Σ_{b∈B} k₀(a, b),

which is a kernel again, bounded where k₀ is [GartnerFlachKowalczykSmola2002]_ [SmolaGrettonSongScholkopf2007]_. The
mean knows in which shares the objects come and not how many they are; the sum knows both and is bounded only where
the number of objects is. The empty set is the zero of that space: its k with everything is 0.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from halfseen.errors import ArgumentError
from halfseen.learning.svm.kernels import Kernel, named_kernel, row_blocks
from halfseen.shapes import Float

PAIRS_AT_ONCE = 2**22
"""Values of k₀ that are held at once (32 MiB)."""


@dataclass(frozen=True)
class SetKernel:
    """Mean (or sum) over all pairs of objects of a kernel between objects.

    Attributes
    ----------
    base
        k₀: a name that `named_kernel` takes, or a callable.
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
    pooling: str = "mean"

    def __post_init__(self) -> None:
        named_kernel(self.base, self.gamma, self.degree, self.coef0)
        if self.pooling not in ("mean", "sum"):
            raise ArgumentError(f"pooling {self.pooling!r} is unknown; give mean or sum")

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
        kernel = named_kernel(self.base, self.gamma, self.degree, self.coef0)
        (objects, pool), (others, other_pool) = (self._pooled(as_sets(sets)) for sets in (first, second))
        if objects.shape[1] != others.shape[1] and len(objects) and len(others):
            raise ArgumentError(
                f"objects have {objects.shape[1]} and {others.shape[1]} features; give sets of the same"
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
    """The objects of all checked sets, one below the other."""
    filled = [objects for objects in sets if len(objects)]
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
