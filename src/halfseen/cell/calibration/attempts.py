"""From the log of a cell to what its laws are fitted to: attempts, labels, and shares of attempts that held.

Attempts of one table are alike. With weights w, outcomes y, predictions q and tables g, the share that held is
p = Σ w y / Σ w. Its standard error is that of p − Σ w q / Σ w, a ratio, by the sums of its residuals over tables;
predictions leave less to chance. So few attempts miss that intervals by a normal law would leave [0, 1]: the interval
is Wilson's [Wilson1927]_ for as many independent attempts as would give that standard error [KornGraubard1998]_, and
never for more than there are tables where all, or none, held. Less the mean prediction, it is the interval of the
difference.
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

FACTS = tuple(each.name for each in fields(Facts))  # what is seen of an object that may make it hard to grip
GLANCES = ("glance_occlusions", "glance_held", "glance_dirty")
HORIZON = 12  # attempts on one table of a calibration, at most
LARGEST_M = 100.0  # of what stands on a table [m]
_AT = ["trajectory", "stage", "object"]


def trials(logs: Logs, horizon: int) -> pd.DataFrame:
    """List every attempt of a cell, cut ones included, with what was seen of its object before.

    Parameters
    ----------
    logs
        Of a cell: objects have `FACTS` and ``attempt_s``, the durations of their past attempts [s].
    horizon
        Stages after which a table ends by itself: nobody wrote down what became of an attempt in the last.

    Returns
    -------
    DataFrame
        As `halfseen.tables.attempts`, with `FACTS` and attempt_s, the time until it was known whether the
        attempt held (NaN where it was cut) [s].

    Raises
    ------
    LogError
        The log is not of a cell, or a fact is none that an object on a table can have.
    """
    table = attempts(logs, horizon)
    assert logs.objects is not None, "attempts are read from logs with objects"
    require_columns("objects", logs.objects, (*FACTS, "attempt_s"))
    for name in (name for name in FACTS if name.endswith("_m")):
        lengths_m = as_floats("objects", logs.objects, name).to_numpy()
        wrong = ~(np.abs(lengths_m) <= LARGEST_M)
        refuse(logs.objects, wrong, lambda row, m=lengths_m, n=name: f"{n} is {m[row]:g}, no length on a table")
    acted_on = pd.DataFrame(logs.stages[_AT])
    seen = acted_on.merge(logs.objects[[*_AT, *FACTS]], on=_AT)
    after = acted_on.assign(stage=acted_on["stage"] + 1).merge(logs.objects[[*_AT, "attempt_s"]], on=_AT)
    after = after.assign(
        stage=after["stage"] - 1, attempt_s=[each[-1] if len(each) else np.nan for each in after["attempt_s"]]
    )
    at = ["trajectory", "stage"]
    table = table.merge(seen.drop(columns="object"), on=at).merge(after.drop(columns="object"), on=at, how="left")
    return table.assign(is_lying=table["is_lying"].astype(np.float64))


def glances(logs: Logs) -> pd.DataFrame:
    """List every object of a log with all its labels, and the true state that was recorded of it.

    Parameters
    ----------
    logs
        Of a cell: objects have `GLANCES` and ``is_dirty``.

    Returns
    -------
    DataFrame
        One row an object of a trajectory: trajectory, object, is_dirty, and the lists `GLANCES` as they were at its
        last stage.

    Raises
    ------
    LogError
        The log is not of a cell, or has no true states.
    """
    if logs.objects is None:
        raise LogError("the log has no objects; give one that a cell recorded")
    require_columns("objects", logs.objects, (*GLANCES, "is_dirty"))
    last = logs.objects.groupby(["trajectory", "object"], sort=True).tail(1)
    return pd.DataFrame(last[["trajectory", "object", "is_dirty", *GLANCES]]).reset_index(drop=True)


LEVEL = 0.95


class Share(NamedTuple):
    """Of some attempts: the weighted share that held with its 95 % interval, and the weighted mean prediction."""

    held: float
    low: float
    high: float
    predicted: float
    num_attempts: int
    num_tables: int

    @property
    def difference(self) -> float:
        """Share that held, less predicted."""
        return self.held - self.predicted


def clustered_share(held: RowMask, predicted: Rows, weight: Rows, tables: Int[np.ndarray, " n"]) -> Share:
    """Give the share that held.

    Parameters
    ----------
    predicted
        Probability that was predicted; any constant where nothing was.
    weight
        1/Ĝ of each.
    """
    total, names = weight.sum(), np.unique(tables)
    # Rounding must not make a share of those that all held.
    share = float(weight @ held / total) if not held.all() else 1.0
    mean, num_tables = float(weight @ predicted / total), len(names)
    if held.any() and not held.all() and num_tables > 1:
        residual = weight * (held - predicted - (share - mean))
        sums = np.bincount(np.searchsorted(names, tables), residual)
        variance = num_tables / (num_tables - 1) * np.sum(sums**2) / total**2
        size = share * (1.0 - share) / max(variance, np.finfo(np.float64).tiny)
        # Attempts that were predicted to the last are as many as there are, not endlessly many.
        size = min(size, float(len(held)))
    else:
        size = float(num_tables)
    low, high = wilson(share, size)
    return Share(share, low, high, mean, len(held), num_tables)


def wilson(share: float, size: float) -> tuple[float, float]:
    """Ends of the 95 % interval of a share of so many independent attempts [Wilson1927]_."""
    z = float(stats.norm.ppf(0.5 + LEVEL / 2))
    middle = (share + z**2 / (2 * size)) / (1 + z**2 / size)
    reach = z / (1 + z**2 / size) * np.sqrt(share * (1 - share) / size + z**2 / (4 * size**2))
    # Rounding must not leave the share outside.
    return min(float(middle - reach), share), max(float(middle + reach), share)


def shares_by(
    groups: Int[np.ndarray, " n"], held: RowMask, predicted: Rows, weight: Rows, tables: Int[np.ndarray, " n"]
) -> dict[int, Share]:
    """Give the share that held in each group of attempts, by its number; empty groups are left out."""
    found: dict[int, Share] = {}
    for group in np.unique(groups):
        rows = groups == group
        found[int(group)] = clustered_share(held[rows], predicted[rows], weight[rows], tables[rows])
    return found


OCCLUSION_EDGES: Float[np.ndarray, " edges"] = np.array([0.0, 0.01, 0.2, 0.4, 0.6, 1.0])
"""Ends of the bins; in the first nothing is hidden, as far as one can see."""


def occlusion_bins(occlusion: Rows) -> Int[np.ndarray, " n"]:
    """Give the number of the bin of each attempt; its lower end belongs to a bin.

    Parameters
    ----------
    occlusion
        Hidden shares in [0, 1].
    """
    return np.searchsorted(OCCLUSION_EDGES[1:-1], occlusion, side="right").astype(np.int64)
