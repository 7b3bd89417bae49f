"""The agent view of a team's log: what one robot made itself, as the log of one that works alone.

Its stages are its own decisions, but for WAIT, which a robot alone does not have: while it waits, its clock stands and
nothing is paid. A stage lasts from its decision to its next one, or to its end; it pays what r_reward tells for the
time between (`halfseen.world.logs`). Its table holds what it has reached so far, with its own attempts; what
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

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pyarrow as pa
from jaxtyping import Bool, Float, Int

from halfseen.errors import ArgumentError, LogError
from halfseen.logs import Logs
from halfseen.logs.checks.robots import robots_that_may_drop_out
from halfseen.logs.columns import CUT, FINISHED, require_columns
from halfseen.logs.refusal import refuse
from halfseen.world.actions import TARGETED, VERB_NAMES, Verb
from halfseen.world.log_checks import ATTEMPT_BY, LOST, TABLE, checked_tables
from halfseen.world.log_rows import FREE, OUT, PARKED

SPENT = "decisions-spent"
"""Cause of a cut: waiting had cost the robot decisions that it would have had alone."""

_WAIT, _FINISH = VERB_NAMES[-1], Verb.FINISH.name
_ATTEMPTS = tuple(VERB_NAMES[verb] for verb in TARGETED)
_LEAST_S = 1e-6
"""What a wait to the end takes at least, so that the clock of one robot rises [s]."""


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
    log = checked_tables(logs, is_team=True)
    mine = _objects_in_reach(_own_history(logs, log.objects, robot), log.is_reached[:, robot])
    has_left = set(mine.loc[mine["location"] == TABLE, ["path", "stage"]].itertuples(index=False, name=None))
    paths = [_path(each, has_left) for each in _paths(logs, robot)]
    kept = [path for path in paths if path is not None]
    if not kept:
        raise LogError(f"robot {robot} began nothing in any path; there is nothing to learn from it alone")
    stages = _own_stages(logs, [row for path in kept for row in path.rows])
    at = stages[["path", "of_team", "stage"]].rename(columns={"of_team": "stage", "stage": "own"})
    own_objects = mine.merge(at, on=["path", "stage"]).drop(columns="stage").rename(columns={"own": "stage"})
    ends = pd.DataFrame([path.end for path in kept])
    known = logs.paths.drop(columns=["end_s", "ending", "cause", *_of_drop_outs(logs)])
    tables: Any = (stages.drop(columns="of_team"), ends.merge(known, on="path"), _through_arrow(own_objects))
    return Logs(*tables, reward_unit=logs.reward_unit)


class _Row(NamedTuple):
    """A stage of the robot, and where the stage of the team stands in which it decided."""

    at: int
    stage: int
    elapsed_s: float
    reward: float
    is_wait: bool
    """Whether it is a wait: FINISH where it was the last thing, and no known action where it was cut."""


@dataclass(frozen=True)
class _TeamPath:
    """One path of a team, and what is told there of the robot."""

    first_row: int
    stages: pd.DataFrame
    actions: list[Any]
    clock_s: Float[np.ndarray, " t"]
    """At the end of each stage, NaN where it was not completed [s]."""
    is_mine: Bool[np.ndarray, " t"]
    does: list[str]
    to_go: Int[np.ndarray, " t"]
    reward: Float[np.ndarray, " t"]
    end: dict[str, Any]
    out_s: float
    out_cause: Any

    @property
    def begin_s(self) -> Float[np.ndarray, " t"]:
        """Clock at the begin of each stage [s]."""
        return np.concatenate([[0.0], self.clock_s[:-1]])


@dataclass(frozen=True)
class _OwnPath:
    rows: list[_Row]
    end: dict[str, Any]


def _of_drop_outs(logs: Logs) -> list[str]:
    known = {f"{robot}_{what}" for robot in robots_that_may_drop_out(logs.paths) for what in ("out_s", "out_cause")}
    return [name for name in logs.paths.columns if name in known]


def _paths(logs: Logs, robot: int) -> Iterator[_TeamPath]:
    stages, ends = logs.stages, logs.paths.to_dict("records")
    clock_s, reward = (stages[name].to_numpy(dtype=np.float64) for name in ("elapsed_s", f"{robot}_reward"))
    is_mine, to_go = (stages["robot"] == robot).to_numpy(dtype=bool), stages[f"{robot}_decisions_to_go"].to_numpy()
    actions, does = stages["action"].tolist(), stages[f"{robot}_does"].tolist()
    begins = np.append(np.flatnonzero(stages["stage"].to_numpy() == 1), len(stages))
    for end, first, after in zip(ends, begins[:-1].tolist(), begins[1:].tolist(), strict=True):
        rows = slice(first, after)
        yield _TeamPath(
            first_row=first,
            stages=stages,
            actions=actions[rows],
            clock_s=clock_s[rows],
            is_mine=is_mine[rows],
            does=does[rows],
            to_go=to_go[rows],
            reward=reward[rows],
            end=end,
            out_s=float(end.get(f"{robot}_out_s", np.nan)),
            out_cause=end.get(f"{robot}_out_cause"),
        )


def _path(path: _TeamPath, has_left: set[tuple[Any, int]]) -> _OwnPath | None:
    """The robot's own path, or None where it began nothing."""
    decisions = np.flatnonzero(path.is_mine)
    is_clear = [(path.end["path"], int(at) + 1) not in has_left for at in decisions]
    is_cleared = any(is_clear)
    last = 0 if not len(decisions) else _own_end(path, int(decisions[-1]))
    if is_cleared:
        decisions, last = decisions[: is_clear.index(True)], int(decisions[is_clear.index(True)]) - 1
    if not len(decisions):
        return None
    is_out = not np.isnan(path.out_s) and not is_cleared
    is_seen = not is_out and not np.isnan(path.clock_s[last])
    runs = _runs(path, decisions, last)
    return _told(path, runs, is_seen, is_out)


