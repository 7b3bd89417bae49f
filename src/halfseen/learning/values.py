"""V̂ of the states that a backward step asks for: the largest Q, or the largest lower confidence bound of Q.

Standard errors of Q take longest, and from one backward step to the next their root R most often stays what it was, but
for a factor. So ‖Rᵀ (1, φ)‖ is kept as `Norms` with the R that it is of, and found anew where R is another.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from halfseen.learning.ridge import Errors
from halfseen.learning.sums import Rows, StateChoices
from halfseen.shapes import Float

ROWS_AT_ONCE = 2_048
"""Rows whose products stay in the cache of a core."""


class Successor(NamedTuple):
    """What V̂(S_{t+1}) is made of."""

    slices: tuple[int, ...]
    """Those that hold S_{t+1}."""
    coefficients: Float[np.ndarray, "K F"]
    errors: Errors | None
    """With pessimism, how far Q is lowered."""
    forced: int | None = None
    """The action that is taken, whatever Q says: the one that the horizon forces upon a trajectory."""


class Norms(NamedTuple):
    """‖Rᵀ (1, φ)‖ of all that is possible, by block."""

    root: Float[np.ndarray, "K F F"]
    of_block: tuple[Float[np.ndarray, " _"], ...]


def values_of(
    rows: Rows, successor: Successor | None, known: Norms | None
) -> tuple[Float[np.ndarray, " R1"], Norms | None]:
    """V̂ of the state of every row that a step asks for, with a last one that is 0; and the norms, for the next step."""
    values = np.zeros(len(rows.reward) + 1)
    if successor is None:
        return values, known
    choices, states, forced = rows.choices, rows.span(successor.slices), successor.forced
    num_features = successor.coefficients.shape[1]
    matrices = [rows.matrix[states, :num_features]] * len(successor.coefficients)
    if choices is not None:
        matrices = [choices.matrix[first:end] for first, end in pairwise(choices.begin)]
    q = [matrix @ of_block for matrix, of_block in zip(matrices, successor.coefficients, strict=True)]
    if successor.errors is not None and rows.policy is None:
        known = _norms(matrices, successor.errors.root, known)
        q = [each - by * norm for each, by, norm in zip(q, successor.errors.deviation, known.of_block, strict=True)]
    if choices is None:
        values[states] = _best_of_shared(rows, states, np.stack(q, axis=1), forced)
    else:
        values[:-1] = _best_of_choices(choices, len(values) - 1, np.concatenate(q), forced)
    return values, known


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


def _best_of_shared(
    rows: Rows, states: slice, q: Float[np.ndarray, "S K"], forced: int | None
) -> Float[np.ndarray, " S"]:
    of_action, possible = q[:, rows.block_of_action], rows.is_possible[states]
    if forced is not None:
        return np.where(possible[:, forced], of_action[:, forced], 0.0)
    if rows.policy is not None:
        policy = rows.policy[states]
        return np.sum(np.where(policy > 0, policy * of_action, 0.0), axis=1)
    return or_nothing(np.where(possible, of_action, -np.inf).max(axis=1))


def _best_of_choices(
    choices: StateChoices, num_rows: int, q: Float[np.ndarray, " C"], forced: int | None
) -> Float[np.ndarray, " R"]:
    if choices.policy is not None and forced is None:
        return np.bincount(choices.row, choices.policy * q, num_rows)
    largest = np.full(num_rows, -np.inf)
    is_asked = slice(None) if forced is None else choices.action == forced
    np.maximum.at(largest, choices.row[is_asked], q[is_asked])
    return or_nothing(largest)


def or_nothing(largest: Float[np.ndarray, "*S"]) -> Float[np.ndarray, "*S"]:
    """0 where nothing is possible."""
    return np.where(np.isneginf(largest), 0.0, largest)
