"""What must hold for stages: numbered without gaps, on a clock that runs, completed up to the path's end."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from jaxtyping import Bool, Int

from halfseen.errors import LogError
from halfseen.logs.columns import (
    CUT,
    STAGE_COLUMNS,
    as_counts,
    as_floats,
    as_labels,
    check_covariates,
    refuse_misnamed,
    require_columns,
)
from halfseen.logs.refusal import refuse, shown, value_at

UNIT_TOLERANCE = 1e-6
"""How near to a power of 1,000 the ratio of a path's end to its last stage must be to look like another unit."""


@dataclass(frozen=True)
class Layout:
    """Where the rows of the sorted stages stand.

    Parameters
    ----------
    path_row
        Row of paths that each stage belongs to, shape (rows,).
    first_row
        Row of stages in which each path begins, shape (n,).
    num_stages
        Number of stages of each path, shape (n,).
    """

    path_row: Int[np.ndarray, " rows"]
    first_row: Int[np.ndarray, " n"]
    num_stages: Int[np.ndarray, " n"]

    @property
    def is_first(self) -> Bool[np.ndarray, " rows"]:
        """True in the first stage of each path."""
        return self._mark(self.first_row)

    @property
    def is_last(self) -> Bool[np.ndarray, " rows"]:
        """True in the last stage of each path."""
        return self._mark(self.first_row + self.num_stages - 1)

    def _mark(self, rows: Int[np.ndarray, " n"]) -> Bool[np.ndarray, " rows"]:
        marks = np.zeros(len(self.path_row), dtype=bool)
        marks[rows] = True
        return marks


def checked_stages(frame: pd.DataFrame, paths: pd.DataFrame) -> tuple[pd.DataFrame, Layout]:
    """Bring the stages into order and check them against their paths.

    Parameters
    ----------
    frame
        Columns as in `STAGE_COLUMNS`, plus covariates.
    paths
        Checked paths.

    Returns
    -------
    stages : DataFrame
        Sorted by path and stage.
    layout : Layout
        Where each path's stages stand.

    Raises
    ------
    LogError
        An invariant is broken; the path, the stage, the value and the remedy are named.
    """
    stages = _typed_stages(frame)
    stages, path_row = _sorted_stages(stages, paths)
    layout = _checked_layout(stages, path_row, paths)
    is_completed = stages["elapsed_s"].notna().to_numpy()
    _check_completion(stages, is_completed, layout, (paths["ending"] == CUT).to_numpy(dtype=bool))
    _check_clock(stages, is_completed, layout, paths["end_s"].to_numpy())
    _check_actions(stages, is_completed)
    _check_rewards(stages, is_completed)
    _check_probabilities(stages, is_completed)
    check_covariates("stages", stages, STAGE_COLUMNS)
    return stages, layout


def _typed_stages(frame: pd.DataFrame) -> pd.DataFrame:
    require_columns("stages", frame, ("path", "stage", "elapsed_s", "action", "reward"))
    refuse_misnamed("stages", frame)
    stages = frame.copy()
    if "object" not in stages.columns:
        stages["object"] = pd.Series(None, index=stages.index, dtype=object)
    stages["path"] = as_labels("stages", stages, "path", is_null_allowed=False)
    stages["stage"] = as_counts("stages", stages, "stage")
    for column in sorted({"elapsed_s", "reward", "probability"} & set(stages.columns)):
        stages[column] = as_floats("stages", stages, column)
    for column in ("action", "object"):
        stages[column] = as_labels("stages", stages, column, is_null_allowed=True)
    return stages


def _sorted_stages(stages: pd.DataFrame, paths: pd.DataFrame) -> tuple[pd.DataFrame, np.ndarray]:
    path_row = pd.Index(paths["path"]).get_indexer(pd.Index(stages["path"]))
    unknown = path_row < 0
    if unknown.any():
        refuse(stages, unknown, "paths has no such path; add its row to paths, or drop its stages")
    number = stages["stage"].to_numpy()
    order = np.lexsort((number, path_row))
    if (order[1:] > order[:-1]).all():
        return stages, path_row
    return stages.iloc[order].reset_index(drop=True), path_row[order]


def _checked_layout(stages: pd.DataFrame, path_row: np.ndarray, paths: pd.DataFrame) -> Layout:
    num_stages = np.bincount(path_row, minlength=len(paths))
    if (num_stages == 0).any():
        path = paths["path"].iloc[int(np.argmax(num_stages == 0))]
        raise LogError(
            f"path {shown(path)}: it has no stage; even a path cut in its first stage has that one, not completed"
        )
    first_row = np.cumsum(num_stages) - num_stages
    number = stages["stage"].to_numpy()
    repeated = np.zeros(len(stages), dtype=bool)
    repeated[1:] = (number[1:] == number[:-1]) & (path_row[1:] == path_row[:-1])
    if repeated.any():
        refuse(stages, repeated, "the stage is there twice; drop one of the two rows, or renumber them")
    expected = np.arange(len(stages)) - first_row[path_row] + 1
    wrong = number != expected
    if wrong.any():
        row = int(np.argmax(wrong))
        refuse(
            stages,
            wrong,
            f"stage {expected[row]} is missing before it; number the stages of a path 1, 2, 3, … without gaps",
        )
    return Layout(path_row, first_row, num_stages)