def _own_end(path: _TeamPath, last_decision: int) -> int:
    """The stage of the team in which the robot came to its end, or in which its log ends."""
    for at in range(last_decision + 1, len(path.does)):
        is_spent = path.does[at] == FREE and path.to_go[at] == 0
        if path.does[at] in (PARKED, OUT) or is_spent:
            return at - 1
    return len(path.does) - 1


@dataclass(frozen=True)
class _Run:
    """A stage of the robot: the stages of the team from its decision to its next."""

    first: int
    last: int
    is_wait: bool


def _runs(path: _TeamPath, decisions: Int[np.ndarray, " d"], last: int) -> list[_Run]:
    """Its stages, those in which it waits one after another taken together."""
    ends = [*(int(at) - 1 for at in decisions[1:]), last]
    each = [_Run(int(at), end, path.actions[at] == _WAIT) for at, end in zip(decisions, ends, strict=True)]
    runs = []
    for is_wait, members in groupby(each, key=lambda run: run.is_wait):
        together = list(members)
        runs += [_Run(together[0].first, together[-1].last, True)] if is_wait else together
    return runs


def _told(path: _TeamPath, runs: list[_Run], is_seen: bool, is_out: bool) -> _OwnPath | None:
    """Stages and end on the robot's own clock, which stands while it waits for what it does next."""
    kept = [run for run in runs if not run.is_wait or run is runs[-1]]
    begin_s, team_end_s = path.begin_s, path.out_s if is_out else path.end["end_s"]
    elapsed_s, rows = 0.0, []
    is_spent = is_seen and _is_short(path, runs)
    for stage, run in enumerate(kept, start=1):
        is_whole = run is not kept[-1] or is_seen
        until_s = path.clock_s[run.last] if is_whole else team_end_s
        takes_s = max(until_s - begin_s[run.first], _LEAST_S if run.is_wait else 0.0)
        # Cut while it waited: its clock had stood.
        elapsed_s += takes_s if is_whole or not run.is_wait else 0.0
        reward = float(np.sum(path.reward[run.first : run.last + 1]))
        is_told = is_whole and not (is_spent and run is kept[-1])
        told = (elapsed_s, reward) if is_told else (np.nan, np.nan)
        rows.append(_Row(path.first_row + run.first, stage, *told, run.is_wait))
    if elapsed_s <= 0.0:
        return None
    return _OwnPath(rows, _ending(path, elapsed_s, is_seen and not is_spent, is_out, is_spent))


