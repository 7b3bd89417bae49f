"""What the tables of a log looked like: beyond these ranges a policy was taught nothing."""

from typing import TYPE_CHECKING, Any

from halfseen.policies.folder.seen import entry, ranges

if TYPE_CHECKING:
    from halfseen.logs import Logs
else:
    Logs = Any  # Who reads a policy loads no log.

TABLE_RANGES = ("num_objects", "occlusion", "log_odds", "num_attempts")
"""Of a table: objects on it; and of each, its occlusion, its log-odds of DIRTY and its past attempts."""


def seen_tables(logs: Logs) -> list[dict[str, Any]]:
    """Give these ranges over all stages: tables are alike in every stage."""
    import pandas as pd

    from halfseen.world.log_checks import TABLE

    objects: Any = logs.objects
    there = objects[objects["location"] == TABLE]
    tried = there["attempt_occlusions"].map(len)
    each = there[["occlusion", "log_odds"]].assign(num_attempts=tried)
    counts = pd.DataFrame({"num_objects": there.groupby(["trajectory", "stage"]).size()})
    found = ranges(counts, TABLE_RANGES[:1]) | ranges(each, TABLE_RANGES[1:])
    return [entry(1, logs.horizon, logs.num_stages, found)]
