"""The agent view of a team's log: one robot's own decisions, as the log of a single robot.

Stages are the robot's own decisions except WAIT, which a single robot does not have: while it waits, its clock stands
still and it earns no reward. A stage lasts from a decision to the next one, or to the robot's end; its reward is
r_reward for the time between (`halfseen.world.logs`). The robot's table holds the objects that it has reached so far,
with its own attempts. Objects taken from there by others are in the dishwasher. Objects that it no longer reaches are
lost for as long as that lasts. Objects outside its reach are not on its table, even if they hide others.

A trajectory ends

- *cut*, with the cause, where the robot dropped out, or where the table was cut before the robot's own end;
- *cut*, with the cause `SPENT`, where it ran out of decisions after spending some on waiting: a single robot would have
  continued;
- *finished*, where the robot parked, its reach was clear, the table ended, or it spent its decisions without waiting. A
  robot that waits to its end finishes: the wait becomes a FINISH of the same duration.

A trajectory is left out if no action of the robot in it was observed.
"""

from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from halfseen.errors import ArgumentError, LogError
from halfseen.learning.rows import stage_places
from halfseen.logs import Logs, columns
from halfseen.shapes import Bool, Int
from halfseen.world.actions import TARGETED, VERB_NAMES, Verb
from halfseen.world.log_checks import ATTEMPT_BY, LOST, TABLE, checked_tables, robots_in
from halfseen.world.log_rows import FREE, OUT, PARKED, TableLog

SPENT = "decisions-spent"
"""Cause of a cut: the robot spent decisions on waiting that it would have had alone."""
_WAIT, _FINISH = VERB_NAMES[-1], Verb.FINISH.name
_ATTEMPTS = tuple(VERB_NAMES[verb] for verb in TARGETED)
_LEAST_S = 1e-6
"""Least duration of a wait to the end, so that the robot's clock increases [s]."""
_STAGE = ["trajectory", "stage"]


def agent_view(logs: Logs, robot: int) -> Logs:
    """Extract the actions of one robot of a team as a log of one robot.

    Parameters
    ----------
    logs
        The log of a team, with r_reward of that robot.
    robot
        Number of the robot.

    Raises
    ------
    ArgumentError
        The log has no such robot.
    LogError
        The log breaks a rule of tables or of teams, a column is missing, or the robot never acted.
    """
    if robot not in set(logs.stages["robot"] if "robot" in logs.stages.columns else ()):
        raise ArgumentError(f"robot is {robot}, which decides in no stage of the log; choose one in its column robot")
    columns.require_columns("stages", logs.stages, (f"{robot}_reward",))
    log = checked_tables(logs, is_team=True)
    mine = _in_reach(log, _with_own_history(log, robot), log.is_reached[:, robot])
    stages, trajectories = _own_stages(logs, robot, _is_clear(logs, mine))
    if not len(stages):
        raise LogError(
            f"robot {robot} began no action in any trajectory, so it has no log of its own; choose another robot"
        )
    at = stages[[*_STAGE, "of_team"]].rename(columns={"of_team": "stage", "stage": "own"})
    own_objects = mine.merge(at, on=_STAGE).drop(columns="stage").rename(columns={"own": "stage"})
    of_one = [name for name in logs.trajectories.columns if columns.is_of_one_robot(name)]
    known = logs.trajectories.drop(columns=["end_s", "ending", "cause", *of_one])
    tables: Any = (
        stages.drop(columns="of_team"),
        trajectories.merge(known, on="trajectory"),
        _through_arrow(own_objects),
    )
    return Logs(*tables, reward_unit=logs.reward_unit)


def _own_stages(logs: Logs, robot: int, is_clear: Bool[np.ndarray, " rows"]) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Stages and ends of trajectories on the robot's own clock, which stands still during waits."""
    rows: Any = _own_rows(logs, robot, is_clear)
    # A stage lasts from one decision to the next; consecutive waits are merged.
    decided = rows[rows["is_mine"]]
    goes_on = decided["is_wait"] & decided.groupby("trajectory")["is_wait"].shift(fill_value=False)
    begins = rows["is_mine"] & ~goes_on.reindex(rows.index, fill_value=False)
    first, last = (rows[at].reset_index(drop=True) for at in (begins, begins.shift(-1, fill_value=True)))
    paid = np.add.reduceat(rows["reward"].to_numpy(), np.flatnonzero(begins)) if len(rows) else np.zeros(0)
    ends: Any = _ends(logs, robot).iloc[first["trajectory"]].reset_index(drop=True)
    is_last, is_wait = ~first["trajectory"].duplicated(keep="last"), first["is_wait"]
    is_out = ends["out_s"].notna() & ~first["is_cleared"]
    is_seen = ~is_out & last["end_s"].notna()
    is_spent = is_last & is_seen & _is_short(logs, first, last)
    is_whole = is_seen | ~is_last
    until_s = last["end_s"].where(is_whole, np.where(is_out, ends["out_s"], ends["end_s"]))
    takes_s: Any = np.maximum(until_s - first["begin_s"], np.where(is_wait, _LEAST_S, 0.0))
    # Cut during a wait: the clock stood still.
    elapsed_s = takes_s.where(~is_wait | (is_last & is_whole), 0.0).groupby(first["trajectory"]).cumsum()
    is_known = is_whole & ~is_spent
    at: Any = logs.stages.iloc[first["at"]].reset_index(drop=True)
    own = at[[name for name in ("trajectory", "action", "object", "probability") if name in at.columns]].assign(
        of_team=at["stage"],
        stage=0,
        elapsed_s=elapsed_s.where(is_known),
        reward=np.where(is_known, paid, np.nan),
        action=at["action"].mask(is_wait & is_known, _FINISH).mask(is_wait & ~is_known, None),
    )
    has_begun = elapsed_s.groupby(first["trajectory"]).transform("last") > 0.0
    own = own[has_begun & (is_last | ~is_wait)].reset_index(drop=True)
    own["stage"] = own.groupby("trajectory").cumcount() + 1
    is_finished = is_seen & ~is_spent
    cause = ends["cause"].astype(object).mask(is_out, ends["out_cause"]).mask(is_spent, SPENT).mask(is_finished, None)
    ending = np.where(is_finished, columns.FINISHED, columns.CUT)
    trajectories: Any = pd.DataFrame(
        {"trajectory": ends["trajectory"], "end_s": elapsed_s, "ending": ending, "cause": cause}
    )
    return own, trajectories[has_begun & is_last].reset_index(drop=True)


