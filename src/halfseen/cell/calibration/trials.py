"""From the log of a cell to what its laws are fitted to: attempts, and what each look told of each object."""

from dataclasses import fields

import numpy as np
import pandas as pd

from halfseen.cell.facts import Facts
from halfseen.errors import LogError
from halfseen.logs import Logs
from halfseen.logs.columns import as_floats, require_columns
from halfseen.logs.refusal import refuse
from halfseen.shapes import Float
from halfseen.tables.grasp_attempts import attempts

FACTS = tuple(each.name for each in fields(Facts))
"""What is seen of an object that may make it hard to grip."""
GLANCES = ("glance_occlusions", "glance_held", "glance_dirty")
LARGEST_M = 100.0
"""Of what stands on a table [m]."""
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
        As `halfseen.tables.grasp_attempts.attempts`, with `FACTS` and attempt_s, the time until it was known whether
        the attempt held (NaN where it was cut) [s].

    Raises
    ------
    LogError
        The log is not of a cell, or a fact is none that an object on a table can have.
    """
    table = attempts(logs, horizon)
    assert logs.objects is not None, "attempts are read from logs with objects"
    require_columns("objects", logs.objects, (*FACTS, "attempt_s"))
    _check_facts(logs.objects)
    acted_on = pd.DataFrame(logs.stages[_AT])
    seen = acted_on.merge(logs.objects[[*_AT, *FACTS]], on=_AT)
    after = acted_on.assign(stage=acted_on["stage"] + 1).merge(logs.objects[[*_AT, "attempt_s"]], on=_AT)
    after = after.assign(stage=after["stage"] - 1, attempt_s=[_last(each) for each in after["attempt_s"]])
    at = ["trajectory", "stage"]
    table = table.merge(seen.drop(columns="object"), on=at).merge(after.drop(columns="object"), on=at, how="left")
    return table.assign(is_lying=table["is_lying"].astype(np.float64))


def _check_facts(objects: pd.DataFrame) -> None:
    for name in (name for name in FACTS if name.endswith("_m")):
        lengths_m = as_floats("objects", objects, name).to_numpy()
        wrong = ~(np.abs(lengths_m) <= LARGEST_M)
        refuse(objects, wrong, lambda row, told=lengths_m, name=name: f"{name} is {told[row]:g}, no length on a table")


def _last(durations_s: list[float] | Float[np.ndarray, " past"]) -> float:
    return float(durations_s[-1]) if len(durations_s) else np.nan


def glances(logs: Logs) -> pd.DataFrame:
    """List every object of a log with all its labels, and the truth that was told of it.

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
        The log is not of a cell, or nobody told the truth.
    """
    if logs.objects is None:
        raise LogError("the log has no objects; give one that a cell recorded")
    require_columns("objects", logs.objects, (*GLANCES, "is_dirty"))
    last = logs.objects.groupby(["trajectory", "object"], sort=True).tail(1)
    return pd.DataFrame(last[["trajectory", "object", "is_dirty", *GLANCES]]).reset_index(drop=True)
