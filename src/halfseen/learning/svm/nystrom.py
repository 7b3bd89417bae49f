"""A low-rank kernel: features Φ with ΦΦᵀ ≈ K, from a few landmark rows [WilliamsSeeger2000]_.

The landmarks are drawn one after the other, with probability proportional to the part of k(x, x) that the earlier ones
leave unexplained: randomly pivoted Cholesky [ChenEpperlyTroppWebber2025]_, here in blocks with rejection, which draws
from the same distribution [EpperlyTroppWebber2025]_.

=========  =============================================================
Here       There
=========  =============================================================
diagonal   diag A
residual   u, the diagonal of A − F Fᵀ
factor     F
proposals  S′, drawn at once from u
accepted   S, those kept
=========  =============================================================
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from halfseen.errors import ArgumentError
from halfseen.estimator import is_count
from halfseen.learning.svm.kernels import Kernel, checked_gram, kernel_diagonal, row_blocks
from halfseen.shapes import Float, Int

MOST_CANDIDATES = 20_000
"""Rows among which landmarks are drawn, if these are not many; a random sample of larger logs."""

CANDIDATES_A_LANDMARK = 10

ROWS_CHECKED = 32
"""Rows on which the kernel is first checked."""

MOST_PROPOSALS = 128
"""Landmarks proposed at once."""

PROPOSALS_A_LANDMARK = 4

RESIDUAL_TOLERANCE = 1e-12
"""A row whose residual is below this share of the largest k(x, x) counts as explained."""

NEGATIVE_TOLERANCE = 1e-8
"""A residual this far below 0, as a share of the largest k(x, x), is not rounding."""

FEATURES_AT_ONCE = 2**22
"""Entries of K(rows, landmarks) held at once (32 MiB)."""


@dataclass(frozen=True)
class Nystrom:
    """Kernel expansion at landmarks: features φ(x) = Rᵀ k(landmarks, x), so that φ(x)·φ(z) ≈ k(x, z)."""

    kernel: Kernel
    """k."""
    landmarks: np.ndarray
    """Shape (m, F), or (m,) of sets."""
    projection: Float[np.ndarray, "m ..."]
    """R, shape (m, r): R Rᵀ is the inverse of k between landmarks, without directions in which k is singular. Or shape
    (m,), for one function instead of features."""

    def transform(self, rows: Sequence[Any] | np.ndarray) -> Float[np.ndarray, "n ..."]:
        """Φ of n rows or sets, computed in blocks without a second buffer of its size."""
        features = np.empty((len(rows), *self.projection.shape[1:]))
        for few in row_blocks(len(rows), len(self.landmarks), FEATURES_AT_ONCE):
            np.matmul(self.kernel(rows[few], self.landmarks), self.projection, out=features[few])
        wrong = ~np.isfinite(features).all(axis=tuple(range(1, features.ndim)))
        if wrong.any():
            raise ArgumentError(
                f"row {int(np.argmax(wrong))}: its kernel with a landmark is not finite; give finite values, and scale "
                "them if the kernel overflows"
            )
        return features

    def function(self, coefficients: Float[np.ndarray, " r"]) -> "Nystrom":
        """Σ_j coefficients_j φ_j, itself a kernel expansion."""
        return Nystrom(self.kernel, self.landmarks, self.projection @ coefficients)


def fit_nystrom(kernel: Kernel, rows: np.ndarray, num_landmarks: int, rng: np.random.Generator) -> Nystrom:
    """Choose landmarks among the rows.

    Parameters
    ----------
    kernel
        k, positive semidefinite.
    rows
        Shape (n, F), or (n,) of sets.
    num_landmarks
        Upper bound of m; fewer are used if they explain all rows. With as many as there are rows, ΦΦᵀ is K.
    rng
        Generator that draws the landmarks.
    """
    if not is_count(num_landmarks):
        raise ArgumentError(f"num_landmarks is {num_landmarks!r}; give at least 1")
    most = max(MOST_CANDIDATES, CANDIDATES_A_LANDMARK * num_landmarks)
    candidates = rows[rng.permutation(len(rows))[:most]] if len(rows) > most else rows
    few = candidates[:ROWS_CHECKED]
    checked_gram(kernel, few, few)
    landmarks = candidates[_pivots(kernel, candidates, num_landmarks, rng)]
    return Nystrom(kernel, landmarks, inverse_root(checked_gram(kernel, landmarks, landmarks)))


def _pivots(kernel: Kernel, rows: np.ndarray, num_landmarks: int, rng: np.random.Generator) -> Int[np.ndarray, " m"]:
    """Landmarks among the rows."""
    diagonal = kernel_diagonal(kernel, rows)
    floor = RESIDUAL_TOLERANCE * diagonal.max()
    residual = np.where(diagonal > floor, diagonal, 0.0)
    factor = np.empty((len(rows), min(num_landmarks, len(rows))))
    chosen = np.empty(0, dtype=np.int64)
    while len(chosen) < factor.shape[1] and residual.any():
        done = len(chosen)
        num_proposals = min(MOST_PROPOSALS, PROPOSALS_A_LANDMARK * (factor.shape[1] - done))
        proposals = rng.choice(len(rows), size=num_proposals, p=residual / residual.sum())
        known = factor[proposals, :done]
        schur = kernel(rows[proposals], rows[proposals]) - known @ known.T
        accepted, lower = _accept(schur, residual[proposals], floor, factor.shape[1] - done, rng)
        if len(accepted) == 0:
            # The residual of these rows is only rounding.
            residual[proposals] = 0.0
            continue
        pivots = proposals[accepted]
        columns = kernel(rows, rows[pivots])
        columns -= factor[:, :done] @ factor[pivots, :done].T
        new = slice(done, done + len(pivots))
        factor[:, new] = np.linalg.solve(lower, columns.T).T
        residual -= np.einsum("nk,nk->n", factor[:, new], factor[:, new])
        if residual.min() < -NEGATIVE_TOLERANCE * diagonal.max():
            raise ArgumentError(
                f"landmarks explain more of a row than its k(x, x), by {-residual.min():.3g}; "
                "give a positive semidefinite kernel"
            )
        residual[pivots] = 0.0
        residual[residual <= floor] = 0.0
        chosen = np.concatenate([chosen, pivots])
    return chosen


def _accept(
    schur: Float[np.ndarray, "p p"], drawn_with: Float[np.ndarray, " p"], floor: float, most: int, rng: Any
) -> tuple[Int[np.ndarray, " a"], Float[np.ndarray, "a a"]]:
    """Accept each proposal with probability residual / residual when drawn; return the Cholesky factor, too."""
    left, columns, accepted = schur.copy(), [], []
    uniform = rng.random(len(schur))
    for proposal in range(len(schur)):
        residual = left[proposal, proposal]
        if len(accepted) == most or residual <= max(floor, uniform[proposal] * drawn_with[proposal]):
            continue
        column = left[:, proposal] / np.sqrt(residual)
        left -= np.outer(column, column)
        accepted.append(proposal)
        columns.append(column)
    kept = np.array(accepted, dtype=np.int64)
    lower = np.array(columns).reshape(len(kept), len(schur))[:, kept].T
    return kept, np.tril(lower)


def inverse_root(gram: Float[np.ndarray, "m m"]) -> Float[np.ndarray, "m r"]:
    """R with R Rᵀ = K⁻¹ on the range of K."""
    values, vectors = np.linalg.eigh(gram)
    is_spanned = values > len(values) * np.finfo(np.float64).eps * values.max(initial=0.0)
    return vectors[:, is_spanned] / np.sqrt(values[is_spanned])
