"""Data for the laws of a cell, from its log: attempts, labels, and the share of attempts that held.

Attempts on one table are correlated. With weights w, outcomes y, predictions q and tables g, the share that held is
p = Σ w y / Σ w. Its standard error is that of p − Σ w q / Σ w, from sums of residuals over tables. Predictions
lower the variance. Few attempts miss, so normal intervals would leave [0, 1]. The interval is Wilson's [Wilson1927]_
for the number of independent attempts with the same standard error [KornGraubard1998]_; if all or none held, that
number is the number of tables. Minus the mean prediction, it is the interval of the difference.
"""

from dataclasses import fields
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy import stats

from halfseen.arrays import RowMask, Rows
from halfseen.cell.facts import Facts
from halfseen.errors import LogError
from halfseen.logs import Logs
from halfseen.logs.columns import as_floats, refuse, require_columns
from halfseen.shapes import Float, Int
from halfseen.tables.grasp_attempts import attempts

FACTS = tuple(each.name for each in fields(Facts))  # visible properties that may make an object hard to grip
GLANCES = ("glance_occlusions", "glance_held", "glance_dirty")
HORIZON = 12  # largest number of attempts on one table of a calibration
LARGEST_M = 100.0  # largest length of an object on a table [m]
_AT = ["trajectory", "stage", "object"]


def trials(logs: Logs, horizon: int) -> pd.DataFrame:
    """List every attempt of a cell, including cut ones, with the facts of its object before the attempt.

    Parameters
    ----------
    logs
        Log of a cell: objects have `FACTS` and ``attempt_s``, the durations of their past attempts [s].
    horizon
        Number of stages after which a table ends by itself; the log has no outcome of an attempt in the last.

    Returns
    -------
    DataFrame
        As `halfseen.tables.attempts`, with `FACTS` and attempt_s, the time until the outcome of the attempt was known
        (NaN if it was cut) [s].

    Raises
    ------
    LogError
        The log is not from a cell, a fact is impossible for an object on a table, or an attempt's time is missing.
    """
    table = attempts(logs, horizon)
    assert logs.objects is not None, "attempts are read from logs with objects"
    require_columns("objects", logs.objects, (*FACTS, "attempt_s"))
    for name in (name for name in FACTS if name.endswith("_m")):
        lengths_m = as_floats("objects", logs.objects, name).to_numpy()
        wrong = ~(np.abs(lengths_m) <= LARGEST_M)
        refuse(
            logs.objects,
            wrong,
            lambda row, m=lengths_m, n=name: f"{n} is {m[row]:g}, not a length on a table; give metres",
        )
    acted_on = pd.DataFrame(logs.stages[_AT])
    seen = acted_on.merge(logs.objects[[*_AT, *FACTS]], on=_AT)
    after = acted_on.assign(stage=acted_on["stage"] + 1).merge(logs.objects[[*_AT, "attempt_s"]], on=_AT)
    after = after.assign(
        stage=after["stage"] - 1, attempt_s=[each[-1] if len(each) else np.nan for each in after["attempt_s"]]
    )
    at = ["trajectory", "stage"]
    table = table.merge(seen.drop(columns="object"), on=at).merge(after.drop(columns="object"), on=at, how="left")
    unknown = table["is_finished"].to_numpy(dtype=bool) & ~(table["attempt_s"].to_numpy(dtype=np.float64) >= 0.0)
    refuse(table, unknown, "attempt_s of the next stage lacks the attempt's time; give the log that the cell recorded")
    return table.assign(is_lying=table["is_lying"].astype(np.float64))


