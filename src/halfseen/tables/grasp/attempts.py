"""From the log of a table, or of a team, to the attempts to grasp that it holds, the cut ones included."""

import numpy as np
import pandas as pd
from jaxtyping import Bool, Int

from halfseen.arrays import at
from halfseen.errors import LogError
from halfseen.learning.rows import stage_places
from halfseen.logs import Logs
from halfseen.logs.columns import require_columns
from halfseen.logs.refusal import refuse, shown
from halfseen.world.actions import TARGETED, Verb
from halfseen.world.state import TableState, attempt_counts, occlusion

ATTEMPT_VERBS = tuple(verb.name for verb in TARGETED)
_KEY = ["path", "stage", "object"]
_HISTORY = ["occlusion", "successes", "failures"]
_COLUMNS = [*_KEY, "occlusion", "grip", "successes", "failures", "succeeded", "time_s", "is_finished"]


def attempts(logs: Logs, horizon: int | None = None) -> pd.DataFrame:
    """List every attempt to WASH or LIFT (any verb with a target) whose end, or cut, was seen.

    Whether an attempt succeeded shows in the object's counts one stage later. After the last stage of a path there are
    none: a WASH that ends a path before the horizon has cleared the table, so it succeeded. Of an attempt in stage
    `horizon` nobody wrote down what became of it; those attempts are left out, cut ones too. That depends on the stage
    alone, and so it biases nothing. So is an attempt that was cut the moment it began: it was watched for 0 s.

    Parameters
    ----------
    logs
        A log with objects: columns occlusion, successes, failures, and grip if there is one.
    horizon
        Stages after which a path ends by itself; by default the stages of the longest path.

    Returns
    -------
    DataFrame
        One row an attempt, sorted by path and stage: path, stage, object (a number for each object of each path),
        occlusion, grip (0 where the log has none), successes and failures (before the attempt), succeeded (null where
        cut), time_s (duration watched, transport included [s]) and is_finished (False where cut).

    Raises
    ------
    LogError
        The log has no objects or lacks one of their columns, or the outcome of an attempt cannot be told.
    """
    objects = _checked_objects(logs)
    stages = logs.stages.assign(time_s=_watched_s(logs))
    tried = pd.DataFrame(stages[stages["action"].isin(ATTEMPT_VERBS)])
    rows = tried.merge(objects, on=_KEY, how="left", validate="one_to_one")
    _refuse(rows, rows["occlusion"].isna().to_numpy(), "the object is not listed in this stage; list it in objects")
    horizon = logs.horizon if horizon is None else horizon
    rows = pd.DataFrame(rows[(rows["stage"] < horizon) & (rows["time_s"] > 0)]).reset_index(drop=True)
    is_finished = ~np.isnan(rows["elapsed_s"].to_numpy())
    codes = rows.groupby(["path", "object"], sort=False).ngroup()
    table = rows.assign(succeeded=_outcomes(logs, rows, objects), is_finished=is_finished, object=codes)
    return pd.DataFrame(table[_COLUMNS])


def _checked_objects(logs: Logs) -> pd.DataFrame:
    if logs.objects is None:
        raise LogError("objects: the log has none; attempts are read from logs with an objects table")
    require_columns("objects", logs.objects, _HISTORY)
    known = pd.DataFrame(logs.objects[[*_KEY, *_HISTORY]])
    return known.assign(grip=logs.objects["grip"] if "grip" in logs.objects.columns else 0.0)


def _watched_s(logs: Logs) -> pd.Series:
    """Time from the beginning of each stage until it was completed or its path was cut [s]."""
    stages = logs.stages
    end_s = pd.Series(logs.end_s[pd.Index(logs.path_ids).get_indexer(stages["path"])])
    begun_s = stages.groupby("path")["elapsed_s"].shift().fillna(0.0)
    return stages["elapsed_s"].fillna(end_s) - begun_s


def _outcomes(logs: Logs, rows: pd.DataFrame, objects: pd.DataFrame) -> pd.Series:
    """Whether each attempt succeeded; null where it was cut."""
    after = rows[_KEY].assign(stage=rows["stage"] + 1).merge(objects, on=_KEY, how="left")
    gained = after[_HISTORY[1:]].to_numpy() - rows[_HISTORY[1:]].to_numpy()
    is_cut = rows["elapsed_s"].isna().to_numpy()
    is_observed = ~np.isnan(gained).any(axis=1)
    is_right = (np.sort(gained, axis=1) == [0, 1]).all(axis=1)
    wrong = "successes and failures do not grow by this one attempt until the next stage; mend the counts"
    _refuse(rows, ~is_cut & is_observed & ~is_right, wrong)
    cleared = ~is_cut & ~is_observed & _ends_its_path(logs, rows) & (rows["action"] == Verb.WASH.name).to_numpy()
    unknown = "no later stage tells whether the attempt succeeded; give the horizon if it ended the path"
    _refuse(rows, ~is_cut & ~is_observed & ~cleared, unknown)
    outcome = pd.Series((is_observed & (gained[:, 0] == 1)) | cleared, dtype="boolean")
    return outcome.mask(pd.Series(is_cut))


