"""A rule of thumb that is written as a function."""

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from halfseen.errors import ArgumentError
from halfseen.shapes import Float

Decide = Callable[[pd.DataFrame, int], Any]
"""(covariates, stage from 1) → name of an action for each row."""


@dataclass(frozen=True)
class Rule:
    """Takes the action that a function names (a `NamedActionPolicy`).

    Parameters
    ----------
    decide
        Given the covariates of some states, one a row, and their stage (from 1), it names an action for each row.
    actions
        Names that it may give.
    horizon
        Number T of stages.

    Examples
    --------
    >>> def by_weight(parts, stage):
    ...     return np.where(parts["weight_kg"] > 1.5, "parallel", "soft")
    >>> rule = Rule(by_weight, ("parallel", "soft"), horizon=1)
    >>> rule.probabilities(pd.DataFrame({"weight_kg": [2.0, 1.0]}), stage=1)
    array([[1., 0.],
           [0., 1.]])
    """

    decide: Decide
    actions: tuple[Hashable, ...]
    horizon: int

    def probabilities(self, frame: pd.DataFrame, stage: int) -> Float[np.ndarray, "m A"]:
        """1 for the action that the function names.

        Raises
        ------
        ArgumentError
            It does not name one of the actions for each row.
        """
        taken = np.asarray(self.decide(frame, stage), dtype=object)
        if taken.shape != (len(frame),):
            raise ArgumentError(
                f"the rule gave shape {taken.shape} for {len(frame)} rows; give one action for each row"
            )
        code = pd.Index(self.actions, dtype=object).get_indexer(taken)
        if (code < 0).any():
            listed = ", ".join(map(repr, self.actions))
            raise ArgumentError(f"the rule took {taken[code < 0][0]!r}, which is none of its actions {listed}")
        return (code[:, None] == np.arange(len(self.actions))).astype(np.float64)