def _is_short(path: _TeamPath, runs: list[_Run]) -> bool:
    """Whether an attempt was its last for want of decisions, of which waiting had cost some."""
    last = runs[-1]
    is_last_decision = path.actions[last.first] in _ATTEMPTS and path.to_go[last.first] == 1
    if not (is_last_decision and any(run.is_wait for run in runs)):
        return False
    return not (path.end["ending"] == FINISHED and last.last == len(path.does) - 1 and _clears(path))


def _clears(path: _TeamPath) -> bool:
    """Whether the path ended while somebody that does not go home still had decisions: then the table was clear."""
    last = path.stages.iloc[path.first_row + len(path.does) - 1]

    def goes_on(robot: int) -> bool:
        decides = last["robot"] == robot
        does = last["action"] if decides else last[f"{robot}_does"]
        return bool(last[f"{robot}_decisions_to_go"] > decides) and does not in (PARKED, OUT, _FINISH)

    return any(goes_on(r) for r in range(sum(name.endswith("_does") for name in path.stages.columns)))


def _own_stages(logs: Logs, rows: list[_Row]) -> pd.DataFrame:
    found = logs.stages.iloc[[row.at for row in rows]].reset_index(drop=True)
    names = [name for name in ("path", "action", "object", "probability") if name in found.columns]
    own = pd.DataFrame(found[names]).assign(
        of_team=found["stage"],
        stage=[row.stage for row in rows],
        elapsed_s=[row.elapsed_s for row in rows],
        reward=[row.reward for row in rows],
    )
    is_wait = pd.Series([row.is_wait for row in rows])
    is_cut = own["elapsed_s"].isna()
    own["action"] = own["action"].mask(is_wait & ~is_cut, _FINISH).mask(is_wait & is_cut, None)
    return own


def _ending(path: _TeamPath, end_s: float, is_finished: bool, is_out: bool, is_spent: bool) -> dict[str, Any]:
    cause = SPENT if is_spent else path.out_cause if is_out else path.end["cause"]
    of_end = {"ending": FINISHED, "cause": None} if is_finished else {"ending": CUT, "cause": cause}
    return {"path": path.end["path"], "end_s": end_s, **of_end}


def _objects_in_reach(objects: pd.DataFrame, is_reached: Bool[np.ndarray, " rows"]) -> pd.DataFrame:
    """What the robot has reached so far, lost where it does not now; what hides it, too, as far as that was reached."""
    in_stage = objects.groupby(["path", "stage"], sort=False)["object"].transform("size").to_numpy()
    begin = np.arange(len(objects)) - objects.groupby(["path", "stage"], sort=False).cumcount().to_numpy()
    of_object = [objects["path"], objects["object"]]
    was_reached = pd.Series(is_reached, index=objects.index).groupby(of_object).cummax().to_numpy(dtype=bool)
    is_lost = (objects["location"] == TABLE) & ~is_reached
    mine = objects.assign(location=objects["location"].mask(is_lost, LOST))[was_reached].reset_index(drop=True)
    spans = zip(begin[was_reached].tolist(), in_stage[was_reached].tolist(), strict=True)
    hidden_by = [
        np.asarray(each)[was_reached[first : first + size]]
        for each, (first, size) in zip(mine["hidden_by"], spans, strict=True)
    ]
    return mine.drop(columns=["reached_by", "near", ATTEMPT_BY], errors="ignore").assign(hidden_by=hidden_by)