def _ends_its_path(logs: Logs, rows: pd.DataFrame) -> Bool[np.ndarray, " rows"]:
    num_stages = logs.stages.groupby("path")["stage"].max()
    return rows["stage"].to_numpy() == num_stages.reindex(rows["path"]).to_numpy()


def _refuse(rows: pd.DataFrame, wrong: Bool[np.ndarray, " rows"], trouble: str) -> None:
    action, target = rows["action"], rows["object"]
    refuse(rows, wrong, lambda row: f"{action.iloc[row]} of object {shown(target.iloc[row])}: {trouble}")


def team_attempts(
    logs: Logs, states: TableState, verb: Int[np.ndarray, "n T"], target: Int[np.ndarray, "n T"]
) -> pd.DataFrame:
    """List every attempt to WASH or LIFT whose end, or cut, was seen, and the robot that made it.

    The rest is as `attempts` has it. An attempt of a robot lasts until that robot is free. Those
    of a robot's last decision are left out, as nobody wrote down what became of most of them; that depends on the
    number of the decision alone.

    Parameters
    ----------
    logs
        Of a team.
    states
        S_t of its stages.
    verb, target
        What was begun in each.
    """
    robots, decider = states.robots, states.decider
    assert robots is not None
    assert decider is not None
    hidden_share, (successes, failures) = occlusion(states), attempt_counts(states)
    is_stage, elapsed_s = np.zeros(verb.shape, dtype=bool), np.zeros(verb.shape)
    is_stage[stage_places(logs)] = True
    elapsed_s[stage_places(logs)] = logs.stages["elapsed_s"].to_numpy(dtype=np.float64, na_value=np.nan)
    begun_s = np.pad(elapsed_s[:, :-1], ((0, 0), (1, 0)))
    is_last_of_robot = at(robots.decisions_to_go, decider) <= 1
    path, stage = np.nonzero(is_stage & np.isin(verb, TARGETED) & ~is_last_of_robot)
    robot, tried_at = decider[path, stage], target[path, stage]
    # The first later stage in which this robot is free.
    is_free = (np.arange(verb.shape[1]) > stage[:, None]) & is_stage[path] & ~robots.is_busy[path, :, robot]
    has_ended, end = is_free.any(axis=1), is_free.argmax(axis=1)
    gained = successes[path, end, tried_at] - successes[path, stage, tried_at]
    # A robot that drops out abandons what it is at: that attempt was cut.
    was_dropped = has_ended & (False if robots.is_out is None else robots.is_out[path, end, robot])
    was_seen = has_ended & ~was_dropped
    # A table that is clear ends a path while a WASH is under way, and no other end does.
    is_clear = ~has_ended & logs.is_finished[path] & (verb[path, stage] == Verb.WASH)
    end_s = np.where(was_seen, begun_s[path, end], logs.end_s[path])
    end_s = np.where(was_dropped, _out_s(logs, robots.num_robots)[path, robot], end_s)
    tried = pd.DataFrame(
        {
            "path": logs.path_ids[path],
            "stage": stage + 1,
            "object": pd.factorize(path * states.num_objects + tried_at)[0],
            "occlusion": hidden_share[path, stage, tried_at].astype(np.float64),
            "grip": states.grip[path, stage, tried_at].astype(np.float64),
            "successes": successes[path, stage, tried_at],
            "failures": failures[path, stage, tried_at],
            "succeeded": pd.Series(np.where(was_seen, gained > 0, is_clear), dtype="boolean"),
            "time_s": end_s - begun_s[path, stage],
            "is_finished": was_seen | is_clear,
            "robot": robot,
        }
    )
    tried["succeeded"] = tried["succeeded"].mask(~tried["is_finished"])
    return pd.DataFrame(tried[tried["time_s"] > 0]).reset_index(drop=True)


def _out_s(logs: Logs, num_robots: int) -> np.ndarray:
    """When each robot dropped out of each path; NaN where it did not [s]."""
    found = logs.paths.reindex(columns=[f"{robot}_out_s" for robot in range(num_robots)])
    return found.to_numpy(dtype=np.float64, na_value=np.nan)
