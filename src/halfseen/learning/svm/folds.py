"""Who is held out when: rows that were seen, dealt into folds."""

from typing import Any

import numpy as np
from sklearn.model_selection import KFold, StratifiedKFold, check_cv

from halfseen.arrays import RowIds, Rows
from halfseen.errors import ArgumentError
from halfseen.learning.svm.cross_validation import Fold


def dealt(cv: Any, seen: RowIds, num_rows: int, rng: np.random.Generator, classes: Rows | None = None) -> list[Fold]:
    """Rows fitted to and rows held out, among all rows.

    Parameters
    ----------
    cv
        A number of folds, into which the rows seen are dealt; or a splitter or splits of all rows.
    seen
        Rows of positive weight.
    num_rows
        n.
    rng
        Deals.
    classes
        Class of each row seen, so that each fold gets its share of both.

    Raises
    ------
    ArgumentError
        There are fewer than two folds or rows.
    """
    if not isinstance(cv, (int, np.integer)):
        splitter: Any = check_cv(cv)
        return list(splitter.split(np.zeros(num_rows)))
    if cv < 2:
        raise ArgumentError(f"cv is {cv}; cross-validation needs at least 2 folds")
    if len(seen) < 2:
        raise ArgumentError(
            f"rows are to be held out, and {len(seen)} sample was seen (n_samples = {len(seen)}); give numbers for reg "
            "and gamma, or more rows"
        )
    seed = int(rng.integers(2**31))
    rarest = 0 if classes is None else int(np.unique(classes, return_counts=True)[1].min())
    if rarest >= 2:
        splitter = StratifiedKFold(min(int(cv), rarest), shuffle=True, random_state=seed)
    else:
        splitter = KFold(min(int(cv), len(seen)), shuffle=True, random_state=seed)
    return [(seen[fitted], seen[held]) for fitted, held in splitter.split(seen, classes)]
