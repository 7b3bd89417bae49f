"""Squares and products of covariates: what Q, durations and cuts may look at where nobody has said what they look at.

The four models behind a doubly robust value are linear in their features. With the stage and the second-order terms of
the covariates among these, each of them may bend, and stages can share one Q.
"""

from itertools import combinations_with_replacement

import numpy as np
import pandas as pd
from pandas.api.types import is_numeric_dtype

from halfseen.learners.q_learning.named_actions import NamedActions
from halfseen.logs import Logs

PATHS_PER_TERM = 10
"""Second-order terms need as many paths each; where there are fewer, covariates stay as they are."""


def with_second_order(task: NamedActions, logs: Logs) -> tuple[NamedActions, Logs]:
    """Add the stage and second-order terms to what a task looks at, and columns of them to its log."""
    frame: pd.DataFrame = logs.stages
    terms = _terms(frame, [name for name in task.covariates if name != "stage" and is_numeric_dtype(frame[name])])
    if len(terms) * PATHS_PER_TERM > logs.num_paths:
        terms = {}
    names = list(dict.fromkeys([*task.covariates, "stage", *terms]))
    return NamedActions(task.actions, names), Logs(frame.assign(**terms), logs.paths, logs.objects)


def _terms(frame: pd.DataFrame, names: list[str]) -> dict[str, np.ndarray]:
    """Products of standardised covariates; the square of one with two values says nothing new."""
    scaled = {name: _standardised(frame[name].to_numpy(dtype=np.float64, na_value=np.nan)) for name in names}
    pairs = combinations_with_replacement(names, 2)
    wanted = [(a, b) for a, b in pairs if a != b or len(np.unique(scaled[a])) > 2]
    return {f"{a}*{b}": scaled[a] * scaled[b] for a, b in wanted}


def _standardised(values: np.ndarray) -> np.ndarray:
    spread = values.std()
    return (values - values.mean()) / (spread if spread > 0 else 1.0)
