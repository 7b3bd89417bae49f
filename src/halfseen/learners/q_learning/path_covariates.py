"""What a model of the cuts may condition on: covariates of a path as they are when it begins.

Columns that are the same for all paths say nothing of who is cut, and are left out: covariates of later stages are
often 0 in the first.
"""

from collections.abc import Sequence

import pandas as pd

from halfseen.errors import ArgumentError, LogError
from halfseen.logs import Logs


def first_covariates(logs: Logs, columns: Sequence[str]) -> pd.DataFrame:
    """Covariates of each path's first stage, in the order of the paths.

    Parameters
    ----------
    logs
        The log.
    columns
        Columns of its stages.

    Raises
    ------
    LogError
        The log lacks a column.
    ArgumentError
        None of them differs between paths.
    """
    missing = [name for name in columns if name not in logs.stages.columns]
    if missing:
        raise LogError(f"the stages have no column {missing[0]!r}; they have {', '.join(logs.stages.columns)}")
    first = logs.stages[logs.stages["stage"] == 1].set_index("path")
    return _that_differ(first.loc[:, list(columns)], logs)


def first_table(logs: Logs) -> pd.DataFrame:
    """Number of objects and mean occlusion of each path's first table.

    Parameters
    ----------
    logs
        A log of tables.

    Raises
    ------
    ArgumentError
        All paths begin with the same table, as far as these two tell.
    """
    assert logs.objects is not None
    first = logs.objects[logs.objects["stage"] == 1].groupby("path")["occlusion"]
    return _that_differ(pd.DataFrame({"num_objects": first.size().astype(float), "mean_occlusion": first.mean()}), logs)


def _that_differ(covariates: pd.DataFrame, logs: Logs) -> pd.DataFrame:
    ordered = covariates.loc[logs.path_ids].reset_index(drop=True)
    names = [name for name in ordered.columns if ordered[name].nunique() > 1]
    if not names:
        raise ArgumentError(
            "censoring uses covariates, and none of those of a path's first stage differs between paths; choose "
            "'kaplan-meier'"
        )
    return ordered.loc[:, names]
