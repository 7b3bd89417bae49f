"""Room in the arrays of a log, so that logs of about the same size share one compiled program.

What is compiled depends on the shape of the arrays, and compiling takes longer than fitting a log of usual size. So
paths that count for nothing are appended up to the next power of two; large logs are left as they are.
"""

import numpy as np

from halfseen.learners.q_learning.transitions import AnyArray, Transitions, of_paths

FEWEST_PATHS, MOST_PATHS = 64, 4096
"""Fewer paths than that get room for so many; more get none."""

FEWEST_ROWS, MOST_SPARE = 64, 4
"""Of rows that lie one after another, at most one in so many is appended."""


def with_room(log: Transitions) -> Transitions:
    """Append paths of weight 0, and keep n, by which λ is multiplied.

    Parameters
    ----------
    log
        One log, no batch.
    """
    num_paths = len(log.action)
    kept = of_paths(lambda leaf: padded(leaf, num_paths), log)
    return kept._replace(num_paths=np.asarray(float(num_paths)))


def padded(leaf: AnyArray, num_paths: int) -> np.ndarray:
    """Append zeros to the first axis; NumPy arrays in and out."""
    return np.pad(np.asarray(leaf), [(0, room_for(num_paths) - num_paths), *[(0, 0)] * (leaf.ndim - 1)])


def room_for(num_paths: int) -> int:
    """How many paths the arrays of so many have room for."""
    if num_paths > MOST_PATHS:
        return num_paths
    return max(FEWEST_PATHS, 1 << (num_paths - 1).bit_length())


def room_for_rows(num_rows: int) -> int:
    """How many rows that lie one after another there is room for, where there are so many."""
    step = max(1, (1 << max(num_rows - 1, 1).bit_length()) // (2 * MOST_SPARE))
    return max(FEWEST_ROWS, -(-num_rows // step) * step)