def _own_rows(logs: Logs, robot: int, is_clear: Bool[np.ndarray, " rows"]) -> pd.DataFrame:
    """The team's stages from the robot's first decision until it has no more work, or its reach is clear."""
    stages, (trajectory, _) = logs.stages, stage_places(logs)
    does, to_go = stages[f"{robot}_does"], stages[f"{robot}_decisions_to_go"]
    is_mine = stages["robot"] == robot

    def so_far(is_it: pd.Series) -> pd.Series:
        return is_it.groupby(trajectory).cumsum() > 0

    decides_yet = is_mine[::-1].groupby(trajectory[::-1]).cumsum()[::-1] > 0
    is_over = does.isin([PARKED, OUT]) | ((does == FREE) & (to_go == 0))
    found = is_mine & is_clear
    rows: Any = pd.DataFrame(
        {
            "at": np.arange(len(stages)),
            "trajectory": trajectory,
            "begin_s": stages["elapsed_s"].groupby(trajectory).shift(fill_value=0.0),
            "end_s": stages["elapsed_s"],
            "reward": stages[f"{robot}_reward"].astype(np.float64),
            "action": stages["action"],
            "is_wait": stages["action"] == _WAIT,
            "is_mine": is_mine,
            "is_cleared": found.groupby(trajectory).transform("any"),
            "to_go": to_go,
        }
    )
    return rows[so_far(is_mine) & ~so_far(found) & ~so_far(is_over & ~decides_yet)].reset_index(drop=True)


def _ends(logs: Logs, robot: int) -> pd.DataFrame:
    """How each trajectory of the team ended, and whether, when and why the robot dropped out."""
    named = logs.trajectories.rename(columns={f"{robot}_out_s": "out_s", f"{robot}_out_cause": "out_cause"})
    return named.reindex(columns=["trajectory", "end_s", "cause", "out_s", "out_cause"])


def _is_short(logs: Logs, first: pd.DataFrame, last: pd.DataFrame) -> pd.Series:
    """Whether an attempt was the last because decisions ran out, some of them spent on waiting.

    False where the attempt ended a trajectory in which a robot that had not gone home still had decisions: the table
    was clear.
    """
    stages, trajectory = logs.stages, first["trajectory"].to_numpy()
    end = stages.groupby(stage_places(logs)[0]).tail(1)
    goes_on = np.zeros(logs.num_trajectories, dtype=bool)
    for robot in range(robots_in(logs)):
        decides = end["robot"] == robot
        does = end[f"{robot}_does"].astype(object).mask(decides, end["action"])
        goes_on |= ((end[f"{robot}_decisions_to_go"] > decides) & ~does.isin([PARKED, OUT, _FINISH])).to_numpy()
    was_cleared = (logs.is_finished & goes_on)[trajectory] & (last["at"] == end.index.to_numpy()[trajectory])
    has_waited = first.groupby("trajectory")["is_wait"].transform("any")
    return first["action"].isin(_ATTEMPTS) & (first["to_go"] == 1) & has_waited & ~was_cleared


def _is_clear(logs: Logs, mine: pd.DataFrame) -> Bool[np.ndarray, " rows"]:
    """Whether no object within the robot's reach is on the table, for each stage of the team."""
    left = pd.MultiIndex.from_frame(pd.DataFrame(mine.loc[mine["location"] == TABLE, _STAGE]))
    return ~pd.MultiIndex.from_frame(pd.DataFrame(logs.stages[_STAGE])).isin(left)


