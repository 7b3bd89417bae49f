"""Covariates of stages in groups of a few values, for checks that ask what goes with what."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd

from halfseen.arrays import RowIds
from halfseen.logs.logs import Logs
from halfseen.logs.refusal import shown

NUM_GROUPS = 5
MOST_CATEGORIES = 12


@dataclass(frozen=True)
class Grouped:
    """One covariate, in groups.

    Parameters
    ----------
    name
        Of the column.
    group
        Of each row, from 0.
    words
        What each group holds: "below 3", "'red'".
    """

    name: str
    group: RowIds
    words: tuple[str, ...]

    @property
    def num_groups(self) -> int:
        """G."""
        return len(self.words)


def grouped_covariates(logs: Logs, stages: Any) -> Iterator[Grouped]:
    """Group each covariate of some stages: numbers by fifths, or by value where there are few, text by value.

    Parameters
    ----------
    logs
        The log, whose covariates they are.
    stages
        Some of its stages.
    """
    for name in logs.stage_covariates:
        found = grouped(str(name), stages[name])
        if found is not None:
            yield found


def grouped(name: str, values: Any) -> Grouped | None:
    """Group the values of a column; None where there are too many kinds, or one.

    Parameters
    ----------
    name
        Of the column.
    values
        Its values.
    """
    if not values.map(pd.api.types.is_hashable).all():
        return None
    kinds = values.nunique()
    if not pd.api.types.is_numeric_dtype(values.dtype) or kinds <= NUM_GROUPS:
        if not 2 <= kinds <= MOST_CATEGORIES or values.isna().any():
            return None
        code, names = pd.factorize(values, sort=values.dtype != object)
        return Grouped(name, code.astype(np.int64), tuple(shown(each) for each in names))
    numbers = values.to_numpy(dtype=np.float64, na_value=np.nan)
    ends = np.unique(np.nanquantile(numbers, np.arange(1, NUM_GROUPS) / NUM_GROUPS))
    # What lies at an end lies below it: values that many rows share stay together.
    group = np.searchsorted(ends, np.where(np.isnan(numbers), ends[0], numbers), side="left")
    words = [f"{ends[0]:.3g} or less", *(f"{low:.3g} to {high:.3g}" for low, high in pairwise(ends))]
    return Grouped(name, group.astype(np.int64), (*words, f"above {ends[-1]:.3g}"))