def _own_history(logs: Logs, objects: pd.DataFrame, robot: int) -> pd.DataFrame:
    """Of the attempts at each object, those that the robot made; what was lifted was lifted by its last attempt."""
    made_by = _robots_of_attempts(logs, objects, robot)
    rows = []
    for by, at, held in zip(made_by, objects["attempt_occlusions"], objects["attempt_succeeded"], strict=True):
        occluded, succeeded = np.asarray(at)[by == robot], np.asarray(held, dtype=bool)[by == robot]
        successes = int(succeeded.sum())
        rows.append((occluded, succeeded, successes, len(succeeded) - successes))
    names = ("attempt_occlusions", "attempt_succeeded", "successes", "failures")
    own = dict(zip(names, map(list, zip(*rows, strict=True)), strict=True))
    of_object = [objects["path"], objects["object"]]
    gained = objects["lifts"].groupby(of_object).diff().fillna(objects["lifts"])
    is_last = np.array([not len(by) or by[-1] == robot for by in made_by], dtype=bool)
    return objects.assign(**own, lifts=gained.where(is_last, 0).groupby(of_object).cumsum().astype(np.int64))


def _robots_of_attempts(logs: Logs, objects: pd.DataFrame, robot: int) -> list[Int[np.ndarray, " attempts"]]:
    """Who made each past attempt, by attempt_by; without it, who began it, or the robot itself before the path."""
    if ATTEMPT_BY in objects.columns:
        return [np.asarray(by, dtype=np.int64) for by in objects[ATTEMPT_BY]]
    keys = list(zip(objects["path"], objects["object"], strict=True))
    num_tried, is_first = objects["attempt_occlusions"].map(len).tolist(), (objects["stage"] == 1).tolist()
    before = {key: number for key, number, is_it in zip(keys, num_tried, is_first, strict=True) if is_it}
    begun = _begun_attempts(logs)
    made_by = [
        np.array(([robot] * before.get(key, 0) + begun.get(key, []))[:number], dtype=np.int64)
        for key, number in zip(keys, num_tried, strict=True)
    ]
    unknown = np.array([len(by) < number for by, number in zip(made_by, num_tried, strict=True)], dtype=bool)
    trouble = (
        "it was tried more often than by the WASH and LIFT of the stages; mend its past attempts, or give attempt_by"
    )
    refuse(objects, unknown, trouble, ("path", "stage", "object"))
    return made_by


def _begun_attempts(logs: Logs) -> dict[tuple[Any, Any], list[int]]:
    """Who tried each object of each path, in order; what was abandoned is no attempt."""
    is_attempt = logs.stages["action"].isin(_ATTEMPTS).to_numpy(dtype=bool)
    last = ~logs.stages.duplicated(["path", "robot"], keep="last")
    is_out = np.zeros(len(logs.stages), dtype=bool)
    path_row = pd.Index(logs.path_ids).get_indexer(logs.stages["path"])
    for robot in robots_that_may_drop_out(logs.paths):
        dropped = logs.paths[f"{robot}_out_s"].notna().to_numpy(dtype=bool)[path_row]
        is_out |= dropped & (logs.stages["robot"] == robot).to_numpy(dtype=bool)
    begun: Any = logs.stages[is_attempt & ~(is_out & last.to_numpy())]
    made: dict[tuple[Any, Any], list[int]] = {}
    for path, target, robot in begun[["path", "object", "robot"]].itertuples(index=False, name=None):
        made.setdefault((path, target), []).append(robot)
    return made


def _through_arrow(objects: pd.DataFrame) -> pa.Table:
    """Lists of a type of their own, also where each of them is empty."""
    table = pa.Table.from_pandas(objects, preserve_index=False)
    for name, kind in (("hidden_by", pa.float64()), ("attempt_occlusions", pa.float64())):
        table = table.set_column(table.schema.get_field_index(name), name, pa.array(objects[name], pa.list_(kind)))
    succeeded = pa.array(objects["attempt_succeeded"], pa.list_(pa.bool_()))
    return table.set_column(table.schema.get_field_index("attempt_succeeded"), "attempt_succeeded", succeeded)
