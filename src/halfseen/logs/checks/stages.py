"""What must hold for stages: numbered without gaps, on a clock that runs, completed up to the trajectory's end."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from halfseen.errors import LogError
from halfseen.logs.checks.robots import ROBOT, check_own_rewards, check_robots
from halfseen.logs.columns import (
    CUT,
    NEEDED,
    STAGE_COLUMNS,
    as_counts,
    as_floats,
    as_labels,
    check_covariates,
    is_own_reward,
    refuse_misnamed,
    require_columns,
)
from halfseen.logs.refusal import refuse, shown, value_at
from halfseen.shapes import Bool, Int

UNIT_TOLERANCE = 1e-6
"""How near to a power of 1,000 the ratio of a trajectory's end to its last stage must be to look like another unit."""


@dataclass(frozen=True)
class Layout:
    """Where the rows of the sorted stages stand.

    Parameters
    ----------
    trajectory_row
        Row of trajectories that each stage belongs to, shape (rows,).
    first_row
        Row of stages in which each trajectory begins, shape (n,).
    num_stages
        Number of stages of each trajectory, shape (n,).
    """

    trajectory_row: Int[np.ndarray, " rows"]
    first_row: Int[np.ndarray, " n"]
    num_stages: Int[np.ndarray, " n"]

    @property
    def is_first(self) -> Bool[np.ndarray, " rows"]:
        """True in the first stage of each trajectory."""
        return self._mark(self.first_row)

    @property
    def is_last(self) -> Bool[np.ndarray, " rows"]:
        """True in the last stage of each trajectory."""
        return self._mark(self.first_row + self.num_stages - 1)

    def _mark(self, rows: Int[np.ndarray, " n"]) -> Bool[np.ndarray, " rows"]:
        marks = np.zeros(len(self.trajectory_row), dtype=bool)
        marks[rows] = True
        return marks


def checked_stages(frame: pd.DataFrame, trajectories: pd.DataFrame) -> tuple[pd.DataFrame, Layout]:
    """Bring the stages into order and check them against their trajectories.

    Parameters
    ----------
    frame
        Columns as in `STAGE_COLUMNS`, plus covariates.
    trajectories
        Checked trajectories.

    Returns
    -------
    stages : DataFrame
        Sorted by trajectory and stage.
    layout : Layout
        Where each trajectory's stages stand.

    Raises
    ------
    LogError
        An invariant is broken; the trajectory, the stage, the value and the remedy are named.
    """
    stages = _typed_stages(frame)
    stages, trajectory_row = _sorted_stages(stages, trajectories)
    layout = _checked_layout(stages, trajectory_row, trajectories)
    is_completed = stages["elapsed_s"].notna().to_numpy()
    _check_completion(stages, is_completed, layout, (trajectories["ending"] == CUT).to_numpy(dtype=bool))
    _check_clock(stages, is_completed, layout, trajectories["end_s"].to_numpy())
    check_robots(stages, trajectories, layout.trajectory_row)
    check_own_rewards(stages, is_completed)
    _check_actions(stages, is_completed)
    _check_rewards(stages, is_completed)
    _check_probabilities(stages, is_completed)
    check_covariates("stages", stages, (*STAGE_COLUMNS, *filter(is_own_reward, stages.columns)))
    return stages, layout


def _typed_stages(frame: pd.DataFrame) -> pd.DataFrame:
    require_columns("stages", frame, NEEDED["stages"])
    refuse_misnamed("stages", frame)
    stages = frame.copy()
    if "object" not in stages.columns:
        stages["object"] = pd.Series(None, index=stages.index, dtype=object)
    stages["trajectory"] = as_labels("stages", stages, "trajectory", is_null_allowed=False)
    stages["stage"] = as_counts("stages", stages, "stage")
    numbers = {"elapsed_s", "reward", "probability"} | set(filter(is_own_reward, stages.columns))
    for column in sorted(numbers & set(stages.columns)):
        stages[column] = as_floats("stages", stages, column)
    for column in ("action", "object"):
        stages[column] = as_labels("stages", stages, column, is_null_allowed=True)
    if ROBOT in stages.columns:
        stages[ROBOT] = as_labels("stages", stages, ROBOT, is_null_allowed=False)
    return stages


def _sorted_stages(stages: pd.DataFrame, trajectories: pd.DataFrame) -> tuple[pd.DataFrame, np.ndarray]:
    trajectory_row = pd.Index(trajectories["trajectory"]).get_indexer(pd.Index(stages["trajectory"]))
    refuse(
        stages,
        trajectory_row < 0,
        "trajectories has no such trajectory; add its row to trajectories, or drop its stages",
    )
    number = stages["stage"].to_numpy()
    order = np.lexsort((number, trajectory_row))
    if (order[1:] > order[:-1]).all():
        return stages, trajectory_row
    return stages.iloc[order].reset_index(drop=True), trajectory_row[order]


