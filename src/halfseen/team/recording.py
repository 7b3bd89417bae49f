"""From cut episodes of a team to `Logs`: those of a table, and which robot decided, and what the others were at.

Beside the columns of one robot's log, a stage holds `robot` (from 0) and, for each robot r, what it was at when that
stage began: r_does ("WASH 3", "WAIT", "FREE", "PARKED", "OUT"), r_since_s (for how long, 0 where it is free) and
r_decisions_to_go; and r_reward, what the stage would have paid it had it been alone (its own attempts that ended in it,
the price of its seconds, and at its own end that of what was left dirty in its reach).
Where robots may drop out, a path holds r_out_s and r_out_cause, null where robot r did not.
Per object it holds three lists more: reached_by (numbers of the robots that reach it), near (the objects of the stage
that are too near to it for two robots at once, by their place among these, itself included) and attempt_by (which robot
made each of its past attempts, oldest first), which a log may leave out.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pandas as pd
import pyarrow as pa
from jaxtyping import Array, Bool, Int

from halfseen.arrays import on_device
from halfseen.logs import Logs
from halfseen.logs.checks.robots import robots_that_may_drop_out
from halfseen.logs.columns import require_columns
from halfseen.logs.refusal import refuse, shown, value_at
from halfseen.team.log_checks import (
    ATTEMPT_BY,
    check_attempts,
    check_doings,
    check_drop_outs,
    check_lists,
    check_numbers,
    check_reached,
    robots_in,
)
from halfseen.team.state import Robots, TeamState, Workspace
from halfseen.world.action_space import TARGETED, ActionSpace
from halfseen.world.cuts import CutEpisodes, CutKind
from halfseen.world.number import Number
from halfseen.world.recording import VERB_NAMES, attempt_slots, lists_of, objects_of, paths_of, stages_of
from halfseen.world.recording import states_of as table_states_of
from halfseen.world.scene import Scene
from halfseen.world.state import NO_ATTEMPT, TableState
from halfseen.world.table_checks import Lists, checked_objects, lists_in, object_numbers

TEAM_VERBS = (*VERB_NAMES, "WAIT")
FREE, PARKED, OUT = "FREE", "PARKED", "OUT"
DROP_OUT_CAUSE = "battery"
_OF_ROBOT = ("does", "since_s", "decisions_to_go")
_FREE, _PARKED, _OUT, _UNKNOWN = -1, -2, -3, -4
_IDLE = {FREE: _FREE, PARKED: _PARKED, OUT: _OUT}


def to_logs(
    cuts: CutEpisodes,
    kind: CutKind | str,
    scenes: Sequence[Scene],
    dirty_share: Number | None = None,
    drop_out_cause: str = DROP_OUT_CAUSE,
) -> Logs:
    """Write down what a recorder would have kept of these episodes of a team.

    Parameters
    ----------
    cuts
        The episodes, whose states are those of a team; path k began from scene k modulo their number.
    kind
        How they were cut.
    scenes
        Where they began.
    dirty_share
        P(DIRTY) of an object before any label; None if it is not to be told.
    drop_out_cause
        What it is called when a robot drops out alone.
    """
    states, begun = cuts.episodes.states, np.argwhere(cuts.is_begun)
    of_table = replace(cuts, episodes=replace(cuts.episodes, states=states.table))
    stages = stages_of(of_table, begun, TEAM_VERBS).assign(**_robots(states, begun), **_own_rewards(cuts, begun))
    paths = paths_of(cuts, kind, scenes, dirty_share).assign(**_drop_outs(cuts, drop_out_cause))
    return Logs(stages, paths, _objects(cuts, of_table, begun))


def _own_rewards(cuts: CutEpisodes, begun: Int[np.ndarray, "rows 2"]) -> dict[str, pd.Series]:
    path, stage = begun.T
    reward = np.asarray(cuts.episodes.of_robots.reward, dtype=np.float64)[path, stage]
    of_stage = np.where(cuts.is_completed[path, stage, None], reward, np.nan)
    return {f"{r}_reward": pd.Series(values) for r, values in enumerate(of_stage.T)}


def _drop_outs(cuts: CutEpisodes, cause: str) -> dict[str, pd.Series]:
    """When each robot dropped out, and why; null where it did not before the path's end."""
    if cuts.episodes.of_robots.out_s is None:
        return {}
    into_s = np.asarray(cuts.episodes.of_robots.out_s, dtype=np.float64)
    duration_s = np.where(cuts.is_completed, np.asarray(cuts.episodes.duration_s, dtype=np.float64), 0.0)
    begin_s = np.cumsum(duration_s, axis=1) - duration_s
    out_s = np.where(cuts.is_begun[..., None], begin_s[..., None] + into_s, np.inf).min(axis=1)
    is_seen = np.isfinite(out_s) & (out_s <= cuts.end_s[:, None])
    found: dict[str, pd.Series] = {}
    for r in range(is_seen.shape[1]):
        found[f"{r}_out_s"] = pd.Series(np.where(is_seen[:, r], out_s[:, r], np.nan))
        found[f"{r}_out_cause"] = pd.Series(cause, index=range(len(is_seen)), dtype=object).where(is_seen[:, r], None)
    return found


