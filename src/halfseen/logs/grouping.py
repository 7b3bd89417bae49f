"""A log in groups: by cause, action, robot and stage; its columns, numbers by fifths and names by name."""

from collections.abc import Iterator
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from halfseen.arrays import RowIds
from halfseen.logs.columns import OBJECT_COLUMNS, ROBOT, shown
from halfseen.logs.logs import Logs

NUM_GROUPS, MOST_CATEGORIES = 5, 12
BEGINNING = 1000
"""Rows that tell of most columns whether they have many kinds."""


class Grouped(NamedTuple):
    """One covariate, in groups."""

    name: str
    group: RowIds
    """Of each row, from 0."""
    words: tuple[str, ...]
    """What each of the G groups holds: "below 3", "'red'"."""

    @property
    def num_groups(self) -> int:
        """G."""
        return len(self.words)


def rows_with(stages: Any, *columns: str, most: int | None = None) -> Any:
    """Stages in which no column is null, the first of them; they are not copied where that is all."""
    rows = np.flatnonzero(np.logical_and.reduce([stages[column].notna().to_numpy() for column in columns]))[:most]
    return stages if len(rows) == len(stages) else stages.iloc[rows]


def grouped_covariates(logs: Logs, stages: Any) -> Iterator[Grouped]:
    """Group each covariate of some of a log's stages."""
    for name in logs.stage_covariates:
        found = grouped(str(name), stages[name])
        if found is not None:
            yield found


def grouped(name: str, values: Any) -> Grouped | None:
    """Group a column: numbers by fifths, or by value where there are few, text by value; None for one or too many."""
    if not can_be_counted(values):
        return None
    # A beginning that has too many kinds answers for all.
    kinds = values.iloc[:BEGINNING].nunique()
    kinds = kinds if kinds > MOST_CATEGORIES else values.nunique()
    if not pd.api.types.is_numeric_dtype(values.dtype) or kinds <= NUM_GROUPS:
        if not 2 <= kinds <= MOST_CATEGORIES or values.isna().any():
            return None
        code, names = pd.factorize(values, sort=not pd.api.types.is_string_dtype(values.dtype))
        return Grouped(name, code.astype(np.int64), tuple(map(shown, names)))
    numbers = values.to_numpy(dtype=np.float64, na_value=np.nan)
    ends = np.unique(np.nanquantile(numbers, np.arange(1, NUM_GROUPS) / NUM_GROUPS))
    # What lies at an end lies below it: values that many rows share stay together.
    group = np.searchsorted(ends, np.where(np.isnan(numbers), ends[0], numbers), side="left")
    words = [f"{ends[0]:.3g} or less", *(f"{low:.3g} to {high:.3g}" for low, high in pairwise(ends))]
    return Grouped(name, group.astype(np.int64), (*words, f"above {ends[-1]:.3g}"))


def covariate_columns(logs: Logs) -> Iterator[tuple[str, Any, Any]]:
    """Each covariate of stages and objects: what to call it, its column, and the trajectory of each row."""
    for name in logs.stage_covariates:
        yield f"covariate {name}", logs.stages[name], logs.stages["trajectory"]
    if logs.objects is not None:
        for name in logs.objects.columns.difference(OBJECT_COLUMNS, sort=False):
            yield f"object covariate {name}", logs.objects[name], logs.objects["trajectory"]


def is_number(values: Any) -> bool:
    """Whether a column holds numbers, and not yes and no."""
    return pd.api.types.is_numeric_dtype(values.dtype) and not pd.api.types.is_bool_dtype(values.dtype)


def can_be_counted(values: Any) -> bool:
    """Whether the values of a column can be told apart and counted: there are no lists and no records among them."""
    is_plain = values.dtype != object or pd.api.types.infer_dtype(values, skipna=True) == "string"
    return is_plain or bool(values.map(pd.api.types.is_hashable).all())


def coded(names: Any) -> tuple[RowIds, np.ndarray]:
    """Number the names of a column without nulls, as text and in its order: the number of each row, and the names."""
    code, kinds = pd.factorize(names)
    words, place = np.unique([str(kind) for kind in kinds], return_inverse=True)
    return place[code].astype(np.int64), words


