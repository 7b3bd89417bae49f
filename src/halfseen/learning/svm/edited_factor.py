"""Solve (K_AA + diag ρ) x = r for sets A of rows that change little from one Newton step to the next.

The Cholesky factor of one set serves the sets near it. A row that joins is a border of the system; a row that leaves
is held at 0 by a multiplier. With m such rows that takes 2 m |A|² operations instead of |A|³ / 3, and each of their
columns is worked out once for all sets that follow (the block matrix inversion by Schur complement [Hager1989]_).
"""

from dataclasses import dataclass, field

import numpy as np
import scipy.linalg
from jaxtyping import Float, Int

from halfseen.workers.threads import one_thread

Ids = Int[np.ndarray, " a"]
OfIds = Float[np.ndarray, " a"]
"""Some of the rows, by their number and rising; and a number of each."""

FEWEST_ROWS = 400
"""Smaller systems are factored anew: that takes no longer than to look what has changed."""
MOST_NEW, MOST_KNOWN = 1 / 8, 1 / 3
"""Shares of a set whose columns are worked out at once, and are held in all, before it is factored anew."""
SMALL_RESIDUAL = 1e-11
"""What a solution may miss, as a share of the right side; where it misses more, the set is factored anew."""
_JITTER = 1e-13


@dataclass
class _Base:
    """A set that was factored, and the columns of rows that joined or left it."""

    rows: Ids
    ridge: OfIds
    factor: Float[np.ndarray, "a a"]
    jitter: float
    place: Int[np.ndarray, " n"]
    """Of each row in the set; −1 where it is not."""
    border: Float[np.ndarray, "m a"]
    """B, one row for each edit: of one that joined its kernel with the set, of one that left its unit vector."""
    columns: Float[np.ndarray, "a m"]
    """S⁻¹ Bᵀ."""
    product: Float[np.ndarray, "m m"]
    """B S⁻¹ Bᵀ."""
    number: dict[int, int] = field(default_factory=dict)
    """Of each edit among them, by its row."""


