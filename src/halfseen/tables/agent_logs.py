"""The agent view of a team's log: what one robot made itself, as the log of one that works alone.

Its stages are its own decisions, but for WAIT, which a robot alone does not have: while it waits, its clock stands and
nothing is paid. A stage lasts from its decision to its next one, or to its end; it pays what r_reward tells for the
time between (`halfseen.world.robot_logs`). Its table holds what it has reached so far, with its own attempts; what
others take from there is in the dishwasher, what it no longer reaches is lost to it as long as that lasts, and what
hides something from outside its reach is not in its table.

Its path ends

- *cut*, with the cause, where it dropped out, or where the table was cut before it came to its own end;
- *cut*, with the cause `SPENT`, where waiting had cost it decisions and the others were spent: alone it would have gone
  on;
- *finished*, where it parked, what it reaches was clear, the table was over, or its decisions were spent on other than
  waiting. One that waits to its end finishes: the wait is a FINISH that takes as long.

A path in which it began nothing that was seen is not in its log.
"""

from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pyarrow as pa
from jaxtyping import Bool, Float, Int

from halfseen.errors import ArgumentError, LogError
from halfseen.learning.rows import stage_places
from halfseen.logs import Logs
from halfseen.logs.checks.robots import is_of_one_robot, robots_that_may_drop_out
from halfseen.logs.columns import CUT, FINISHED, require_columns
from halfseen.logs.refusal import refuse
from halfseen.world.actions import TARGETED, VERB_NAMES, Verb
from halfseen.world.log_checks import ATTEMPT_BY, LOST, TABLE, checked_objects, lists_in, robots_in
from halfseen.world.robot_logs import FREE, OUT, PARKED, told_by

SPENT = "decisions-spent"
"""Cause of a cut: waiting had cost the robot decisions that it would have had alone."""

_WAIT, _FINISH = VERB_NAMES[-1], Verb.FINISH.name
_ATTEMPTS = tuple(VERB_NAMES[verb] for verb in TARGETED)
_LEAST_S = 1e-6
"""What a wait to the end takes at least, so that the clock of one robot rises [s]."""
_STAGE = ["path", "stage"]


def agent_view(logs: Logs, robot: int) -> Logs:
    """Tell what one robot of a team did itself, as a log of one robot.

    Parameters
    ----------
    logs
        The log of a team, with r_reward of that robot.
    robot
        Its number.

    Raises
    ------
    ArgumentError
        The log tells of no such robot.
    LogError
        The log breaks a rule of tables or of teams, a column is missing, or it began nothing in any path.
    """
    if robot not in set(logs.stages["robot"] if "robot" in logs.stages.columns else ()):
        raise ArgumentError(f"robot is {robot}, and it decides in no stage of the log; choose among its column robot")
    require_columns("stages", logs.stages, (f"{robot}_reward",))
    objects, _ = checked_objects(logs, logs.horizon)
    mine = _in_reach(_with_own_history(logs, objects, robot), told_by(logs).is_reached[:, robot])
    stages, paths = _own_stages(logs, robot, _is_clear(logs, mine))
    if not len(stages):
        raise LogError(f"robot {robot} began nothing in any path; there is nothing to learn from it alone")
    at = stages[[*_STAGE, "of_team"]].rename(columns={"of_team": "stage", "stage": "own"})
    own_objects = mine.merge(at, on=_STAGE).drop(columns="stage").rename(columns={"own": "stage"})
    of_one = [name for name in logs.paths.columns if is_of_one_robot(name)]
    known = logs.paths.drop(columns=["end_s", "ending", "cause", *of_one])
    tables: Any = (stages.drop(columns="of_team"), paths.merge(known, on="path"), _through_arrow(own_objects))
    return Logs(*tables, reward_unit=logs.reward_unit)


