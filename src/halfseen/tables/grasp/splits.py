"""Folds of attempts for cross-validation: the attempts of one object are never split."""

import numpy as np
import pandas as pd
from jaxtyping import Int

from halfseen.errors import ArgumentError
from halfseen.tables.grasp.inputs import Decided

Splits = list[tuple[np.ndarray, np.ndarray]]
"""Numbers of the attempts that are fitted to, and of those that are held out."""


FEWEST_OBJECTS = 2
"""Objects that failed, and that succeeded, without which none can be held out."""


def can_hold_out(attempts: pd.DataFrame) -> bool:
    """Say whether either outcome was seen of enough objects to hold some out, as whoever chooses λ must.

    Parameters
    ----------
    attempts
        With object, succeeded and is_finished, as `halfseen.tables.grasp.attempts.attempts` gives them.
    """
    decided = attempts[attempts["is_finished"].astype(bool)]
    succeeded = decided["succeeded"].astype(bool)
    return all(decided.loc[rows, "object"].nunique() >= FEWEST_OBJECTS for rows in (succeeded, ~succeeded))


def splits_of(decided: Decided, num_folds: int, random_state: int) -> Splits:
    """Deal attempts into folds, each of which is held out once; an object's attempts stay together.

    Parameters
    ----------
    decided
        The attempts.
    num_folds
        Folds, if so many objects failed and so many succeeded; else as many as did.
    random_state
        Seed.

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
    fold = _dealt(decided, min(num_folds, *num_objects), np.random.default_rng(random_state))
    return [(np.flatnonzero(fold != k), np.flatnonzero(fold == k)) for k in range(int(fold.max()) + 1)]


def _dealt(decided: Decided, num_folds: int, rng: np.random.Generator) -> Int[np.ndarray, " n"]:
    """Fold of each attempt. Objects are dealt in the order of their success, so that both outcomes are in every fold.

    That holds because at least `num_folds` objects have either outcome, and in this order they are neighbours.
    """
    objects, place = np.unique(decided.group, return_inverse=True)
    share = np.bincount(place, decided.succeeded) / np.bincount(place)
    order = np.lexsort((rng.permutation(len(objects)), share))
    fold = np.empty(len(objects), dtype=np.int64)
    fold[order] = np.arange(len(objects)) % num_folds
    return fold[place]
