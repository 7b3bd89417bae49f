"""From the log of a table to its attempts, each with how long it was watched."""

from typing import NamedTuple

import numpy as np
import pandas as pd

from halfseen.arrays import RowIds, RowMask, Rows
from halfseen.logs import Logs
from halfseen.tables.grasp.attempts import attempts
from halfseen.world.config import WorldConfig

AT_LIMIT = 0.98
"""An attempt that lasted this share of its limit is at the limit: clocks are rounded."""


class Watched(NamedTuple):
    """Attempts, each as far as it was watched; n of them."""

    path: RowIds
    """Rank of its path in the log."""
    object: RowIds
    """Number of the object; none stands in two paths."""
    occlusion: Rows
    """Hidden share when it began, in [0, 1]."""
    grip: Rows
    """Mean of the object's grip offset."""
    watched_s: Rows
    """Time for which it was watched, without transport: until it held, missed or was cut; at most the limit [s]."""
    is_held: RowMask
    is_missed: RowMask
    """Whether it was seen to miss; what neither held nor missed was cut."""

    def first(self, num_paths: int) -> "Watched":
        """Keep those of the first paths."""
        kept = self.path < num_paths
        return Watched(*(values[kept] for values in self))


def watched(logs: Logs, known: WorldConfig) -> Watched:
    """List all attempts, the cut ones included.

    An attempt comes before its transport. So one that was cut when its stage had lasted c seconds had not ended within
    c − transport_s seconds, and where that is below 0 it tells nothing. A miss that lasted `AT_LIMIT` of the limit or
    more is taken to have lasted the limit.

    Parameters
    ----------
    logs
        As `attempts` reads them; where its objects have a column grip, it is used.
    known
        Of which horizon, transport_s and the limit of an attempt are used.

    Raises
    ------
    LogError
        As `attempts` does.
    """
    table = attempts(logs, known.horizon)
    is_held = table["succeeded"].fillna(False).to_numpy(dtype=bool)
    is_missed = table["is_finished"].to_numpy(dtype=bool) & ~is_held
    limit_s = float(known.grasping.limit_s)
    until_s = np.clip(table["time_s"].to_numpy(dtype=np.float64) - float(known.transport_s), 0.0, limit_s)
    is_timed_out = is_missed & (until_s >= AT_LIMIT * limit_s)
    return Watched(
        path=pd.Index(logs.path_ids).get_indexer(table["path"]).astype(np.int64),
        object=table["object"].to_numpy(dtype=np.int64),
        occlusion=table["occlusion"].to_numpy(dtype=np.float64),
        grip=table["grip"].to_numpy(dtype=np.float64),
        watched_s=np.where(is_timed_out, limit_s, until_s),
        is_held=is_held,
        is_missed=is_missed,
    )