class _Team(NamedTuple):
    """The stages of a team's log, a row each, and what they tell of one robot; and where paths end among the rows."""

    path: Int[np.ndarray, " rows"]
    begin_s: Float[np.ndarray, " rows"]
    end_s: Float[np.ndarray, " rows"]
    """NaN of a stage that was not completed [s]."""
    action: np.ndarray
    is_mine: Bool[np.ndarray, " rows"]
    is_over: Bool[np.ndarray, " rows"]
    """Whether the robot is at its end, or its decisions are spent."""
    to_go: Int[np.ndarray, " rows"]
    after: Int[np.ndarray, " paths"]
    """The first row after each path."""

    @classmethod
    def of(cls, logs: Logs, robot: int) -> "_Team":
        stages, (path, stage) = logs.stages, stage_places(logs)
        end_s = stages["elapsed_s"].to_numpy(dtype=np.float64, na_value=np.nan)
        does, to_go = stages[f"{robot}_does"].to_numpy(), stages[f"{robot}_decisions_to_go"].to_numpy()
        return cls(
            path=path,
            begin_s=np.where(stage == 0, 0.0, np.roll(end_s, 1)),
            end_s=end_s,
            action=stages["action"].to_numpy(),
            is_mine=(stages["robot"] == robot).to_numpy(dtype=bool),
            is_over=np.isin(does, (PARKED, OUT)) | ((does == FREE) & (to_go == 0)),
            to_go=to_go,
            after=np.searchsorted(path, np.arange(logs.num_paths), side="right"),
        )

    def first(self, is_it: Bool[np.ndarray, " rows"]) -> Int[np.ndarray, " paths"]:
        """The first row of each path where something holds; that after the path where it holds nowhere."""
        found = self.after.copy()
        np.minimum.at(found, self.path[is_it], np.flatnonzero(is_it))
        return found


class _Spans(NamedTuple):
    """What the robot did, from a decision to its next one; its waits one after another are one."""

    first: Int[np.ndarray, " spans"]
    last: Int[np.ndarray, " spans"]
    """Rows of the team's stages that it lasts from and to."""
    is_wait: Bool[np.ndarray, " spans"]
    is_last: Bool[np.ndarray, " spans"]
    """Whether it is the last of its path."""


def _spans(team: _Team, cleared: Int[np.ndarray, " paths"]) -> _Spans:
    """Until what the robot reaches is clear at one of its decisions, or else until it comes to its end."""
    row = np.arange(len(team.path))
    last_mine = np.full(len(team.after), -1)
    np.maximum.at(last_mine, team.path[team.is_mine], row[team.is_mine])
    over = team.first(team.is_over & (row > last_mine[team.path]))
    first = row[team.is_mine & (row < cleared[team.path])]
    path, is_wait = team.path[first], team.action[first] == _WAIT
    is_first = np.insert((path[1:] != path[:-1]) | ~is_wait[1:] | ~is_wait[:-1], 0, True)[: len(first)]
    first, path, is_wait = first[is_first], path[is_first], is_wait[is_first]
    is_last = np.append(path[1:] != path[:-1], True)[: len(first)]
    until = np.where(cleared < team.after, cleared, over)[path]
    return _Spans(first, np.where(is_last, until, np.roll(first, -1)) - 1, is_wait, is_last)


