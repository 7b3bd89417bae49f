"""Covariates that say which trajectory or what time it is, and numbers that were read as text.

A policy that goes by the number of a part, or by the clock, meets only values that its log never held.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from halfseen.logs.inspection.units import covariates
from halfseen.logs.logs import Logs
from halfseen.logs.refusal import shown

FEWEST = 30
NEARLY_ALL = 0.99
AS_NUMBER = r"[+-]?(?:\d{1,3}(?:[.,'\u2019 ]\d{3})+(?:[.,]\d+)?|\d+,\d+)"
"""A number with a decimal comma, or with separators of thousands."""


def identifiers(logs: Logs) -> Iterator[str]:
    """Tell of covariates that number the trajectories, or tell the time."""
    if logs.num_trajectories < FEWEST:
        return
    stages: Any = logs.stages
    begun_s = stages.groupby("trajectory")["elapsed_s"].shift(fill_value=0.0)
    for name in logs.stage_covariates:
        values = stages[name]
        is_number = pd.api.types.is_numeric_dtype(values.dtype) and not pd.api.types.is_bool_dtype(values.dtype)
        if not is_number or values.isna().any():
            continue
        values = values.astype(np.float64)
        first = values[stages["stage"] == 1]
        is_counted = (first % 1 == 0).all() and np.ptp(first) < 3.0 * len(first)
        if is_counted and first.nunique() >= NEARLY_ALL * len(first):
            yield f"covariate {name} numbers the trajectories, which tells nothing of the next one: leave it out"
        elif _is_clock(values - values.groupby(stages["trajectory"]).transform("first"), begun_s):
            yield f"covariate {name} runs with the clock, which later trajectories have of their own: leave it out"


def _is_clock(since_first: Any, begun_s: Any) -> bool:
    later = ((begun_s > 0.0) & begun_s.notna()).to_numpy()
    since, seconds = since_first.to_numpy(dtype=np.float64)[later], begun_s.to_numpy(dtype=np.float64)[later]
    if later.sum() < FEWEST or not np.ptp(since) > 0.0 or not np.ptp(seconds) > 0.0:
        return False
    return bool(np.corrcoef(since, seconds)[0, 1] > NEARLY_ALL)


def numbers_as_text(logs: Logs) -> Iterator[str]:
    """Tell of covariates whose text reads as numbers."""
    for name, values, _ in covariates(logs):
        if values.dtype != object and not pd.api.types.is_string_dtype(values.dtype):
            continue
        told = values.dropna()
        if not len(told) or not told.map(lambda each: isinstance(each, str)).all():
            continue
        is_number = told.str.fullmatch(AS_NUMBER)
        if is_number.mean() > 0.5:
            example = shown(told[is_number].iloc[0])
            yield (
                f"{name} is text that reads as numbers, such as {example}, and each is taken for a category: write "
                "them with a decimal point and without separators"
            )
