"""The share of attempts that held, with an interval that allows for attempts of one table being alike.

With weights w, outcomes y, predictions q and tables g, the share is p = Σ w y / Σ w. Its standard error is that of
p − Σ w q / Σ w, a ratio, by the sums of its residuals over tables; predictions leave less to chance. So few attempts
miss that intervals by a normal law would leave [0, 1]: the interval is Wilson's [Wilson1927]_ for as many independent
attempts as would give that standard error [KornGraubard1998]_, and never for more than there are tables where all, or
none, held. Less the mean prediction, it is the interval of the difference.
"""

from typing import NamedTuple

import numpy as np
from scipy import stats

from halfseen.arrays import RowMask, Rows
from halfseen.shapes import Int

LEVEL = 0.95


class Share(NamedTuple):
    """Of some attempts."""

    held: float
    """Weighted share that held."""
    low: float
    """Lower end of its 95 % interval."""
    high: float
    """Upper end."""
    predicted: float
    """Weighted mean of what was predicted."""
    num_attempts: int
    """Attempts."""
    num_tables: int
    """Tables that they are of."""

    @property
    def difference(self) -> float:
        """Share that held, less predicted."""
        return self.held - self.predicted


def clustered_share(held: RowMask, predicted: Rows, weight: Rows, tables: Int[np.ndarray, " n"]) -> Share:
    """Give the share that held.

    Parameters
    ----------
    held
        Whether each decided attempt held.
    predicted
        Probability that was predicted; any constant where nothing was.
    weight
        1/Ĝ of each.
    tables
        Number of the table of each.
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