def _own_stages(logs: Logs, robot: int, is_clear: Bool[np.ndarray, " rows"]) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Stages, and ends of paths, on the robot's own clock, which stands while it waits for what it does next."""
    team = _Team.of(logs, robot)
    cleared = team.first(team.is_mine & is_clear)
    spans = _spans(team, cleared)
    out = [f"{robot}_out_s", f"{robot}_out_cause"]
    path, ends = team.path[spans.first], logs.paths.reindex(columns=list(dict.fromkeys([*logs.paths.columns, *out])))
    out_s = ends[out[0]].to_numpy(dtype=np.float64, na_value=np.nan)
    is_out = ~np.isnan(out_s) & (cleared == team.after)
    is_seen = ~is_out[path] & ~np.isnan(team.end_s[spans.last])
    is_spent = spans.is_last & is_seen & _is_short(logs, team, spans)
    is_whole = is_seen | ~spans.is_last
    until_s = np.where(is_whole, team.end_s[spans.last], np.where(is_out, out_s, ends["end_s"])[path])
    takes_s = np.maximum(until_s - team.begin_s[spans.first], np.where(spans.is_wait, _LEAST_S, 0.0))
    # Cut while it waited: its clock had stood.
    counts = np.where(spans.is_wait, spans.is_last & is_whole, True)
    elapsed_s = pd.Series(np.where(counts, takes_s, 0.0)).groupby(path).cumsum()
    reward = np.append(logs.stages[f"{robot}_reward"].to_numpy(dtype=np.float64), 0.0)
    paid = np.add.reduceat(reward, np.column_stack([spans.first, spans.last + 1]).ravel())[::2]
    is_told = is_whole & ~is_spent
    at = logs.stages.iloc[spans.first].reset_index(drop=True)
    own = pd.DataFrame(at[[name for name in ("path", "action", "object", "probability") if name in at.columns]]).assign(
        of_team=at["stage"],
        stage=0,
        elapsed_s=elapsed_s.where(is_told),
        reward=np.where(is_told, paid, np.nan),
        action=at["action"].mask(spans.is_wait & is_told, _FINISH).mask(spans.is_wait & ~is_told, None),
    )
    begins = elapsed_s.groupby(path).transform("last") > 0.0
    own = own[begins & (spans.is_last | ~spans.is_wait)].reset_index(drop=True)
    own["stage"] = own.groupby("path").cumcount() + 1
    of_path = begins.to_numpy() & spans.is_last
    ends = ends.iloc[path[of_path]].reset_index(drop=True)
    is_out, is_spent, is_seen = is_out[path][of_path], is_spent[of_path], is_seen[of_path]
    cause = ends["cause"].astype(object).mask(is_out, ends[out[1]]).mask(is_spent, SPENT)
    is_finished = is_seen & ~is_spent
    return own, pd.DataFrame(
        {
            "path": ends["path"],
            "end_s": elapsed_s[of_path].to_numpy(),
            "ending": np.where(is_finished, FINISHED, CUT),
            "cause": cause.mask(is_finished, None),
        }
    )


def _is_short(logs: Logs, team: _Team, spans: _Spans) -> Bool[np.ndarray, " spans"]:
    """Whether an attempt was the last for want of decisions, of which waiting had cost some.

    It was not where it ended a path in which somebody that does not go home still had decisions: the table was clear.
    """
    path = team.path[spans.first]
    is_last_decision = np.isin(team.action[spans.first], _ATTEMPTS) & (team.to_go[spans.first] == 1)
    has_waited = np.bincount(path, spans.is_wait, len(team.after)) > 0.0
    last, someone_goes_on = logs.stages.iloc[team.after - 1], np.zeros(logs.num_paths, dtype=bool)
    for robot in range(robots_in(logs)):
        decides = (last["robot"] == robot).to_numpy(dtype=bool)
        does = np.where(decides, last["action"], last[f"{robot}_does"])
        has_more = last[f"{robot}_decisions_to_go"].to_numpy() > decides
        someone_goes_on |= has_more & ~np.isin(does, (PARKED, OUT, _FINISH))
    was_cleared = (logs.is_finished & someone_goes_on)[path] & (spans.last == team.after[path] - 1)
    return is_last_decision & has_waited[path] & ~was_cleared


def _is_clear(logs: Logs, mine: pd.DataFrame) -> Bool[np.ndarray, " rows"]:
    """Whether nothing that the robot has reached so far, and reaches, stands on the table in each stage of the team."""
    left = pd.MultiIndex.from_frame(mine.loc[mine["location"] == TABLE, _STAGE])
    return ~pd.MultiIndex.from_frame(logs.stages[_STAGE]).isin(left)


def _in_reach(objects: pd.DataFrame, is_reached: Bool[np.ndarray, " rows"]) -> pd.DataFrame:
    """What the robot has reached so far, lost where it does not now; what hides it, too, as far as that was reached."""
    begin = np.arange(len(objects)) - objects.groupby(_STAGE, sort=False).cumcount().to_numpy()
    was_reached = pd.Series(is_reached, index=objects.index).groupby([objects["path"], objects["object"]]).cummax()
    is_kept = was_reached.to_numpy(dtype=bool)
    is_lost = (objects["location"] == TABLE) & ~is_reached
    hidden_by = lists_in(objects, "hidden_by")
    is_told = is_kept[hidden_by.row] & is_kept[begin[hidden_by.row] + hidden_by.place]
    shown = _lists(hidden_by.values, hidden_by.row, is_told, len(objects))
    mine = objects.assign(location=objects["location"].mask(is_lost, LOST), hidden_by=shown)[is_kept]
    return mine.reset_index(drop=True).drop(columns=["reached_by", "near", ATTEMPT_BY], errors="ignore")


