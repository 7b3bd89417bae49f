"""What must hold for objects: each belongs to a stage, once, and what was acted on is among them."""

import numpy as np
import pandas as pd

from halfseen.logs.checks.stages import Layout
from halfseen.logs.columns import (
    NEEDED,
    OBJECT_COLUMNS,
    as_counts,
    as_labels,
    check_covariates,
    refuse_misnamed,
    require_columns,
)
from halfseen.logs.refusal import refuse, shown, value_at


def checked_objects(
    frame: pd.DataFrame, stages: pd.DataFrame, trajectories: pd.DataFrame, layout: Layout
) -> pd.DataFrame:
    """Bring the objects into order and check them against their stages.

    Parameters
    ----------
    frame
        Columns trajectory, stage, object, plus covariates of each object.
    stages, trajectories, layout
        Checked stages and trajectories, and where they stand.

    Returns
    -------
    DataFrame
        Sorted by trajectory, stage and object.

    Raises
    ------
    LogError
        An invariant is broken; the trajectory, the stage, the object and the remedy are named.
    """
    require_columns("objects", frame, NEEDED["objects"])
    refuse_misnamed("objects", frame)
    objects = frame.copy()
    objects["trajectory"] = as_labels("objects", objects, "trajectory", is_null_allowed=False)
    objects["stage"] = as_counts("objects", objects, "stage")
    objects["object"] = as_labels("objects", objects, "object", is_null_allowed=False)
    stage_row = _stage_rows(objects, trajectories, layout)
    names = pd.Index(objects["object"]).unique().sort_values()
    name = names.get_indexer(pd.Index(objects["object"]))
    order = np.lexsort((name, stage_row))
    if not (order[1:] > order[:-1]).all():
        objects, stage_row, name = objects.iloc[order].reset_index(drop=True), stage_row[order], name[order]
    _check_once(objects, stage_row, name)
    _check_every_stage(stages, stage_row)
    _check_acted_on(stages, stage_row, name, names)
    check_covariates("objects", objects, OBJECT_COLUMNS)
    return objects


def _stage_rows(objects: pd.DataFrame, trajectories: pd.DataFrame, layout: Layout) -> np.ndarray:
    """Find the row of stages that each object belongs to."""
    trajectory_row = pd.Index(trajectories["trajectory"]).get_indexer(pd.Index(objects["trajectory"]))
    trouble = "trajectories has no such trajectory; add its row to trajectories, or drop its objects"
    refuse(objects, trajectory_row < 0, trouble, OBJECT_COLUMNS)
    number, last = objects["stage"].to_numpy(), layout.num_stages[trajectory_row]
    unknown, remedy = (number < 1) | (number > last), "add the stage to stages, or drop its objects"
    refuse(objects, unknown, lambda row: f"the trajectory has stages 1 to {last[row]}; {remedy}", OBJECT_COLUMNS)
    return layout.first_row[trajectory_row] + number - 1


def _check_once(objects: pd.DataFrame, stage_row: np.ndarray, name: np.ndarray) -> None:
    repeated = np.zeros(len(objects), dtype=bool)
    repeated[1:] = (stage_row[1:] == stage_row[:-1]) & (name[1:] == name[:-1])
    refuse(objects, repeated, "the object is there twice; give each object of a stage one row", OBJECT_COLUMNS)


def _check_every_stage(stages: pd.DataFrame, stage_row: np.ndarray) -> None:
    empty = np.bincount(stage_row, minlength=len(stages)) == 0
    remedy = "give the objects that stood there, or leave objects out altogether"
    refuse(stages, empty, f"it has no row in objects; {remedy}")


def _check_acted_on(stages: pd.DataFrame, stage_row: np.ndarray, name: np.ndarray, names: pd.Index) -> None:
    acted_on = stages["object"].notna().to_numpy()
    acted_name = np.full(len(stages), -1)
    acted_name[acted_on] = names.get_indexer(pd.Index(stages["object"][acted_on]))
    there = stage_row * len(names) + name
    absent = acted_on & ((acted_name < 0) | ~np.isin(np.arange(len(stages)) * len(names) + acted_name, there))

    def missing(row: int) -> str:
        others = ", ".join(shown(other) for other in names[name[stage_row == row]])
        what = f"object {shown(value_at(stages, 'object', row))} of the action is not among the objects of that stage"
        return f"{what} ({others}); add its row, or fix the action's object"

    refuse(stages, absent, missing)