def _in_reach(log: TableLog, objects: pd.DataFrame, is_reached: Bool[np.ndarray, " rows"]) -> pd.DataFrame:
    """Objects that the robot has reached so far, lost while out of reach; hiding objects only if reached as well."""
    begin = np.arange(len(objects)) - objects.groupby(_STAGE, sort=False).cumcount().to_numpy()
    was_reached = (
        pd.Series(is_reached, index=objects.index).groupby([objects["trajectory"], objects["object"]]).cummax()
    )
    is_kept = was_reached.to_numpy(dtype=bool)
    is_lost = (objects["location"] == TABLE) & ~is_reached
    hidden_by = log.lists("hidden_by")
    is_known = is_kept[hidden_by.row] & is_kept[begin[hidden_by.row] + hidden_by.place]
    shown = _lists(hidden_by.values, hidden_by.row, is_known, len(objects))
    mine: Any = objects.assign(location=objects["location"].mask(is_lost, LOST), hidden_by=shown)[is_kept]
    return mine.reset_index(drop=True).drop(columns=["reached_by", "near", ATTEMPT_BY], errors="ignore")


def _with_own_history(log: TableLog, robot: int) -> pd.DataFrame:
    """Keep the robot's own attempts at each object; each lift belongs to the latest attempt."""
    objects, occluded, held = log.objects, log.lists("attempt_occlusions"), log.lists("attempt_succeeded")
    made_by, num_rows = _robots_of_attempts(log, robot), len(objects)
    is_mine = made_by == robot
    successes, tried = (np.bincount(held.row, is_it, num_rows) for is_it in (is_mine & (held.values > 0), is_mine))
    is_latest = np.append(held.row[1:] != held.row[:-1], True)[: len(held.row)]
    is_own_lift = np.bincount(held.row, is_latest & ~is_mine, num_rows) == 0
    of_object = [objects["trajectory"], objects["object"]]
    lifts = columns.as_floats("objects", objects, "lifts")
    gained = lifts.groupby(of_object).diff().fillna(lifts)
    return objects.assign(
        attempt_occlusions=_lists(occluded.values, occluded.row, is_mine, num_rows),
        attempt_succeeded=_lists(held.values.astype(bool), held.row, is_mine, num_rows),
        successes=successes.astype(np.int64),
        failures=(tried - successes).astype(np.int64),
        lifts=gained.where(is_own_lift, 0).groupby(of_object).cumsum().astype(np.int64),
    )


def _lists(
    values: np.ndarray, row: Int[np.ndarray, " k"], is_kept: Bool[np.ndarray, " k"], num_rows: int
) -> list[np.ndarray]:
    """One list for each row."""
    return np.split(values[is_kept], np.cumsum(np.bincount(row[is_kept], minlength=num_rows))[:-1])


def _through_arrow(objects: pd.DataFrame) -> pa.Table:
    """The table with typed list columns, even if all lists are empty."""
    types = {"hidden_by": pa.float64(), "attempt_occlusions": pa.float64(), "attempt_succeeded": pa.bool_()}
    table = pa.Table.from_pandas(objects.drop(columns=list(types)), preserve_index=False)
    for name in filter(types.__contains__, objects.columns):
        lists = pa.array(objects[name], pa.list_(types[name]))
        table = table.add_column(objects.columns.get_loc(name), name, lists)
    return table


def _robots_of_attempts(log: TableLog, robot: int) -> Int[np.ndarray, " attempts"]:
    """Robot of each past attempt, from attempt_by; else the robot that began it, or this one if before the log."""
    objects = log.objects
    if ATTEMPT_BY in objects.columns:
        return log.lists(ATTEMPT_BY).values.astype(np.int64)
    key, tried = ["trajectory", "object"], log.lists("attempt_occlusions")
    at_first = pd.Series(np.where(objects["stage"] == 1, tried.lengths, 0))
    before = (
        at_first.groupby([objects["trajectory"].to_numpy(), objects["object"].to_numpy()]).transform("max").to_numpy()
    )
    begun = _begun_attempts(log.logs)
    each = pd.DataFrame(objects[key]).iloc[tried.row].assign(number=tried.place - before[tried.row])
    by = each.merge(begun.assign(number=begun.groupby(key).cumcount()), on=[*key, "number"], how="left")["robot"]
    made_by = by.where(each["number"].to_numpy() >= 0, robot)
    trouble = (
        "it has more attempts than the WASH and LIFT of the stages made; fix its past attempts, or give attempt_by"
    )
    columns.refuse(objects, tried.rows_with(made_by.isna().to_numpy()), trouble, (*_STAGE, "object"))
    return made_by.to_numpy(dtype=np.int64)


def _begun_attempts(logs: Logs) -> pd.DataFrame:
    """Robot and object of each attempt by trajectory, in order; abandoned attempts do not count."""
    stages, (trajectory, _) = logs.stages, stage_places(logs)
    is_last, is_out = ~stages.duplicated(["trajectory", "robot"], keep="last"), np.zeros(len(stages), dtype=bool)
    for robot in columns.robots_that_may_drop_out(logs.trajectories):
        is_out |= logs.trajectories[f"{robot}_out_s"].notna().to_numpy()[trajectory] & (
            stages["robot"] == robot
        ).to_numpy(dtype=bool)
    return stages.loc[stages["action"].isin(_ATTEMPTS) & ~(is_out & is_last), ["trajectory", "object", "robot"]]