def _objects(cuts: CutEpisodes, of_table: CutEpisodes, begun: Int[np.ndarray, "rows 2"]) -> pa.Table:
    objects = objects_of(of_table.episodes.states, begun)
    path, stage, target = (objects[name].to_numpy() for name in ("path", "stage", "object"))
    workspace, table = cuts.episodes.states.workspace, of_table.episodes.states
    reached = np.asarray(workspace.is_in_reach)[path, stage - 1, :, target]
    near = np.asarray(workspace.is_near)[path, stage - 1, target] & np.asarray(table.is_object)[path, 0]
    is_attempt = np.asarray(table.attempt_object)[path, stage - 1] == target[:, None]
    robots, others = np.arange(reached.shape[1]), np.arange(near.shape[1])
    lists = {"reached_by": (robots, reached), "near": (others, near)}
    lists[ATTEMPT_BY] = attempted_by(cuts.episodes.states, np.asarray(cuts.episodes.action))[path], is_attempt
    for name, (values, is_one) in lists.items():
        objects = objects.append_column(name, lists_of(np.broadcast_to(values, is_one.shape), is_one))
    return objects


def attempted_by(states: TeamState, action: Int[np.ndarray, "n T"]) -> Int[np.ndarray, "n A"]:
    """Which robot made each attempt of a path: who was at its object in the stage before a state that tells of it.

    Parameters
    ----------
    states
        S_t, axes (n, T).
    action
        What was begun in each.
    """
    table, robots, actions = states.table, states.robots, ActionSpace(states.table.num_objects)
    tried = np.asarray(table.attempt_object)
    stage = np.maximum(np.argmax(tried != NO_ATTEMPT, axis=1) - 1, 0)
    path, slot = np.indices(stage.shape)
    is_decider = np.asarray(states.decider)[path, stage][..., None] == np.arange(robots.num_robots)
    verb, target = (np.asarray(of(action[path, stage]))[..., None] for of in (actions.verb, actions.target))
    verb = np.where(is_decider, verb, np.where(np.asarray(robots.is_busy), np.asarray(robots.verb), -1)[path, stage])
    target = np.where(is_decider, target, np.asarray(robots.target)[path, stage])
    is_at_it = np.isin(verb, TARGETED) & (target == tried.max(axis=1)[path, slot][..., None])
    return np.argmax(is_at_it, axis=-1)