def _checked_layout(stages: pd.DataFrame, trajectory_row: np.ndarray, trajectories: pd.DataFrame) -> Layout:
    num_stages = np.bincount(trajectory_row, minlength=len(trajectories))
    if (num_stages == 0).any():
        trajectory = trajectories["trajectory"].iloc[int(np.argmax(num_stages == 0))]
        raise LogError(
            f"trajectory {shown(trajectory)}: it has no stage; even a trajectory cut in its first stage has that one, "
            "not completed"
        )
    first_row = np.cumsum(num_stages) - num_stages
    number = stages["stage"].to_numpy()
    repeated = np.zeros(len(stages), dtype=bool)
    repeated[1:] = (number[1:] == number[:-1]) & (trajectory_row[1:] == trajectory_row[:-1])
    refuse(stages, repeated, "the stage is there twice; drop one of the two rows, or renumber them")
    expected = np.arange(len(stages)) - first_row[trajectory_row] + 1
    remedy = "number the stages of a trajectory 1, 2, 3, … without gaps"
    refuse(stages, number != expected, lambda row: f"stage {expected[row]} is missing before it; {remedy}")
    return Layout(trajectory_row, first_row, num_stages)


def _check_completion(stages: pd.DataFrame, is_completed: np.ndarray, layout: Layout, is_cut: np.ndarray) -> None:
    is_cut_stage = layout.is_last & is_cut[layout.trajectory_row]
    refuse(
        stages,
        ~is_completed & ~is_cut_stage,
        "elapsed_s is null, yet only the last stage of a cut trajectory is not completed; give the clock at its end, "
        "or cut the trajectory there",
    )
    refuse(
        stages,
        is_completed & is_cut_stage,
        lambda row: (
            f"elapsed_s {value_at(stages, 'elapsed_s', row)} completes the last stage of a cut trajectory; add the "
            "stage in which the cut fell, with covariates and elapsed_s null, or make the ending 'finished'"
        ),
    )


def _check_clock(stages: pd.DataFrame, is_completed: np.ndarray, layout: Layout, end_s: np.ndarray) -> None:
    clock = stages["elapsed_s"].to_numpy()
    # Where two robots of a team are free at once, the stage between their decisions takes no time.
    may_stand = ROBOT in stages.columns
    early = is_completed & ~(((clock >= 0) if may_stand else (clock > 0)) & np.isfinite(clock))
    refuse(
        stages, early, lambda row: f"elapsed_s {clock[row]} is no time after the trajectory's beginning; fix the clock"
    )
    before = np.concatenate(([0.0], clock[:-1]))

    def unsorted(row: int) -> str:
        word = "is also" if clock[row] == before[row] else "is before"
        what = f"elapsed_s {clock[row]} {word} the {before[row]} of stage {value_at(stages, 'stage', row) - 1}"
        return f"{what}; sort the stages or fix the clock"

    runs = clock >= before if may_stand else clock > before
    refuse(stages, is_completed & ~layout.is_first & ~runs, unsorted)
    ends = end_s[layout.trajectory_row]
    remedy = "fix end_s, or make this the stage in which the trajectory was cut"
    late = is_completed & (clock > ends)
    refuse(stages, late, lambda row: f"elapsed_s {clock[row]} is after the trajectory's end_s {ends[row]}; {remedy}")
    _check_units(stages, layout, clock, ends)


def _check_units(stages: pd.DataFrame, layout: Layout, clock: np.ndarray, ends: np.ndarray) -> None:
    """Refuse a trajectory whose end is exactly a thousand, or a power of it, times its last stage's clock."""
    # A clock that still stands at 0 tells no unit.
    ratio = ends / np.where(clock == 0.0, np.nan, clock)
    with np.errstate(invalid="ignore"):
        thousands = np.log(ratio) / np.log(1000.0)
    mixed = layout.is_last & (np.abs(thousands - np.round(thousands)) < UNIT_TOLERANCE) & (np.round(thousands) > 0)
    refuse(
        stages,
        mixed,
        lambda row: (
            f"end_s {ends[row]} is {1000.0 ** np.round(thousands[row]):.0e} times the elapsed_s {clock[row]} of the "
            "last stage, as if units were mixed; give both in seconds"
        ),
    )


def _check_actions(stages: pd.DataFrame, is_completed: np.ndarray) -> None:
    missing = is_completed & stages["action"].isna().to_numpy()
    refuse(stages, missing, "the stage is completed, yet its action is null; give the action that was taken")


def _check_rewards(stages: pd.DataFrame, is_completed: np.ndarray) -> None:
    reward = stages["reward"].to_numpy()
    missing = is_completed & ~np.isfinite(reward)
    what, remedy = "the stage is completed, yet its reward is", "give the finite reward that it earned"
    refuse(stages, missing, lambda row: f"{what} {reward[row]}; {remedy}")
    early = ~is_completed & ~np.isnan(reward)
    remedy = "is given, yet the stage was not completed; leave it null, or give elapsed_s"
    refuse(stages, early, lambda row: f"reward {reward[row]} {remedy}")


def _check_probabilities(stages: pd.DataFrame, is_completed: np.ndarray) -> None:
    if "probability" not in stages.columns:
        return
    probability = stages["probability"].to_numpy()
    wrong = ~((probability > 0) & (probability <= 1)) & (is_completed | ~np.isnan(probability))
    trouble = "of the logged action is outside (0, 1]; fix it, or leave the column out if it was not logged"
    refuse(stages, wrong, lambda row: f"probability {probability[row]} {trouble}")
