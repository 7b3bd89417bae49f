"""Checks for mixed units within a log: milliseconds among seconds, or a covariate in two units.

The sign is a gap: two groups of trajectories far apart, with none in between; or a single trajectory a thousand times
as large as all others.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from halfseen.arrays import RowMask, Rows
from halfseen.logs.columns import ROBOT, shown
from halfseen.logs.grouping import covariate_columns, is_number
from halfseen.logs.logs import Logs

FEWEST_APART, FEWEST_SHARE, GAP, RATIO = 3, 0.01, 30.0, 300.0
"""For a group with suspect units: its least number and share, its least gap, and its least ratio of medians."""
FEWEST_OTHERS, MOST_RATIO = 20, 3000.0
"""For single trajectories with suspect units: the least number in all, and the largest ratio to the others."""
FEWEST_OF_ROBOT, RATIO_OF_ROBOTS = 30, 10.0
"""For a robot with a suspect clock: the least number of stages, and the least ratio to the others."""
LONG_S = (900.0, 1e6)
"""Suspiciously long stages: from a quarter of an hour to below 12 days [s]."""


SHORT_S = 1e-3
"""Suspiciously short stages: below a millisecond [s]."""


def mixed_clocks(logs: Logs) -> Iterator[str]:
    """Find trajectories whose stages last about a thousand times as long as those of others."""
    # Use a trajectory's mean, not its shortest stages: some actions take hardly any time.
    clocks = logs.stages.groupby("trajectory")["elapsed_s"]
    mean_s = clocks.max() / clocks.count()
    for words in _apart(logs, "stages last", mean_s, " s"):
        yield f"{words}: {_question(logs, far_apart(mean_s.reindex(logs.trajectory_ids).to_numpy(dtype=np.float64)))}?"
    for trajectory, size_s, others_s in thousandfold_of_others(mean_s):
        yield (
            f"stages of trajectory {shown(trajectory)} last {size_s:.3g} s, about 1,000 times as long as those of all "
            f"others ({others_s:.3g} s): is its clock in milliseconds?"
        )


def _question(logs: Logs, is_large: RowMask | None) -> str:
    """Ask whether clocks start early if in trajectories with large times only the first stage lasts long."""
    lasted_s: Any = pd.Series(logs.durations_s())
    is_own = logs.stages["trajectory"].isin(list(logs.trajectory_ids[is_large])).to_numpy()
    is_first = logs.stages["stage"].to_numpy() == 1
    first_s, later_s, usual_s = (lasted_s[of].median() for of in (is_own & is_first, is_own & ~is_first, ~is_own))
    if usual_s / GAP < later_s < usual_s * GAP:
        return f"do some clocks start {first_s:,.0f} s before the trajectory, as after a shift or in another zone"
    return "are some clocks in milliseconds"


def clocks_of_robots(logs: Logs) -> Iterator[str]:
    """Find robots whose stages last many times as long, or as short, as those of the others, whatever they did."""
    if ROBOT not in logs.stages.columns:
        return
    lasted_s: Any = pd.Series(logs.durations_s())
    for robot in logs.stages[ROBOT].dropna().unique():
        is_own = logs.stages[ROBOT].eq(robot).to_numpy(dtype=bool, na_value=False)
        own_s, others_s = lasted_s[is_own].dropna(), lasted_s[~is_own].dropna()
        if min(len(own_s), len(others_s)) < FEWEST_OF_ROBOT:
            continue
        # Of robots that are free at once, some stages last no time.
        small_s, large_s = sorted((own_s.median(), others_s.median()))
        if 0.0 < small_s * RATIO_OF_ROBOTS <= large_s:
            yield (
                f"stages of robot {shown(robot)} last {own_s.median():.3g} s, and those of all others "
                f"{others_s.median():.3g} s: is its clock right?"
            )


def long_clocks(logs: Logs) -> Iterator[str]:
    """Find logs in which half of the stages last a quarter of an hour or more."""
    lasted_s = logs.durations_s()
    middle_s = 0.0 if np.isnan(lasted_s).all() else float(np.nanmedian(lasted_s))
    if LONG_S[0] < middle_s < LONG_S[1]:
        hours = middle_s / 3600.0
        yield f"half of the stages last {middle_s:,.0f} s or more, which is {hours:.1f} h: are clocks in ms?"


def short_clocks(logs: Logs) -> Iterator[str]:
    """Find logs in which half of the stages last less than a millisecond."""
    lasted_s = logs.durations_s()
    middle_s = SHORT_S if np.isnan(lasted_s).all() else float(np.nanmedian(lasted_s))
    if middle_s < SHORT_S:
        yield f"half of the stages last {middle_s:.2g} s or less: are clocks in days, hours or thousands of seconds?"


def mixed_covariates(logs: Logs) -> Iterator[str]:
    """Find covariates that are about a thousand times as large in some trajectories as in others."""
    for name, values, trajectory in covariate_columns(logs):
        if is_number(values):
            for words in _apart(logs, f"{name} is around", values.astype(float).abs().groupby(trajectory).median()):
                yield f"{words}: are its units mixed?"


def _apart(logs: Logs, what: str, values: Any, unit: str = "") -> Iterator[str]:
    """Describe the two groups of trajectories separated by a gap, if there is such a gap."""
    sizes = values.reindex(logs.trajectory_ids).to_numpy(dtype=np.float64)
    is_large = far_apart(sizes)
    if is_large is None:
        return
    is_small = ~is_large & np.isfinite(sizes) & (sizes > 0)
    small, large = (f"{np.median(sizes[rows]):.3g}{unit}" for rows in (is_small, is_large))
    first = int(np.argmax(is_small if is_small.sum() <= is_large.sum() else is_large))
    yield (
        f"{what} {small} in {is_small.sum()} trajectories and {large} in {is_large.sum()} (trajectory "
        f"{shown(logs.trajectory_ids[first])} is one of the smaller group), with none in between"
    )


def far_apart(sizes: Rows) -> RowMask | None:
    """Which positive sizes lie above the widest gap on the logarithmic scale, if it is wide enough for mixed units."""
    usable = np.isfinite(sizes) & (sizes > 0)
    logs = np.sort(np.log(sizes[usable]))
    fewest = max(FEWEST_APART, int(np.ceil(FEWEST_SHARE * len(logs))))
    if len(logs) < 2 * fewest:
        return None
    gaps = np.diff(logs)[fewest - 1 : len(logs) - fewest]
    split = int(np.argmax(gaps)) + fewest
    ratio = np.median(logs[split:]) - np.median(logs[:split])
    if gaps.max() < np.log(GAP) or ratio < np.log(RATIO):
        return None
    return usable & (sizes >= np.exp((logs[split] + logs[split - 1]) / 2))


def thousandfold_of_others(sizes: Any) -> Iterator[tuple[Any, float, float]]:
    """Positive sizes about a thousand times as large as all others, if too few to form a group.

    Parameters
    ----------
    sizes : Series
        Size of each trajectory.

    Yields
    ------
    tuple
        Name of the trajectory, its size, and the median size of the others.
    """
    ordered = sizes[np.isfinite(sizes) & (sizes > 0)].sort_values()
    most = max(FEWEST_APART, int(np.ceil(FEWEST_SHARE * len(ordered)))) - 1
    gaps = np.diff(np.log(ordered.to_numpy(dtype=np.float64)))[-most:]
    if len(ordered) < FEWEST_OTHERS or not gaps.max() >= np.log(GAP):
        return
    first = len(ordered) - len(gaps) + int(gaps.argmax())
    usual = float(ordered.iloc[:first].median())
    for name, size in ordered.iloc[first:].items():
        if RATIO <= size / usual <= MOST_RATIO:
            yield name, float(size), usual
