"""A kernel between sets of objects, for scenes whose number of objects varies.

A set A is represented by the mean of its objects in the feature space of a kernel k₀ between objects,

    k(A, B) = 1/(|A|·|B|) Σ_{a∈A} Σ_{b∈B} k₀(a, b),

which is a kernel again, bounded where k₀ is [GartnerFlachKowalczykSmola2002]_ [SmolaGrettonSongScholkopf2007]_. The
mean knows in which shares the objects come and not how many they are; the sum knows both and is bounded only where
the number of objects is. The empty set is the zero of that space: its k with everything is 0.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array

from halfseen.errors import ArgumentError
from halfseen.learning.svm.vector_kernels import Kernel, row_blocks, vector_kernel

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

    def summing(self, objects: slice) -> tuple[slice, csr_array]:
        """The sets that own these objects, and the matrix of shape (sets, objects) that sums over them."""
        owner = self.owner[objects]
        local = owner - owner[0]
        matrix = csr_array((np.ones(len(owner)), (local, np.arange(len(owner)))), shape=(local[-1] + 1, len(owner)))
        return slice(int(owner[0]), int(owner[-1]) + 1), matrix