def states_of(logs: Logs, horizon: int) -> TeamState:
    """Rebuild S_t of every stage of a log of a team, axes (n, T); what has no row is an empty table that nobody is at.

    Parameters
    ----------
    logs
        The log.
    horizon
        T, the decisions of all robots together.

    Raises
    ------
    LogError
        The log breaks a rule of tables or of teams; see `told_by`.
    """
    table, told = table_states_of(logs, horizon), told_by(logs, horizon)
    stages, does = logs.stages, told.does
    at = pd.Index(logs.path_ids).get_indexer(stages["path"]), stages["stage"].to_numpy() - 1
    shape, num_robots = (logs.num_paths, horizon), does.shape[1]

    def spread(values: np.ndarray) -> Array:
        found = np.zeros((*shape, *values.shape[1:]), dtype=values.dtype)
        found[at] = values
        return on_device(found)

    numbers = {
        what: np.stack([stages[f"{r}_{what}"].to_numpy() for r in range(num_robots)], axis=1)
        for what in ("since_s", "decisions_to_go")
    }
    is_out = does[..., 0] == _OUT
    robots = Robots(
        is_busy=spread(does[..., 0] >= 0),
        is_parked=spread(does[..., 0] == _PARKED),
        verb=spread(np.maximum(does[..., 0], 0).astype(np.int32)),
        target=spread(does[..., 1].astype(np.int32)),
        since_s=spread(numbers["since_s"].astype(np.float32)),
        decisions_to_go=spread(numbers["decisions_to_go"].astype(np.int32)),
        is_out=spread(is_out) if is_out.any() or robots_that_may_drop_out(logs.paths) else None,
    )
    table = replace(table, attempt_robot=_attempt_robots(logs, table))
    return TeamState(table, robots, _workspaces(logs, table, told), spread(told.decider))


class Told(NamedTuple):
    """What a log tells of its robots, a row a stage, or a row an object of a stage."""

    decider: Int[np.ndarray, " rows"]
    does: Int[np.ndarray, "rows K 2"]
    """Verb (−1 if free, −2 if parked, −3 if out) and object of what each robot is at."""
    is_reached: Bool[np.ndarray, "objects K"]
    """By whom each object is reached."""
    near: Lists


def told_by(logs: Logs, horizon: int | None = None) -> Told:
    """Check what a log of a team tells of its robots, and give it.

    Parameters
    ----------
    logs
        A log that holds what logs of tables must (`halfseen.world.table_checks`).
    horizon
        T, the decisions of all robots together; None where it is not known.

    Raises
    ------
    LogError
        A rule of teams is broken (`team.log_checks`), a column of a robot is missing, or a robot is none of them.
    """
    stages, objects, num_robots = logs.stages, logs.objects, robots_in(logs)
    each = range(max(num_robots, 1))
    require_columns("stages", stages, ("robot", *(f"{r}_{what}" for r in each for what in _OF_ROBOT)))
    assert objects is not None, "a log of tables has objects"
    require_columns("objects", objects, ("reached_by", "near"))
    check_drop_outs(logs.paths, num_robots)
    decider = _decider(stages, num_robots)
    does = np.stack([_doing(stages, r) for r in range(num_robots)], axis=1)
    check_doings(logs, decider, does, _FREE)
    check_numbers(stages, decider, num_robots, horizon)
    reach, near = lists_in(objects, "reached_by"), lists_in(objects, "near")
    check_lists(objects, reach, near, num_robots)
    check_attempts(objects, num_robots)
    is_reached = np.zeros((len(objects), num_robots), dtype=bool)
    is_reached[reach.row, reach.values.astype(np.int64)] = True
    check_reached(logs, decider, is_reached)
    return Told(decider, does, is_reached, near)


def check_log(logs: Logs) -> None:
    """Refuse what is no log of a team at tables, as a learner would; a `LogRecorder` asks it at each stage, as `check`.

    Parameters
    ----------
    logs
        The log.

    Raises
    ------
    LogError
        It breaks a rule of tables (`halfseen.world.table_checks`) or of teams (`team.log_checks`).
    """
    checked_objects(logs, logs.horizon)
    told_by(logs)


def _decider(stages: pd.DataFrame, num_robots: int) -> Int[np.ndarray, " rows"]:
    decider = pd.Index(range(num_robots)).get_indexer(stages["robot"])
    remedy = f"its columns tell of robots 0 to {num_robots - 1}; name it so, or add what it does"
    refuse(stages, decider < 0, lambda row: f"robot is {shown(value_at(stages, 'robot', row))}, but {remedy}")
    return decider.astype(np.int32)