def _check_completion(stages: pd.DataFrame, is_completed: np.ndarray, layout: Layout, is_cut: np.ndarray) -> None:
    is_cut_stage = layout.is_last & is_cut[layout.path_row]
    missing = ~is_completed & ~is_cut_stage
    if missing.any():
        refuse(
            stages,
            missing,
            "elapsed_s is null, yet only the last stage of a cut path is not completed; give the clock at its end, or "
            "cut the path there",
        )
    extra = is_completed & is_cut_stage
    if extra.any():
        refuse(
            stages,
            extra,
            f"elapsed_s {value_at(stages, 'elapsed_s', int(np.argmax(extra)))} completes the last stage of a cut path; "
            "add the stage in which the cut fell, with covariates and elapsed_s null, or make the ending 'finished'",
        )


def _check_clock(stages: pd.DataFrame, is_completed: np.ndarray, layout: Layout, end_s: np.ndarray) -> None:
    clock = stages["elapsed_s"].to_numpy()
    early = is_completed & ~((clock > 0) & np.isfinite(clock))
    if early.any():
        refuse(
            stages, early, f"elapsed_s {clock[np.argmax(early)]} is no time after the path's beginning; fix the clock"
        )
    before = np.concatenate(([0.0], clock[:-1]))
    still = is_completed & ~layout.is_first & ~(clock > before)
    if still.any():
        row = int(np.argmax(still))
        word = "is also" if clock[row] == before[row] else "is before"
        what = f"elapsed_s {clock[row]} {word} the {before[row]} of stage {value_at(stages, 'stage', row) - 1}"
        refuse(stages, still, f"{what}; sort the stages or fix the clock")
    ends = end_s[layout.path_row]
    late = is_completed & (clock > ends)
    if late.any():
        row = int(np.argmax(late))
        what = f"elapsed_s {clock[row]} is after the path's end_s {ends[row]}"
        refuse(stages, late, f"{what}; fix end_s, or make this the stage in which the path was cut")
    _check_units(stages, layout, clock, ends)


def _check_units(stages: pd.DataFrame, layout: Layout, clock: np.ndarray, ends: np.ndarray) -> None:
    """Refuse a path whose end is exactly a thousand, or a power of it, times its last stage's clock."""
    with np.errstate(invalid="ignore"):
        thousands = np.log(ends / clock) / np.log(1000.0)
    mixed = layout.is_last & (np.abs(thousands - np.round(thousands)) < UNIT_TOLERANCE) & (np.round(thousands) > 0)
    if mixed.any():
        row = int(np.argmax(mixed))
        times = f"{1000.0 ** np.round(thousands[row]):.0e}"
        what = f"end_s {ends[row]} is {times} times the elapsed_s {clock[row]} of the last stage"
        refuse(stages, mixed, f"{what}, as if units were mixed; give both in seconds")


def _check_actions(stages: pd.DataFrame, is_completed: np.ndarray) -> None:
    missing = is_completed & stages["action"].isna().to_numpy()
    if missing.any():
        refuse(stages, missing, "the stage is completed, yet its action is null; give the action that was taken")


def _check_rewards(stages: pd.DataFrame, is_completed: np.ndarray) -> None:
    reward = stages["reward"].to_numpy()
    missing = is_completed & ~np.isfinite(reward)
    if missing.any():
        value = reward[np.argmax(missing)]
        refuse(
            stages, missing, f"the stage is completed, yet its reward is {value}; give the finite reward that it earned"
        )
    early = ~is_completed & ~np.isnan(reward)
    if early.any():
        value = reward[np.argmax(early)]
        refuse(
            stages, early, f"reward {value} is given, yet the stage was not completed; leave it null, or give elapsed_s"
        )


def _check_probabilities(stages: pd.DataFrame, is_completed: np.ndarray) -> None:
    if "probability" not in stages.columns:
        return
    probability = stages["probability"].to_numpy()
    wrong = ~((probability > 0) & (probability <= 1)) & (is_completed | ~np.isnan(probability))
    if wrong.any():
        value = probability[np.argmax(wrong)]
        what = f"probability {value} of the logged action is outside (0, 1]"
        refuse(stages, wrong, f"{what}; fix it, or leave the column out if it was not logged")
