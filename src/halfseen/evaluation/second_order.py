"""Squares and products of covariates: what Q, durations and cuts may look at where nobody has said what they look at.

The four models behind a doubly robust value are linear in their features. With the stage and the second-order terms of
the covariates among these, each of them may bend, and stages can share one Q.
"""

from itertools import combinations_with_replacement

import numpy as np
import pandas as pd

from halfseen.learning.covariates import Covariates
from halfseen.learning.named_task import NamedActions
from halfseen.logs import Logs

TRAJECTORIES_PER_TERM = 10
"""Second-order terms need as many trajectories each; where there are fewer, covariates stay as they are."""


def with_second_order(task: NamedActions, logs: Logs) -> tuple[NamedActions, Logs]:
    """Add the stage and second-order terms to what a task looks at, and columns of them to its log."""
    fitted = task.fitted(logs, logs.horizon)
    terms = _terms(fitted.looks_at, logs.stages)
    if len(terms) * TRAJECTORIES_PER_TERM > logs.num_trajectories:
        terms = {}
    names = list(dict.fromkeys([*task.covariates, "stage", *terms]))
    wider = NamedActions(task.actions, names, fitted.categories)
    return wider, Logs(logs.stages.assign(**terms), logs.trajectories, logs.objects, reward_unit=logs.reward_unit)


def _terms(looks_at: Covariates, frame: pd.DataFrame) -> dict[str, np.ndarray]:
    """Products of standardised covariates; the square of one with two values says nothing new."""
    columns = zip(looks_at.names, looks_at.encode(frame).T, strict=True)
    scaled = {name: _standardised(values) for name, values in columns if name != "stage"}
    pairs = combinations_with_replacement(scaled, 2)
    wanted = [(a, b) for a, b in pairs if a != b or len(np.unique(scaled[a])) > 2]
    return {f"{a}*{b}": scaled[a] * scaled[b] for a, b in wanted}


def _standardised(values: np.ndarray) -> np.ndarray:
    spread = values.std()
    return (values - values.mean()) / (spread if spread > 0 else 1.0)