def _doing(stages: pd.DataFrame, robot: int) -> Int[np.ndarray, "rows 2"]:
    """Verb and object of what a robot is at, as `Told` has them."""
    code, words = pd.factorize(stages[f"{robot}_does"], use_na_sentinel=False)
    known = np.array([_parsed(str(each)) for each in words], dtype=np.int64).reshape(-1, 2)
    wrong = known[:, 0] == _UNKNOWN
    remedy = f"it is {', '.join((*_IDLE, *TEAM_VERBS))}, the verbs of an object with its number"
    refuse(stages, wrong[code], lambda row: f"{robot}_does is {shown(words[code[row]])}; {remedy}")
    return known[code]


def _parsed(words: str) -> tuple[int, int]:
    verb, _, target = words.partition(" ")
    if words in _IDLE:
        return _IDLE[words], 0
    if verb not in TEAM_VERBS or (target.isdecimal() != (TEAM_VERBS.index(verb) in TARGETED)):
        return _UNKNOWN, 0
    return TEAM_VERBS.index(verb), int(target or 0)


def _attempt_robots(logs: Logs, table: TableState) -> Int[Array, "n T A"] | None:
    """Who made each past attempt; None where the log does not tell."""
    assert logs.objects is not None
    if ATTEMPT_BY not in logs.objects.columns:
        return None
    by = lists_in(logs.objects, ATTEMPT_BY)
    path = pd.Index(logs.path_ids).get_indexer(logs.objects["path"])[by.row]
    stage = logs.objects["stage"].to_numpy()[by.row] - 1
    found = np.zeros(table.attempt_object.shape, dtype=np.int32)
    found[path, stage, attempt_slots(path, stage)] = by.values
    return on_device(found)


def _workspaces(logs: Logs, table: TableState, told: Told) -> Workspace:
    assert logs.objects is not None
    objects, near = logs.objects, told.near
    number, shape = object_numbers(objects), table.is_object.shape
    path, stage, target = pd.Index(logs.path_ids).get_indexer(objects["path"]), objects["stage"].to_numpy() - 1, number
    begin = np.arange(len(objects)) - objects.groupby(["path", "stage"]).cumcount().to_numpy()
    is_in_reach = np.zeros((*shape[:2], told.is_reached.shape[1], shape[2]), dtype=bool)
    is_near = np.zeros((*shape, shape[2]), dtype=bool)
    is_in_reach[path, stage, :, target] = told.is_reached
    other = number[begin[near.row] + near.values.astype(np.int64)]
    is_near[path[near.row], stage[near.row], target[near.row], other] = True
    return Workspace(*on_device((is_in_reach, is_near)))


def _robots(states: TeamState, begun: Int[np.ndarray, "rows 2"]) -> dict[str, pd.Series]:
    path, stage = begun.T
    robots = states.robots
    found = {"robot": pd.Series(np.asarray(states.decider)[path, stage].astype(np.int64))}
    for r in range(robots.num_robots):
        at = path, stage, r
        is_busy, verb = np.asarray(robots.is_busy)[at], np.asarray(robots.verb)[at]
        objects = np.char.add(" ", np.asarray(robots.target)[at].astype(str))
        words = np.char.add(np.array(TEAM_VERBS)[verb], np.where(np.isin(verb, TARGETED), objects, ""))
        idle = np.where(np.asarray(robots.is_parked)[at], PARKED, FREE)
        if robots.is_out is not None:
            idle = np.where(np.asarray(robots.is_out)[at], OUT, idle)
        found[f"{r}_does"] = pd.Series(np.where(is_busy, words, idle))
        found[f"{r}_since_s"] = pd.Series(np.where(is_busy, np.asarray(robots.since_s, dtype=np.float64)[at], 0.0))
        found[f"{r}_decisions_to_go"] = pd.Series(np.asarray(robots.decisions_to_go)[at].astype(np.int64))
    return found