def is_one_kind(values: Any) -> bool:
    """Whether all values of a column that can be counted are the same, nulls among them."""
    return values.iloc[:BEGINNING].nunique(dropna=False) == 1 == values.nunique(dropna=False)


def by_cause(logs: Logs) -> list[dict[str, Any]]:
    """Describe each cause of a cut, the most frequent first: its trajectories, when they were cut, in which stages.

    Returns
    -------
    list of dict
        cause, num_trajectories, share (proportion of the cuts), earliest, median and latest end [s], first and last
        stage.
    """
    last_stage: Any = logs.stages.groupby("trajectory")["stage"].max()
    cut: Any = logs.trajectories[~logs.is_finished]
    cut = cut.assign(stage=last_stage.reindex(cut["trajectory"]).to_numpy())
    table = cut.groupby("cause").agg(
        num_trajectories=("end_s", "size"),
        earliest_s=("end_s", "min"),
        median_s=("end_s", "median"),
        latest_s=("end_s", "max"),
        first_stage=("stage", "min"),
        last_stage=("stage", "max"),
    )
    return _ranked_rows(table)


def by_action(logs: Logs) -> list[dict[str, Any]]:
    """Describe each action that was completed, the most frequent first: its stages, durations and rewards.

    Returns
    -------
    list of dict
        action, num_stages, share (a proportion of the completed stages), the median duration [s], the mean reward, and
        the mean and the smallest probability with which it was taken, None where that was not logged.
    """
    stages: Any = logs.stages.assign(duration_s=logs.durations_s())[logs.stages["elapsed_s"].notna()]
    table = stages.groupby("action", observed=True).agg(
        num_stages=("reward", "size"), median_s=("duration_s", "median"), mean_reward=("reward", "mean")
    )
    chance: Any = stages.groupby("action", observed=True)["probability"] if "probability" in stages.columns else None
    table["mean_probability"] = None if chance is None else chance.mean()
    table["smallest_probability"] = None if chance is None else chance.min()
    return _ranked_rows(table)


def _ranked_rows(table: Any) -> list[dict[str, Any]]:
    """Rows with their share, the most frequent first; equal ones stand in the order of the names."""
    count = table.columns[0]
    table.insert(1, "share", table[count] / table[count].sum())
    rows = table.set_axis(table.index.map(str)).reset_index().to_dict("records")
    return sorted(rows, key=lambda row: (-row[count], row[table.index.name]))


def by_robot(logs: Logs) -> list[dict[str, Any]]:
    """Count the decisions of each robot of a log of several, in the order of their names.

    Returns
    -------
    list of dict
        robot, num_decisions, share (a proportion of the stages); none where stages do not say which robot decided.
    """
    made = logs.stages[ROBOT].value_counts().sort_index() if ROBOT in logs.stages.columns else pd.Series(dtype=int)
    return [
        {"robot": str(robot), "num_decisions": int(number), "share": int(number) / len(logs.stages)}
        for robot, number in made.items()
    ]


def by_stage(logs: Logs) -> list[dict[str, Any]]:
    """Describe each stage: how many trajectories began and completed it, were cut in it, and how long it took.

    Returns
    -------
    list of dict
        stage, num_begun, num_completed, num_cut, and quantiles (5 %, 50 %, 95 %) of its duration [s], None where no
        trajectory completed it.
    """
    table: list[dict[str, Any]] = []
    stage: Any
    for stage, duration_s in pd.Series(logs.durations_s()).groupby(logs.stages["stage"].to_numpy()):
        took_s: Any = duration_s.dropna()
        low, middle, high = took_s.quantile([0.05, 0.5, 0.95]).tolist() if len(took_s) else (None, None, None)
        counts = {"num_begun": len(duration_s), "num_completed": len(took_s), "num_cut": len(duration_s) - len(took_s)}
        table.append({"stage": int(stage), **counts, "duration_5_s": low, "median_s": middle, "duration_95_s": high})
    return table
