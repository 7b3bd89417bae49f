"""Stages of a log one after another, as those of one long path, without those that count for nothing.

A log is padded to T stages a path, and most paths are over, or cut, long before. Where all stages serve one regression
(`recursion`, pooled) it does not matter in which path a row stands, but for what follows it. So each path keeps its
rows up to the last of weight, and the state after that where the path went on; if that is beyond T, an empty row whose
value is 0.

Of a state that follows something, what was possible is kept (`Choices`), for V̂ is sought among it at every number of
steps to go. It lies in chunks of one block each, so that each product is with the coefficients of that block alone.
"""

from typing import Any

import numpy as np
from jaxtyping import Bool, Int

from halfseen.learners.q_learning.room import room_for_rows
from halfseen.learners.q_learning.transitions import Choices, Transitions, of_paths

CHUNK = 32
"""Choices in a chunk."""
CHOICES_PER_ROW = 4
"""There is room for a multiple of so many choices a row, so that logs of about the same size share one program."""


def packed(
    log: Transitions, end_action: int | None, block_of_action: Int[np.ndarray, " A"], fewest_rows: int = 0
) -> Transitions:
    """Pack one log; NumPy arrays out.

    Parameters
    ----------
    log
        The log, no batch.
    end_action
        The action that the horizon forces upon a path, as in `recursion.backward`.
    block_of_action
        Which block of coefficients each action uses.
    fewest_rows
        There is room for so many at least: parts of one log with the room of the whole share one program.

    Returns
    -------
    Transitions
        Of one path, with `fold` and `is_longer` of each row, `choices`, and n in `num_paths`.
    """
    num_paths, horizon = log.action.shape
    row, is_empty = _rows(log)
    spare = room_for_rows(max(len(row), fewest_rows)) - len(row)
    row, is_empty = np.pad(row, (0, spare)), np.pad(is_empty, (0, spare), constant_values=True)

    def pack(leaf: Any) -> np.ndarray:
        values = np.asarray(leaf).reshape(num_paths * horizon, *leaf.shape[2:])[row]
        values[is_empty] = 0
        return values[None]

    fold, stage = np.asarray(log.fold)[row // horizon], row % horizon
    features, taken = np.asarray(log.features), np.asarray(log.action)[..., None]
    choices = _choices(log, row, ~is_empty & (stage > 0), block_of_action)
    narrow = log._replace(
        features=features if features.shape[2] == 1 else np.take_along_axis(features, taken[..., None], axis=2),
        is_possible=np.take_along_axis(np.asarray(log.is_possible), taken, axis=2),
        policy=None,
        fold=None,
    )
    kept = of_paths(pack, narrow)
    is_longer = (stage < horizon - 1) | (kept.action[0] == end_action)
    return kept._replace(
        fold=fold[None], is_longer=is_longer[None], choices=choices, num_paths=np.asarray(float(num_paths))
    )


def _choices(
    log: Transitions, row: Int[np.ndarray, " R"], is_state: Bool[np.ndarray, " R"], block_of_action: Any
) -> Choices:
    """What was possible in the states of these rows, in chunks of one block each."""
    num_paths, horizon = log.action.shape

    def by_row(leaf: Any) -> np.ndarray:
        return np.asarray(leaf).reshape(num_paths * horizon, *leaf.shape[2:])

    is_choice = by_row(log.is_possible) if log.policy is None else by_row(log.is_possible) | (by_row(log.policy) > 0)
    at, action = np.nonzero(is_choice[row] & is_state[:, None])
    block = np.asarray(block_of_action)[action]
    in_turn = np.argsort(block, kind="stable")
    num_of_block = np.bincount(block)
    spare = -num_of_block % CHUNK
    place = np.arange(len(at)) + np.repeat(np.cumsum(spare) - spare, num_of_block)
    step = CHOICES_PER_ROW * len(row)
    room = max(1, -(-(len(at) + int(spare.sum())) // step)) * step

    def spread(values: np.ndarray, empty: float | int) -> np.ndarray:
        filled = np.full(room, empty, values.dtype)
        filled[place] = values[in_turn]
        return filled.reshape(-1, CHUNK)

    features = by_row(log.features)
    return Choices(
        features=features[spread(row[at], 0), spread(np.minimum(action, features.shape[1] - 1), 0)],
        action=spread(action, 0),
        row=spread(at, len(row)),
        policy=None if log.policy is None else spread(by_row(log.policy)[row[at], action], 0.0),
    )


def num_rows(log: Transitions) -> int:
    """How many rows a log has once it is packed, without the room for more."""
    return len(_rows(log)[0])


def _rows(log: Transitions) -> tuple[Int[np.ndarray, " R"], Bool[np.ndarray, " R"]]:
    """Which rows come one after another, and which of them are empty."""
    has_weight, is_last = np.asarray(log.weight) > 0, np.asarray(log.is_last)
    num_paths, horizon = has_weight.shape
    length = np.where(has_weight.any(axis=1), horizon - np.argmax(has_weight[:, ::-1], axis=1), 0)
    is_over = (length == 0) | is_last[np.arange(num_paths), length - 1]
    path, stage = np.nonzero(np.arange(horizon + 1) < (length + ~is_over)[:, None])
    is_empty = stage == horizon
    return np.where(is_empty, 0, path * horizon + stage), is_empty
