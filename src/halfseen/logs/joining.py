"""Several logs as one."""

from collections.abc import Sequence
from typing import Any

import pandas as pd
import pyarrow as pa

from halfseen.errors import LogError
from halfseen.logs.columns import common_unit
from halfseen.logs.logs import Logs


def joined(parts: Sequence[Logs]) -> Logs:
    """Put logs of different trajectories together.

    Parameters
    ----------
    parts
        At least one; no trajectory is in two of them, and all have objects or none has.

    Raises
    ------
    LogError
        There is none, only some have objects, a trajectory is in two, or rewards are in two units.
    """
    if not parts:
        raise LogError("there is no log to join; give at least one")
    if len({part.objects is None for part in parts}) > 1:
        raise LogError("only some of the logs have objects; join those that have and those that have none apart")
    tables: Any = {name: _stacked([part.tables[name] for part in parts]) for name in parts[0].tables}
    return Logs(**tables, reward_unit=common_unit(part.reward_unit for part in parts))


def _stacked(frames: list[pd.DataFrame]) -> pa.Table:
    # By Arrow: a column that is null throughout one log has no type there, and takes that of the others.
    tables = [pa.Table.from_pandas(frame, preserve_index=False) for frame in frames]
    return pa.concat_tables(tables, promote_options="permissive")
