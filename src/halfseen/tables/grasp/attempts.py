"""From the log of a table, of any number of robots, to the attempts to grasp that it holds, the cut ones included."""

from typing import NamedTuple

import numpy as np
import pandas as pd

from halfseen.errors import LogError
from halfseen.learning.rows import stage_places
from halfseen.logs import Logs
from halfseen.logs.columns import refuse, require_columns, shown
from halfseen.shapes import Bool, Float, Int
from halfseen.world.actions import TARGETED, Verb
from halfseen.world.log_checks import checked_tables, robots_in
from halfseen.world.log_rows import FREE, OUT, PARKED

ATTEMPT_VERBS = tuple(verb.name for verb in TARGETED)
_KEY = ["trajectory", "stage", "object"]
_HISTORY = ["occlusion", "successes", "failures"]
_COLUMNS = [*_KEY, "occlusion", "grip", "successes", "failures", "succeeded", "time_s", "is_finished"]


def attempts(logs: Logs, horizon: int | None = None) -> pd.DataFrame:
    """List every attempt to WASH or LIFT (any verb with a target) whose end, or cut, was seen.

    An attempt lasts until its robot decides again, or is free to. Whether it succeeded shows in the object's counts
    then. After the last stage of a trajectory there are none: a WASH that ends a trajectory before the horizon has
    cleared the table, so it succeeded. Of an attempt in stage `horizon`, and of several robots of one's last decision,
    nobody wrote down what became of it; those attempts are left out, cut ones too. That depends on the number of the
    decision alone, and so it biases nothing. So is an attempt that was cut the moment it began: it was watched for 0 s.
    What a robot was at when it dropped out was cut.

    Parameters
    ----------
    logs
        A log with objects: columns occlusion, successes, failures, and grip if there is one.
    horizon
        Stages after which a trajectory of one robot ends by itself; by default the stages of the longest trajectory.

    Returns
    -------
    DataFrame
        One row an attempt, sorted by trajectory and stage: trajectory, stage, object (a number for each object of each
        trajectory), occlusion, grip (0 where the log has none), successes and failures (before the attempt), succeeded
        (null where cut), time_s (duration watched, transport included [s]) and is_finished (False where cut); and robot
        where there are several.

    Raises
    ------
    LogError
        The log has no objects or lacks one of their columns, or the outcome of an attempt cannot be told.
    """
    objects, stages = _checked_objects(logs), logs.stages
    if robots_in(logs):
        checked_tables(logs, is_team=True)
    ends, is_clear = _ends(logs), logs.is_finished[stage_places(logs)[0]] & (stages["action"] == Verb.WASH.name)
    rows = stages.assign(time_s=ends.after_s, next=ends.stage, is_last=_is_last(logs, horizon), is_clear=is_clear)
    rows = rows[stages["action"].isin(ATTEMPT_VERBS)].merge(objects, on=_KEY, how="left", validate="one_to_one")
    _refuse(rows, rows["occlusion"].isna().to_numpy(), "the object is not listed in this stage; list it in objects")
    rows = pd.DataFrame(rows[~rows["is_last"] & (rows["time_s"] > 0)]).reset_index(drop=True)
    at_end = rows[_KEY].assign(stage=rows["next"]).merge(objects, on=_KEY, how="left")
    succeeded = (_of_team if robots_in(logs) else _of_one)(rows, at_end[_HISTORY[1:]].to_numpy(dtype=np.float64))
    codes = rows.groupby(["trajectory", "object"], sort=False).ngroup()
    table = rows.assign(succeeded=succeeded, is_finished=succeeded.notna(), object=codes)
    return pd.DataFrame(table[[*_COLUMNS, *(["robot"] if robots_in(logs) else [])]])


def _checked_objects(logs: Logs) -> pd.DataFrame:
    if logs.objects is None:
        raise LogError("objects: the log has none; attempts are read from logs with an objects table")
    require_columns("objects", logs.objects, _HISTORY)
    known = pd.DataFrame(logs.objects[[*_KEY, *_HISTORY]])
    return known.assign(grip=logs.objects["grip"] if "grip" in logs.objects.columns else 0.0)


class _Ends(NamedTuple):
    """Where what was begun in each stage came to its end."""

    stage: Int[np.ndarray, " rows"]
    """The first later one in which the robot is free; 0 where there is none, −1 where it had dropped out by then."""
    after_s: Float[np.ndarray, " rows"]
    """From the begin of the stage until then, or until the trajectory ended or the robot dropped out [s]."""


