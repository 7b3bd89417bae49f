"""What a model of the cuts may condition on: covariates of a path as it begins, or of each stage with its action.

Columns that are the same everywhere say nothing of who is cut; whoever fits a model leaves them out.
"""

from collections.abc import Hashable, Sequence
from typing import Any

import numpy as np
import pandas as pd

from halfseen.errors import ArgumentError, LogError
from halfseen.logs import Logs
from halfseen.world.action_space import Verb
from halfseen.world.recording import DISHWASHER

ACTION = "action"
"""Among the names of covariates, this one stands for the action that was taken."""

TABLE_COVARIATES = ("num_objects", "mean_occlusion", ACTION, "target_occlusion")
"""What cuts may depend on at a table."""

_VERBS = tuple(verb.name for verb in Verb)


def flat_covariates(logs: Logs, columns: Sequence[str], actions: Sequence[Hashable]) -> pd.DataFrame:
    """Covariates of every stage of flat actions, and indicators of its action; one row a stage.

    Parameters
    ----------
    logs
        The log.
    columns
        Columns of its stages; ``"action"`` stands for indicators of all actions but the last.
    actions
        Names of the actions.

    Returns
    -------
    DataFrame
        Indicators are NaN where the action is not known.

    Raises
    ------
    LogError
        The log lacks a column.
    ArgumentError
        A column holds no numbers.
    """
    missing = [name for name in columns if name not in logs.stages.columns]
    if missing:
        raise LogError(f"the stages have no column {missing[0]!r}; they have {', '.join(logs.stages.columns)}")
    taken: Any = logs.stages[ACTION]
    parts = [_indicators(taken, actions) if name == ACTION else _numbers(logs.stages, name) for name in columns]
    return pd.concat([pd.DataFrame(index=logs.stages.index), *parts], axis=1)


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
        raise ArgumentError(f"censoring covariate {unknown[0]!r} is none of a table's: {', '.join(TABLE_COVARIATES)}")
    assert logs.objects is not None
    keys = ["path", "stage"]
    there = logs.objects[logs.objects["location"] != DISHWASHER]
    each = there.groupby(keys)["occlusion"]
    of_table = pd.DataFrame({"num_objects": each.size().astype(float), "mean_occlusion": each.mean()}).reset_index()
    stages = logs.stages[[*keys, "object"]]
    known = stages.merge(of_table, on=keys, how="left")
    objects: Any = logs.objects
    targets = objects[[*keys, "object", "occlusion"]].rename(columns={"occlusion": "target_occlusion"})
    known = known.merge(targets, on=[*keys, "object"], how="left").drop(columns=[*keys, "object"]).fillna(0.0)
    parts = [_indicators(logs.stages[ACTION], _VERBS) if name == ACTION else known[[name]] for name in columns]
    return pd.concat(parts, axis=1)


def _numbers(stages: Any, name: str) -> Any:
    if not pd.api.types.is_numeric_dtype(stages[name].dtype):
        raise ArgumentError(f"censoring covariate {name!r} holds no numbers; give indicator columns for its values")
    return stages[[name]].astype(float)


def _indicators(taken: Any, actions: Sequence[Hashable]) -> pd.DataFrame:
    is_unknown = taken.isna().to_numpy()
    columns = {f"action={name}": np.where(is_unknown, np.nan, taken.eq(name).to_numpy(float)) for name in actions[:-1]}
    return pd.DataFrame(columns, index=taken.index)