def glances(logs: Logs) -> pd.DataFrame:
    """List every object of a log with all its labels and its recorded true state.

    Parameters
    ----------
    logs
        Log of a cell: objects have `GLANCES` and ``is_dirty``.

    Returns
    -------
    DataFrame
        One row per object of a trajectory: trajectory, object, is_dirty, and the lists `GLANCES` at its last stage.

    Raises
    ------
    LogError
        The log is not from a cell, has no true states, or lists of `GLANCES` differ in length.
    """
    if logs.objects is None:
        raise LogError("the log has no objects; give one that a cell recorded")
    require_columns("objects", logs.objects, (*GLANCES, "is_dirty"))
    last = logs.objects.groupby(["trajectory", "object"], sort=True).tail(1)
    lengths = np.array([[np.size(each) for each in last[name]] for name in GLANCES])
    refuse(
        last,
        (lengths != lengths[0]).any(axis=0),
        f"{', '.join(GLANCES)} have different lengths; give the log that the cell recorded",
    )
    return pd.DataFrame(last[["trajectory", "object", "is_dirty", *GLANCES]]).reset_index(drop=True)


LEVEL = 0.95


class Share(NamedTuple):
    """Weighted share of attempts that held, with its 95 % confidence interval, and the weighted mean prediction."""

    held: float
    low: float
    high: float
    predicted: float
    num_attempts: int
    num_tables: int

    @property
    def difference(self) -> float:
        """Share that held minus the mean prediction."""
        return self.held - self.predicted


def clustered_share(held: RowMask, predicted: Rows, weight: Rows, tables: Int[np.ndarray, " n"]) -> Share:
    """Estimate the share of attempts that held, with attempts clustered by table.

    Parameters
    ----------
    predicted
        Predicted probabilities; any constant if there are none.
    weight
        Censoring weight 1/Ĝ of each attempt.
    """
    total, names = weight.sum(), np.unique(tables)
    # If all held, rounding must not make the share differ from 1.
    share = float(weight @ held / total) if not held.all() else 1.0
    mean, num_tables = float(weight @ predicted / total), len(names)
    if held.any() and not held.all() and num_tables > 1:
        residual = weight * (held - predicted - (share - mean))
        sums = np.bincount(np.searchsorted(names, tables), residual)
        variance = num_tables / (num_tables - 1) * np.sum(sums**2) / total**2
        size = share * (1.0 - share) / max(variance, np.finfo(np.float64).tiny)
        # With perfect predictions, the effective size is the number of attempts, not infinite.
        size = min(size, float(len(held)))
    else:
        size = float(num_tables)
    low, high = wilson(share, size)
    return Share(share, low, high, mean, len(held), num_tables)


def wilson(share: float, size: float) -> tuple[float, float]:
    """Ends of the 95 % interval of a share of `size` independent attempts [Wilson1927]_."""
    z = float(stats.norm.ppf(0.5 + LEVEL / 2))
    middle = (share + z**2 / (2 * size)) / (1 + z**2 / size)
    reach = z / (1 + z**2 / size) * np.sqrt(share * (1 - share) / size + z**2 / (4 * size**2))
    # Rounding must not put the share outside its interval.
    return min(float(middle - reach), share), max(float(middle + reach), share)


def shares_by(
    groups: Int[np.ndarray, " n"], held: RowMask, predicted: Rows, weight: Rows, tables: Int[np.ndarray, " n"]
) -> dict[int, Share]:
    """Estimate the share that held in each group of attempts, by group number; empty groups are left out."""
    found: dict[int, Share] = {}
    for group in np.unique(groups):
        rows = groups == group
        found[int(group)] = clustered_share(held[rows], predicted[rows], weight[rows], tables[rows])
    return found


OCCLUSION_EDGES: Float[np.ndarray, " edges"] = np.array([0.0, 0.01, 0.2, 0.4, 0.6, 1.0])
"""Edges of the bins; in the first, practically nothing is hidden."""


def occlusion_bins(occlusion: Rows) -> Int[np.ndarray, " n"]:
    """Bin number of each attempt; a bin includes its lower edge.

    Parameters
    ----------
    occlusion
        Hidden shares in [0, 1].
    """
    return np.searchsorted(OCCLUSION_EDGES[1:-1], occlusion, side="right").astype(np.int64)