def _with_own_history(logs: Logs, objects: pd.DataFrame, robot: int) -> pd.DataFrame:
    """Of the attempts at each object, those that the robot made; what was lifted was lifted by its last attempt."""
    occluded, held = lists_in(objects, "attempt_occlusions"), lists_in(objects, "attempt_succeeded")
    made_by, num_rows = _robots_of_attempts(logs, objects, robot), len(objects)
    is_mine = made_by == robot
    successes, tried = (np.bincount(held.row, is_it, num_rows) for is_it in (is_mine & (held.values > 0), is_mine))
    is_latest = np.append(held.row[1:] != held.row[:-1], True)[: len(held.row)]
    is_own_lift = np.bincount(held.row, is_latest & ~is_mine, num_rows) == 0
    of_object = [objects["path"], objects["object"]]
    gained = objects["lifts"].groupby(of_object).diff().fillna(objects["lifts"])
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
    """A list a row."""
    return np.split(values[is_kept], np.cumsum(np.bincount(row[is_kept], minlength=num_rows))[:-1])


def _through_arrow(objects: pd.DataFrame) -> pa.Table:
    """Lists of a type of their own, also where each of them is empty."""
    types = {"hidden_by": pa.float64(), "attempt_occlusions": pa.float64(), "attempt_succeeded": pa.bool_()}
    table = pa.Table.from_pandas(objects.drop(columns=list(types)), preserve_index=False)
    for name in filter(types.__contains__, objects.columns):
        lists = pa.array(objects[name], pa.list_(types[name]))
        table = table.add_column(objects.columns.get_loc(name), name, lists)
    return table


def _robots_of_attempts(logs: Logs, objects: pd.DataFrame, robot: int) -> Int[np.ndarray, " attempts"]:
    """Who made each past attempt, by attempt_by; without it, who began it, or the robot itself before the path."""
    if ATTEMPT_BY in objects.columns:
        return lists_in(objects, ATTEMPT_BY).values.astype(np.int64)
    key, tried = ["path", "object"], lists_in(objects, "attempt_occlusions")
    at_first = pd.Series(np.where(objects["stage"] == 1, tried.lengths, 0))
    before = at_first.groupby([objects["path"].to_numpy(), objects["object"].to_numpy()]).transform("max").to_numpy()
    begun = _begun_attempts(logs)
    each = pd.DataFrame(objects[key]).iloc[tried.row].assign(number=tried.place - before[tried.row])
    by = each.merge(begun.assign(number=begun.groupby(key).cumcount()), on=[*key, "number"], how="left")["robot"]
    made_by = by.where(each["number"].to_numpy() >= 0, robot)
    trouble = (
        "it was tried more often than by the WASH and LIFT of the stages; mend its past attempts, or give attempt_by"
    )
    refuse(objects, tried.rows_with(made_by.isna().to_numpy()), trouble, (*_STAGE, "object"))
    return made_by.to_numpy(dtype=np.int64)


def _begun_attempts(logs: Logs) -> pd.DataFrame:
    """Who tried which object of which path, in order; what was abandoned is no attempt."""
    stages, (path, _) = logs.stages, stage_places(logs)
    is_last, is_out = ~stages.duplicated(["path", "robot"], keep="last"), np.zeros(len(stages), dtype=bool)
    for robot in robots_that_may_drop_out(logs.paths):
        is_out |= logs.paths[f"{robot}_out_s"].notna().to_numpy()[path] & (stages["robot"] == robot).to_numpy(
            dtype=bool
        )
    return stages.loc[stages["action"].isin(_ATTEMPTS) & ~(is_out & is_last), ["path", "object", "robot"]]
