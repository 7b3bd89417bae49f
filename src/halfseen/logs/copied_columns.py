"""Checks for columns that tell nothing of their own: copies of action or reward, and dead sensors."""

from collections.abc import Iterator
from itertools import groupby
from typing import Any

import numpy as np
import pandas as pd

from halfseen.logs.columns import shown
from halfseen.logs.grouping import can_be_counted, covariate_columns, is_number, is_one_kind, rows_with
from halfseen.logs.logs import Logs

FEWEST_ROWS, FEWEST_STUCK, MOST_REPEATED = 10, 30, 0.02
"""For a copied column and for a sensor that stuck: the least number of rows; and of all other values, the largest share
that repeats the one before."""


def actions_as_covariates(logs: Logs) -> Iterator[str]:
    """Find covariates that name the action of their own stage in every row."""
    stages = rows_with(logs.stages, "action")
    action = stages["action"]
    if len(stages) < FEWEST_ROWS or action.nunique() < 2:
        return
    for name in logs.stage_covariates:
        if is_copy_of(stages[name], action):
            yield (
                f"covariate {name} is the action of its own stage in all {len(stages)} stages, which nobody knew "
                "before: leave it out"
            )


def is_copy_of(values: Any, action: Any) -> bool:
    """Whether a column has the same names or numbers as the actions."""
    if values.isna().any():
        return False
    if is_number(values) and is_number(action):
        return bool((values.to_numpy(dtype=np.float64) == action.to_numpy(dtype=np.float64)).all())
    return not is_number(values) and bool((values.astype(str) == action.astype(str)).all())


def rewards_as_covariates(logs: Logs) -> Iterator[str]:
    """Find a reward that equals another numeric column in every row: it was taken from the wrong column."""
    completed: Any = logs.stages[logs.stages["reward"].notna()]
    if len(completed) < FEWEST_ROWS or completed["reward"].nunique() < 3:
        return
    for name in (*logs.stage_covariates, *("probability",) * ("probability" in completed.columns)):
        if is_number(completed[name]) and (completed[name].astype(float) == completed["reward"]).all():
            yield f"all {len(completed)} rewards equal {name}: was the wrong column taken for the reward?"


def stuck_sensors(logs: Logs) -> Iterator[str]:
    """Find fractions that changed from trajectory to trajectory, and then stayed the same over many."""
    for name, values, trajectory in covariate_columns(logs):
        if not is_number(values) or pd.api.types.is_integer_dtype(values.dtype) or len(values) < 2 * FEWEST_STUCK:
            continue
        # One value a trajectory: within one, a true value may stay.
        is_first, numbers = trajectory.ne(trajectory.shift()).to_numpy(), values.to_numpy(dtype=np.float64)
        runs = [(value, len(list(of))) for value, of in groupby(numbers[is_first].tolist())]
        sizes = np.array([num for _, num in runs])
        k = int(sizes.argmax())
        first, others = int(sizes[:k].sum()), int(sizes.sum() - sizes[k])
        number = np.cumsum(is_first) - 1
        is_own = (number >= first) & (number < first + sizes[k])
        if min(sizes[k], others) < FEWEST_STUCK or not (numbers[is_own] == runs[k][0]).all():
            continue
        if others - (len(runs) - 1) <= MOST_REPEATED * others:
            one, other = (shown(trajectory.to_numpy()[is_own][at]) for at in (0, -1))
            yield (
                f"{name} is {runs[k][0]:.6g} in {sizes[k]} successive trajectories, from {one} to {other}, and differs "
                "from each other one to the next: did the sensor stick?"
            )


def constant_covariates(logs: Logs) -> Iterator[str]:
    """Find covariates with one value in all rows."""
    for name, values, _ in covariate_columns(logs):
        if len(values) < FEWEST_ROWS or not can_be_counted(values) or not is_one_kind(values):
            continue
        # A count that is always 0 is not a dead sensor.
        if not (pd.api.types.is_integer_dtype(values.dtype) and values.iloc[0] == 0):
            yield (
                f"{name} is {shown(values.iloc[0])} in all {len(values)} rows: a dead sensor, or a column to leave out"
            )
