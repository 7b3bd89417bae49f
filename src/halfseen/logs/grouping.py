"""A log grouped by cause, action, robot and stage; and its columns, grouped by quintile or by value."""

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
"""Number of first rows that suffice for most columns to see whether they have many distinct values."""


class Grouped(NamedTuple):
    """One covariate, split into groups."""

    name: str
    group: RowIds
    """Group of each row, from 0."""
    words: tuple[str, ...]
    """Description of each of the G groups: "below 3", "'red'"."""

    @property
    def num_groups(self) -> int:
        """Number of groups G."""
        return len(self.words)


def rows_with(stages: Any, *columns: str, most: int | None = None) -> Any:
    """Stages without null in these columns, at most the first `most`; not copied if those are all stages."""
    rows = np.flatnonzero(np.logical_and.reduce([stages[column].notna().to_numpy() for column in columns]))[:most]
    return stages if len(rows) == len(stages) else stages.iloc[rows]


def grouped_covariates(logs: Logs, stages: Any) -> Iterator[Grouped]:
    """Group each covariate of the given stages of a log."""
    for name in logs.stage_covariates:
        found = grouped(str(name), stages[name])
        if found is not None:
            yield found


def grouped(name: str, values: Any) -> Grouped | None:
    """Group a column: numbers by quintile, or by value if few, text by value; None for one or too many values."""
    if not can_be_counted(values):
        return None
    # If the first rows already have too many distinct values, skip the rest.
    kinds = values.iloc[:BEGINNING].nunique()
    kinds = kinds if kinds > MOST_CATEGORIES else values.nunique()
    if not pd.api.types.is_numeric_dtype(values.dtype) or kinds <= NUM_GROUPS:
        if not 2 <= kinds <= MOST_CATEGORIES or values.isna().any():
            return None
        code, names = pd.factorize(values, sort=not pd.api.types.is_string_dtype(values.dtype))
        return Grouped(name, code.astype(np.int64), tuple(map(shown, names)))
    numbers = values.to_numpy(dtype=np.float64, na_value=np.nan)
    ends = np.unique(np.nanquantile(numbers, np.arange(1, NUM_GROUPS) / NUM_GROUPS))
    # A value at a boundary belongs to the group below, so that equal values stay together.
    group = np.searchsorted(ends, np.where(np.isnan(numbers), ends[0], numbers), side="left")
    words = [f"{ends[0]:.3g} or less", *(f"{low:.3g} to {high:.3g}" for low, high in pairwise(ends))]
    return Grouped(name, group.astype(np.int64), (*words, f"above {ends[-1]:.3g}"))


def covariate_columns(logs: Logs) -> Iterator[tuple[str, Any, Any]]:
    """Each covariate of stages and objects: its name for messages, its column, and the trajectory of each row."""
    for name in logs.stage_covariates:
        yield f"covariate {name}", logs.stages[name], logs.stages["trajectory"]
    if logs.objects is not None:
        for name in logs.objects.columns.difference(OBJECT_COLUMNS, sort=False):
            yield f"object covariate {name}", logs.objects[name], logs.objects["trajectory"]


def is_number(values: Any) -> bool:
    """Whether a column is numeric and not boolean."""
    return pd.api.types.is_numeric_dtype(values.dtype) and not pd.api.types.is_bool_dtype(values.dtype)


def can_be_counted(values: Any) -> bool:
    """Whether the values of a column can be counted: all are hashable, without lists or records."""
    is_plain = values.dtype != object or pd.api.types.infer_dtype(values, skipna=True) == "string"
    return is_plain or bool(values.map(pd.api.types.is_hashable).all())


def coded(names: Any) -> tuple[RowIds, np.ndarray]:
    """Encode the names of a column without nulls: the code of each row, and the names as sorted text."""
    code, kinds = pd.factorize(names)
    words, place = np.unique([str(kind) for kind in kinds], return_inverse=True)
    return place[code].astype(np.int64), words


def is_one_kind(values: Any) -> bool:
    """Whether all values of a countable column are equal, nulls included."""
    return values.iloc[:BEGINNING].nunique(dropna=False) == 1 == values.nunique(dropna=False)


def by_cause(logs: Logs) -> list[dict[str, Any]]:
    """Describe each cause of a cut, most frequent first: its trajectories, when and in which stages they were cut.

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
    """Describe each completed action, most frequent first: its stages, durations and rewards.

    Returns
    -------
    list of dict
        action, num_stages, share (proportion of the completed stages), the median duration [s], the mean reward,
        num_cut (stages of it that were cut), and the mean and smallest logged probability, None if it was not logged.
    """
    num_cut = logs.stages.loc[logs.stages["elapsed_s"].isna(), "action"].value_counts()
    stages: Any = logs.stages.assign(duration_s=logs.durations_s())[logs.stages["elapsed_s"].notna()]
    table = stages.groupby("action", observed=True).agg(
        num_stages=("reward", "size"), median_s=("duration_s", "median"), mean_reward=("reward", "mean")
    )
    table["num_cut"] = num_cut.reindex(table.index, fill_value=0)
    chance: Any = stages.groupby("action", observed=True)["probability"] if "probability" in stages.columns else None
    table["mean_probability"] = None if chance is None else chance.mean()
    table["smallest_probability"] = None if chance is None else chance.min()
    return _ranked_rows(table)


def _ranked_rows(table: Any) -> list[dict[str, Any]]:
    """Rows with their share, most frequent first; ties are ordered by name."""
    count = table.columns[0]
    table.insert(1, "share", table[count] / table[count].sum())
    rows = table.set_axis(table.index.map(str)).reset_index().to_dict("records")
    return sorted(rows, key=lambda row: (-row[count], row[table.index.name]))


def by_robot(logs: Logs) -> list[dict[str, Any]]:
    """Count the decisions of each robot, in the order of their names.

    Returns
    -------
    list of dict
        robot, num_decisions, share (proportion of the stages); empty if stages do not name the robot that decided.
    """
    made = logs.stages[ROBOT].value_counts().sort_index() if ROBOT in logs.stages.columns else pd.Series(dtype=int)
    return [
        {"robot": str(robot), "num_decisions": int(number), "share": int(number) / len(logs.stages)}
        for robot, number in made.items()
    ]


def by_stage(logs: Logs) -> list[dict[str, Any]]:
    """Describe each stage: how many trajectories began it, completed it and were cut in it, and its duration.

    Returns
    -------
    list of dict
        stage, num_begun, num_completed, num_cut, and quantiles (5 %, 50 %, 95 %) of its duration [s], None if no
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
