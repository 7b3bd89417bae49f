"""Stages of a log one after another, as those of one long path, without those that count for nothing.

A log is padded to T stages a path, and most paths are over, or cut, long before. Where all stages serve one regression
(`recursion`, pooled) it does not matter in which path a row stands, but for what follows it. So each path keeps its
rows up to the last of weight, and the state after that where the path went on; if that is beyond T, an empty row whose
value is 0.
"""

from typing import Any

import numpy as np
from jaxtyping import Bool, Int

from halfseen.learners.q_learning.transitions import Transitions, of_paths

MOST_SPARE = 4
"""At most one row in so many is appended, so that logs of about the same size share one compiled program."""


def packed(log: Transitions, end_action: int | None) -> Transitions:
    """Pack one log; NumPy arrays out.

    Parameters
    ----------
    log
        The log, no batch.
    end_action
        The action that the horizon forces upon a path, as in `recursion.backward`.

    Returns
    -------
    Transitions
        Of one path, with `fold` and `is_longer` of each row, and n in `num_paths`.
    """
    num_paths, horizon = log.action.shape
    row, is_empty = _rows(np.asarray(log.weight) > 0, np.asarray(log.is_last))
    spare = _room(len(row)) - len(row)
    row, is_empty = np.pad(row, (0, spare)), np.pad(is_empty, (0, spare), constant_values=True)

    def pack(leaf: Any) -> np.ndarray:
        values = np.asarray(leaf).reshape(num_paths * horizon, *leaf.shape[2:])[row]
        values[is_empty] = 0
        return values[None]

    fold, stage = np.asarray(log.fold)[row // horizon], row % horizon
    kept = of_paths(pack, log._replace(fold=None))
    is_longer = (stage < horizon - 1) | (kept.action[0] == end_action)
    return kept._replace(fold=fold[None], is_longer=is_longer[None], num_paths=np.asarray(float(num_paths)))


def _rows(
    has_weight: Bool[np.ndarray, "n T"], is_last: Bool[np.ndarray, "n T"]
) -> tuple[Int[np.ndarray, " R"], Bool[np.ndarray, " R"]]:
    """Which rows come one after another, and which of them are empty."""
    num_paths, horizon = has_weight.shape
    length = np.where(has_weight.any(axis=1), horizon - np.argmax(has_weight[:, ::-1], axis=1), 0)
    is_over = (length == 0) | is_last[np.arange(num_paths), length - 1]
    path, stage = np.nonzero(np.arange(horizon + 1) < (length + ~is_over)[:, None])
    is_empty = stage == horizon
    return np.where(is_empty, 0, path * horizon + stage), is_empty


def _room(num_rows: int) -> int:
    step = max(1, (1 << max(num_rows - 1, 1).bit_length()) // (2 * MOST_SPARE))
    return max(64, -(-num_rows // step) * step)