class EditedFactor:
    """Solves for one set after the other.

    Parameters
    ----------
    gram
        K, of all rows.
    """

    def __init__(self, gram: Float[np.ndarray, "n n"]) -> None:
        self._gram = gram
        self._base: _Base | None = None

    def solve(self, rows: Ids, ridge: OfIds, right: Float[np.ndarray, "a k"]) -> Float[np.ndarray, "a k"]:
        """Solve for one set; a direction that its system does not see gets as much curvature as rounding has.

        Parameters
        ----------
        rows
            A, rising.
        ridge
            ρ of each of them, > 0.
        right
            r, one column for each system.
        """
        if len(rows) < FEWEST_ROWS:
            return scipy.linalg.cho_solve((_base_of(self._gram, rows, ridge).factor, True), right, check_finite=False)
        if self._base is not None and _is_near(self._base, rows, ridge):
            # Many products of a few columns, in which a second thread would be waited for longer than it helps.
            with one_thread():
                solved = self._edited(self._base, rows, ridge, right)
            if solved is not None:
                return solved
        self._base = None  # so that two factors are never held at once
        self._base = _base_of(self._gram, rows, ridge)
        return scipy.linalg.cho_solve((self._base.factor, True), right, check_finite=False)

    def _edited(
        self, base: _Base, rows: Ids, ridge: OfIds, right: Float[np.ndarray, "a k"]
    ) -> Float[np.ndarray, "a k"] | None:
        """Solve by the factor of a set near this one; None if that is not exact enough."""
        place = base.place[rows]
        joined, kept = rows[place < 0], place[place >= 0]
        left = base.rows[np.setdiff1d(np.arange(len(base.rows)), kept, assume_unique=True)]
        self._add(base, joined, left)
        edits = np.array([base.number[row] for row in (*joined.tolist(), *left.tolist())], dtype=np.int64)
        corner = -base.product[np.ix_(edits, edits)]
        corner[: len(joined), : len(joined)] += self._gram[np.ix_(joined, joined)]
        corner[np.arange(len(joined)), np.arange(len(joined))] += ridge[place < 0] + base.jitter
        complement = scipy.linalg.lu_factor(corner, check_finite=False)

        def once(wanted: Float[np.ndarray, "a k"]) -> Float[np.ndarray, "a k"]:
            of_base = np.zeros((len(base.rows), wanted.shape[1]))
            of_base[kept] = wanted[place >= 0]
            alone = scipy.linalg.cho_solve((base.factor, True), of_base, check_finite=False)
            of_edits = np.zeros((len(edits), wanted.shape[1]))
            of_edits[: len(joined)] = wanted[place < 0]
            edited = np.zeros((len(base.number), wanted.shape[1]))
            edited[edits] = scipy.linalg.lu_solve(complement, of_edits - (base.border @ alone)[edits])
            solved = np.empty_like(wanted)
            solved[place >= 0] = (alone - base.columns @ edited)[kept]
            solved[place < 0] = edited[edits[: len(joined)]]
            return solved

        def missed(solved: Float[np.ndarray, "a k"]) -> Float[np.ndarray, "a k"]:
            return right - self._product(rows, ridge + base.jitter, solved)

        least = SMALL_RESIDUAL * np.abs(right).max(axis=0)
        solved = once(right)
        rest = missed(solved)
        if (np.abs(rest).max(axis=0) <= least).all():
            return solved
        solved += once(rest)
        return solved if (np.abs(missed(solved)).max(axis=0) <= least).all() else None

    def _add(self, base: _Base, joined: Int[np.ndarray, " j"], left: Int[np.ndarray, " l"]) -> None:
        """Work out what rows take that joined or left for the first time."""
        joined, left = (
            np.array([row for row in some.tolist() if row not in base.number], dtype=np.int64)
            for some in (joined, left)
        )
        num_known, num_new = len(base.number), len(joined) + len(left)
        if num_new == 0:
            return
        border = np.zeros((num_new, len(base.rows)))
        border[: len(joined)] = self._gram[np.ix_(joined, base.rows)]
        border[len(joined) + np.arange(len(left)), base.place[left]] = 1.0
        columns = scipy.linalg.cho_solve((base.factor, True), border.T, check_finite=False)
        product = np.empty((num_known + num_new, num_known + num_new))
        product[:num_known, :num_known] = base.product
        product[:num_known, num_known:] = base.border @ columns
        product[num_known:, :num_known] = product[:num_known, num_known:].T
        product[num_known:, num_known:] = border @ columns
        base.border = np.concatenate([base.border, border])
        base.columns = np.concatenate([base.columns, columns], axis=1)
        base.product = product
        base.number |= {row: num_known + k for k, row in enumerate((*joined.tolist(), *left.tolist()))}

    def _product(self, rows: Ids, ridge: OfIds, solved: Float[np.ndarray, "a k"]) -> Float[np.ndarray, "a k"]:
        """(K_AA + diag ρ) x: of all rows, as to gather those of A takes longer."""
        product = ridge[:, None] * solved
        for k in range(solved.shape[1]):
            of_all = np.zeros(len(self._gram))
            of_all[rows] = solved[:, k]
            product[:, k] += (self._gram @ of_all)[rows]
        return product


def _is_near(base: _Base, rows: Ids, ridge: OfIds) -> bool:
    """Whether the ridge of what stayed is the same, and not too much has joined or left by now."""
    place = base.place[rows]
    stays = place >= 0
    if (ridge[stays] != base.ridge[place[stays]]).any():
        return False
    left = np.setdiff1d(base.rows, rows, assume_unique=True)
    num_new = sum(row not in base.number for row in (*rows[~stays].tolist(), *left.tolist()))
    num_known = len(base.number) + num_new
    return num_new <= MOST_NEW * len(base.rows) and num_known <= MOST_KNOWN * len(base.rows)


def _base_of(gram: Float[np.ndarray, "n n"], rows: Ids, ridge: OfIds) -> _Base:
    system = gram[np.ix_(rows, rows)] if len(rows) < len(gram) else gram.copy()
    system[np.diag_indices_from(system)] += ridge
    factor, jitter = factored(system)
    place = np.full(len(gram), -1)
    place[rows] = np.arange(len(rows))
    size = len(rows)
    return _Base(
        rows, ridge, factor, jitter, place, np.zeros((0, size)), np.zeros((size, 0), order="F"), np.zeros((0, 0))
    )


def factored(system: Float[np.ndarray, "k k"]) -> tuple[Float[np.ndarray, "k k"], float]:
    """Factor a positive semidefinite system, which is changed, and tell what was added to its diagonal for that."""
    jitter, added = _JITTER * system.diagonal().max(initial=0.0), 0.0
    while True:
        try:
            return scipy.linalg.cho_factor(system, lower=True, overwrite_a=False, check_finite=False)[0], added
        except np.linalg.LinAlgError:
            system[np.diag_indices_from(system)] += jitter
            jitter, added = 100.0 * jitter, added + jitter
