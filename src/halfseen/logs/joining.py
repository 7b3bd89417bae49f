"""Several logs as one."""

from collections.abc import Sequence

import pandas as pd

from halfseen.errors import LogError
from halfseen.logs.logs import Logs


def joined(parts: Sequence[Logs]) -> Logs:
    """Put logs of different paths together.

    Parameters
    ----------
    parts
        At least one; no path is in two of them, and all have objects or none has.

    Raises
    ------
    LogError
        There is none, only some have objects, or a path is in two.
    """
    if not parts:
        raise LogError("there is no log to join; give at least one")
    if len({part.objects is None for part in parts}) > 1:
        raise LogError("only some of the logs have objects; join those that have and those that have none apart")
    tables = [part.tables for part in parts]
    return Logs(**{name: pd.concat([each[name] for each in tables], ignore_index=True) for name in tables[0]})
