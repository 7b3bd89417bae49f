"""Folds of attempts to grasp: the attempts of one object are never split, and each fold holds both outcomes."""

import numpy as np
import pandas as pd

from halfseen.errors import ArgumentError
from halfseen.tables.grasp_attempts import Decided

FEWEST_OBJECTS = 2
"""Objects that failed, and that succeeded, without which none can be held out."""


def can_hold_out(attempts: pd.DataFrame) -> bool:
    """Say whether either outcome was seen of enough objects to hold some out, as anyone who chooses λ must.

    `attempts` are as `halfseen.tables.grasp_attempts.attempts` gives them.
    """
    decided = attempts[attempts["is_finished"].astype(bool)]
    succeeded = decided["succeeded"].astype(bool)
    return all(decided.loc[rows, "object"].nunique() >= FEWEST_OBJECTS for rows in (succeeded, ~succeeded))


def splits_of(decided: Decided, num_folds: int, random_state: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Deal attempts into folds: for each, which to fit to and which to hold out; an object's attempts stay together.

    Objects are dealt in the order of their success, so that both outcomes are in every fold: at least as many objects
    have either outcome as there are folds, and in this order they are neighbours.

    There are `num_folds`, if so many objects failed and so many succeeded; else as many as did.

    Raises
    ------
    ArgumentError
        There are fewer than 2 folds, or one outcome was seen of one object alone.
    """
    if num_folds < 2:
        raise ArgumentError(f"num_folds is {num_folds}; cross-validation needs at least 2")
    num_objects = [len(np.unique(decided.group[decided.succeeded == outcome])) for outcome in (False, True)]
    if min(num_objects) < FEWEST_OBJECTS:
        word = "failures" if num_objects[0] < FEWEST_OBJECTS else "successes"
        raise ArgumentError(f"{word} were seen of one object alone, so none can be held out; record more objects")
    num_folds = min(num_folds, *num_objects)
    objects, place = np.unique(decided.group, return_inverse=True)
    share = np.bincount(place, decided.succeeded) / np.bincount(place)
    fold = np.empty(len(objects), dtype=np.int64)
    shuffled = np.random.default_rng(random_state).permutation(len(objects))
    fold[np.lexsort((shuffled, share))] = np.arange(len(objects)) % num_folds
    return [(np.flatnonzero(fold[place] != k), np.flatnonzero(fold[place] == k)) for k in range(num_folds)]