def _ends(logs: Logs) -> _Ends:
    stages, (trajectory, stage) = logs.stages, stage_places(logs)
    row, elapsed_s = np.arange(len(stages)), stages["elapsed_s"].to_numpy(dtype=np.float64, na_value=np.nan)
    begun_s = np.where(stage == 0, 0.0, np.roll(elapsed_s, 1))
    end, robot = row + 1, stages["robot"].to_numpy() if robots_in(logs) else np.zeros(len(row))
    until_s = np.where(np.isnan(elapsed_s), logs.end_s[trajectory], elapsed_s)[
        np.searchsorted(trajectory, trajectory, side="right") - 1
    ]
    is_out = np.zeros(len(row), dtype=bool)
    for k in range(robots_in(logs)):
        is_idle = np.append(stages[f"{k}_does"].isin([FREE, PARKED, OUT]).to_numpy(), True)
        next_idle = np.flatnonzero(is_idle)[np.searchsorted(np.flatnonzero(is_idle), row, side="right")]
        end = np.where(robot == k, next_idle, end)
        if f"{k}_out_s" in logs.trajectories.columns:
            was_out = (robot == k) & (np.append(stages[f"{k}_does"] == OUT, False)[end])
            out_s = logs.trajectories[f"{k}_out_s"].to_numpy(dtype=np.float64, na_value=np.nan)
            until_s, is_out = np.where(was_out, out_s[trajectory], until_s), is_out | was_out
    is_in_trajectory = (np.append(trajectory, -1)[end] == trajectory) & ~is_out
    end = np.where(is_in_trajectory, end, 0)
    next_stage = np.where(is_in_trajectory, stage[end] + 1, np.where(is_out, -1, 0))
    return _Ends(next_stage, np.where(is_in_trajectory, begun_s[end], until_s) - begun_s)


def _is_last(logs: Logs, horizon: int | None) -> Bool[np.ndarray, " rows"]:
    """Whether nobody can have written down what becomes of what is begun in a stage."""
    stages = logs.stages
    if not robots_in(logs):
        return (stages["stage"] >= (logs.horizon if horizon is None else horizon)).to_numpy()
    each = [(stages["robot"] == k) & (stages[f"{k}_decisions_to_go"] <= 1) for k in range(robots_in(logs))]
    return np.any(each, axis=0)


def _of_one(rows: pd.DataFrame, counts: Float[np.ndarray, "rows 2"]) -> pd.Series:
    """Whether each attempt of one robot succeeded; null where it was cut."""
    gained = counts - rows[_HISTORY[1:]].to_numpy(dtype=np.float64)
    is_cut, is_observed = rows["elapsed_s"].isna().to_numpy(), ~np.isnan(counts).any(axis=1)
    is_right = (np.sort(gained, axis=1) == [0, 1]).all(axis=1)
    wrong = "successes and failures do not grow by this one attempt until the next stage; mend the counts"
    _refuse(rows, ~is_cut & is_observed & ~is_right, wrong)
    cleared = ~is_cut & (rows["next"] == 0).to_numpy() & (rows["action"] == Verb.WASH.name).to_numpy()
    unknown = "no later stage tells whether the attempt succeeded; give the horizon if it ended the trajectory"
    _refuse(rows, ~is_cut & ~is_observed & ~cleared, unknown)
    return pd.Series((is_observed & (gained[:, 0] == 1)) | cleared, dtype="boolean").mask(pd.Series(is_cut))


def _of_team(rows: pd.DataFrame, counts: Float[np.ndarray, "rows 2"]) -> pd.Series:
    """The same of several robots: a clear table ends a trajectory while a WASH is under way, and no other end does."""
    was_seen, is_clear = (rows["next"] > 0).to_numpy(), (rows["next"] == 0).to_numpy() & rows["is_clear"].to_numpy()
    held = np.where(was_seen, counts[:, 0] > rows["successes"].to_numpy(), is_clear)
    return pd.Series(held, dtype="boolean").mask(pd.Series(~was_seen & ~is_clear))


def _refuse(rows: pd.DataFrame, wrong: Bool[np.ndarray, " rows"], trouble: str) -> None:
    action, target = rows["action"], rows["object"]
    refuse(rows, wrong, lambda row: f"{action.iloc[row]} of object {shown(target.iloc[row])}: {trouble}")
