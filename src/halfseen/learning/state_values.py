"""V̂ of the states of a part: the largest lower confidence bound of Q among what is possible, or Q of a forced action.

Where a policy is given, V̂ is the mean of Q under it, and has no bound.

The standard errors of Q take longest, and from one backward step to the next their root R most often stays what it was,
but for a factor. So ‖Rᵀ (1, φ)‖ is kept as `Norms` with the R that it is of, and found anew where R is another.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from halfseen.learning.rows import Rows, StateChoices
from halfseen.learning.sums import Successor

ROWS_AT_ONCE = 2_048
"""Rows whose products stay in the cache of a core."""


class Norms(NamedTuple):
    """‖Rᵀ (1, φ)‖ of all that is possible, by block."""

    root: Float[np.ndarray, "K F F"]
    of_block: tuple[Float[np.ndarray, " _"], ...]


def values_of(
    rows: Rows, successor: Successor | None, known: Norms | None = None
) -> tuple[Float[np.ndarray, " R1"], Norms | None]:
    """V̂ of the state of every row that a step asks for, with a last one that is 0; and the norms, for the next step.

    Parameters
    ----------
    rows
        A part of the log.
    successor
        What V̂ is made of; None where it is 0.
    known
        Norms of an earlier step.
    """
    values = np.zeros(len(rows.weight) + 1)
    if successor is None:
        return values, known
    states = rows.span(successor.slices)
    matrices = _matrices(rows, states, len(successor.coefficients))
    q = [matrix @ of_block for matrix, of_block in zip(matrices, successor.coefficients, strict=True)]
    if successor.bound is not None and successor.forced is None and not _has_policy(rows):
        known = _norms(matrices, successor.bound.root, known)
        q = [each - by * norm for each, by, norm in zip(q, successor.bound.margin, known.of_block, strict=True)]
    if rows.choices is None:
        values[states] = _largest_of_shared(rows, states, np.stack(q, axis=1), successor.forced)
    else:
        values[:-1] = _largest_of_choices(rows.choices, len(values) - 1, np.concatenate(q), successor.forced)
    return values, known


def _has_policy(rows: Rows) -> bool:
    return rows.policy is not None or (rows.choices is not None and rows.choices.policy is not None)


def _matrices(rows: Rows, states: slice, num_blocks: int) -> list[Float[np.ndarray, "_ F"]]:
    """1 and φ of what is possible, for each block."""
    if rows.choices is None:
        return [rows.features[states]] * num_blocks
    begin = rows.choices.begin
    return [rows.choices.matrix[first:end] for first, end in pairwise(begin)]


def _norms(matrices: list[Float[np.ndarray, "_ F"]], root: Float[np.ndarray, "K F F"], known: Norms | None) -> Norms:
    found = []
    for block, (matrix, of_block) in enumerate(zip(matrices, root, strict=True)):
        if known is not None and np.array_equal(known.root[block], of_block):
            found.append(known.of_block[block])
            continue
        norm = np.empty(len(matrix))
        for first in range(0, len(matrix), ROWS_AT_ONCE):
            along = matrix[first : first + ROWS_AT_ONCE] @ of_block
            norm[first : first + ROWS_AT_ONCE] = np.sqrt(np.einsum("rf,rf->r", along, along))
        found.append(norm)
    return Norms(root, tuple(found))


def _largest_of_shared(
    rows: Rows, states: slice, q: Float[np.ndarray, "S K"], forced: int | None
) -> Float[np.ndarray, " S"]:
    of_action = q[:, rows.block_of_action] if forced is None else q[:, [rows.block_of_action[forced]]]
    if rows.policy is not None and forced is None:
        policy = rows.policy[states]
        return np.sum(np.where(policy > 0, policy * of_action, 0.0), axis=1)
    if rows.is_possible is None:
        return of_action.max(axis=1)
    possible = rows.is_possible[states] if forced is None else rows.is_possible[states, [forced]][:, None]
    return _or_nothing(np.where(possible, of_action, -np.inf).max(axis=1))


def _largest_of_choices(
    choices: StateChoices, num_rows: int, q: Float[np.ndarray, " C"], forced: int | None
) -> Float[np.ndarray, " R"]:
    if choices.policy is not None and forced is None:
        return np.bincount(choices.row, choices.policy * q, num_rows)
    largest = np.full(num_rows, -np.inf)
    is_asked = slice(None) if forced is None else choices.action == forced
    np.maximum.at(largest, choices.row[is_asked], q[is_asked])
    return _or_nothing(largest)


def _or_nothing(largest: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """0 where nothing is possible."""
    return np.where(np.isneginf(largest), 0.0, largest)
