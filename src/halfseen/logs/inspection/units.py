"""Units that look mixed: some trajectories in seconds and others in milliseconds, metres beside millimetres.

The sign of it is a gap: two groups of trajectories, far apart, with nothing in between.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from halfseen.arrays import RowMask, Rows
from halfseen.logs.columns import OBJECT_COLUMNS
from halfseen.logs.logs import Logs
from halfseen.logs.refusal import shown

FEWEST_TRAJECTORIES, FEWEST_SHARE = 3, 0.01
GAP, RATIO = 30.0, 300.0
LONG_S = (900.0, 1e6)
"""Beyond a quarter of an hour, below what takes days [s]."""


def mixed_clocks(logs: Logs) -> Iterator[str]:
    """Tell of trajectories whose stages last some thousand times as long as those of others."""
    # The mean of a trajectory, not its shortest stages: some actions take hardly any time.
    clocks = logs.stages.groupby("trajectory")["elapsed_s"]
    duration_s = _per_trajectory(logs, clocks.max() / clocks.count())
    is_long = far_apart(duration_s)
    if is_long is not None:
        yield _told(logs, "stages last", duration_s, is_long, " s") + ": are some clocks in milliseconds?"


def long_clocks(logs: Logs) -> Iterator[str]:
    """Tell of stages that last longer than any robot's."""
    stages: Any = logs.stages
    lasted_s = (stages["elapsed_s"] - stages.groupby("trajectory")["elapsed_s"].shift(fill_value=0.0)).dropna()
    middle_s = float(lasted_s.median()) if len(lasted_s) else 0.0
    if LONG_S[0] < middle_s < LONG_S[1]:
        hours = middle_s / 3600.0
        yield f"half of the stages last {middle_s:,.0f} s or more, which is {hours:.1f} h: are clocks in ms?"


def mixed_covariates(logs: Logs) -> Iterator[str]:
    """Tell of covariates that are some thousand times as large in some trajectories as in others."""
    for name, values, trajectory in covariates(logs):
        if pd.api.types.is_bool_dtype(values.dtype) or not pd.api.types.is_numeric_dtype(values.dtype):
            continue
        size = _per_trajectory(logs, values.astype(float).abs().groupby(trajectory).median())
        is_large = far_apart(size)
        if is_large is not None:
            yield _told(logs, f"{name} is around", size, is_large, "") + ": are its units mixed?"


def covariates(logs: Logs) -> Iterator[tuple[str, Any, Any]]:
    """Each covariate of stages and objects: what to call it, its column, and the trajectory of each row."""
    for name in logs.stage_covariates:
        yield f"covariate {name}", logs.stages[name], logs.stages["trajectory"]
    if logs.objects is not None:
        for name in logs.objects.columns.difference(OBJECT_COLUMNS, sort=False):
            yield f"object covariate {name}", logs.objects[name], logs.objects["trajectory"]


def far_apart(sizes: Rows) -> RowMask | None:
    """Split sizes at their widest gap on the logarithmic scale, if it is wide enough that units may be mixed.

    Parameters
    ----------
    sizes
        One positive size a trajectory; others are left aside.

    Returns
    -------
    RowMask or None
        True for those above the gap; None where there is no such gap.
    """
    usable = np.isfinite(sizes) & (sizes > 0)
    logs = np.sort(np.log(sizes[usable]))
    fewest = max(FEWEST_TRAJECTORIES, int(np.ceil(FEWEST_SHARE * len(logs))))
    if len(logs) < 2 * fewest:
        return None
    gaps = np.diff(logs)[fewest - 1 : len(logs) - fewest]
    split = int(np.argmax(gaps)) + fewest
    ratio = np.median(logs[split:]) - np.median(logs[:split])
    if gaps.max() < np.log(GAP) or ratio < np.log(RATIO):
        return None
    return usable & (sizes >= np.exp((logs[split] + logs[split - 1]) / 2))


def _per_trajectory(logs: Logs, values: Any) -> Rows:
    return values.reindex(logs.trajectory_ids).to_numpy(dtype=np.float64)


def _told(logs: Logs, what: str, sizes: Rows, is_large: RowMask, unit: str) -> str:
    is_small = ~is_large & np.isfinite(sizes) & (sizes > 0)
    small, large = (f"{np.median(sizes[rows]):.3g}{unit}" for rows in (is_small, is_large))
    first = int(np.argmax(is_small if is_small.sum() <= is_large.sum() else is_large))
    return (
        f"{what} {small} in {is_small.sum()} trajectories and {large} in {is_large.sum()} (trajectory "
        f"{shown(logs.trajectory_ids[first])} is of the fewer), with none in between"
    )
