"""Checks for columns that tell nothing of their own: copies of action or reward, dead sensors, marks of no value."""

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
MARKS = {2.0**bits - less for bits in (15, 16, 31, 32, 63, 64) for less in (0.0, 1.0)}
"""Sizes of numbers that stand for no value, besides those of nines such as -999."""
FAR_MARK, FAR = 10.0, 1000.0
"""Least distance of such a number, and of any, from all others, in ranges of these."""
FEWEST_OTHERS, MOST_MARKS = 30, 0.5
"""Least number of other values, and largest share of a suspect one."""


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


def far_values(logs: Logs) -> Iterator[str]:
    """Find a number far from all others of its column: it may stand for no value, or be in another unit."""
    for name, values, _ in covariate_columns(logs):
        for words, _ in _far_from_all(values):
            yield f"{name} is {words}: if that stands for no value, leave it empty, and choose a fill rule (--missing)"
    for words, is_earned in _far_from_all(logs.stages["reward"]):
        if not is_earned:
            yield f"the reward is {words}, and decides what is learned: if it was not earned, mend it or leave it out"


def _far_from_all(values: Any) -> Iterator[tuple[str, bool]]:
    """Describe the least or largest number if it is far from all others; and whether it may be earned repeatedly."""
    if not is_number(values):
        return
    distinct, counts = np.unique(values.dropna().to_numpy(dtype=np.float64), return_counts=True)
    total = int(counts.sum())
    for k, others in ((0, distinct[1:]), (-1, distinct[:-1])):
        if len(others) < 2 or total - counts[k] < FEWEST_OTHERS or counts[k] > MOST_MARKS * total:
            continue
        size, reach = abs(float(distinct[k])), float(np.ptp(others))
        is_mark = size in MARKS or (size > 99.0 and set(f"{size:.15g}") == {"9"})
        times = FAR_MARK if is_mark else FAR
        if np.abs(others - distinct[k]).min() > times * reach:
            where, is_earned = f"{distinct[k]:.6g} in {counts[k]} of {total} rows", not is_mark and bool(counts[k] > 1)
            yield f"{where}, over {times:,.0f} times as far from all others as these are apart", is_earned
