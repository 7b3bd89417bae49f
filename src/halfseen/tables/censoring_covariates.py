"""What the cuts of a table may depend on: what stands on it, what is done, and to which object."""

from collections.abc import Sequence
from typing import Any

import pandas as pd

from halfseen.errors import ArgumentError
from halfseen.learning.named_task import action_indicators
from halfseen.learning.task import ACTION
from halfseen.logs import Logs
from halfseen.suggestions import did_you_mean
from halfseen.world.actions import Verb
from halfseen.world.log_checks import TABLE

TABLE_COVARIATES = ("num_objects", "mean_occlusion", ACTION, "target_occlusion")
"""All of them; the first two are known as a path begins."""

NUM_AT_BEGIN = 2

_VERBS = tuple(verb.name for verb in Verb)


def table_covariates(logs: Logs, columns: Sequence[str]) -> pd.DataFrame:
    """What cuts may depend on at a table; one row a stage.

    Parameters
    ----------
    logs
        A log of tables.
    columns
        Among `TABLE_COVARIATES`: ``num_objects`` and ``mean_occlusion`` are of what stands on the table, ``action`` is
        the verb, and ``target_occlusion`` the occlusion of the object that it is applied to, 0 if none.

    Raises
    ------
    ArgumentError
        A column is none of these.
    """
    unknown = [name for name in columns if name not in TABLE_COVARIATES]
    if unknown:
        known = ", ".join(TABLE_COVARIATES) + did_you_mean(unknown[0], TABLE_COVARIATES)
        raise ArgumentError(f"censoring covariate {unknown[0]!r} is none of a table's: {known}")
    assert logs.objects is not None
    keys = ["path", "stage"]
    there = logs.objects[logs.objects["location"] == TABLE]
    each = there.groupby(keys)["occlusion"]
    of_table = pd.DataFrame({"num_objects": each.size().astype(float), "mean_occlusion": each.mean()}).reset_index()
    stages = logs.stages[[*keys, "object"]]
    known = stages.merge(of_table, on=keys, how="left")
    objects: Any = logs.objects
    targets = objects[[*keys, "object", "occlusion"]].rename(columns={"occlusion": "target_occlusion"})
    known = known.merge(targets, on=[*keys, "object"], how="left").drop(columns=[*keys, "object"]).fillna(0.0)
    parts = [action_indicators(logs.stages[ACTION], _VERBS) if name == ACTION else known[[name]] for name in columns]
    return pd.concat([known[[]], *parts], axis=1)
