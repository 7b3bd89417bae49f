"""What a log says of several robots at one table: which of them decided, and what the others were at.

Beside the columns of one robot's log, a stage holds `robot` (from 0) and, for each robot r, what it was at when that
stage began: r_does ("WASH 3", "WAIT", "FREE", "PARKED", "OUT"), r_since_s (for how long, 0 where it is free) and
r_decisions_to_go; and r_reward, what the stage would have paid it had it been alone (its own attempts that ended in it,
the price of its seconds, and at its own end that of what was left dirty in its reach).
Where robots may drop out, a path holds r_out_s and r_out_cause, null where robot r did not.
Per object it holds three lists more: reached_by (numbers of the robots that reach it), near (the objects of the stage
that are too near to it for two robots at once, by their place among these, itself included) and attempt_by (which robot
made each of its past attempts, oldest first), which a log may leave out.

The log of a team as if every drop-out of one robot had ended the table: for the value as if nobody dropped out.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pyarrow as pa
from jaxtyping import Bool, Int

from halfseen.logs import Logs
from halfseen.logs.checks.robots import robots_that_may_drop_out
from halfseen.logs.columns import CUT, is_own_reward, require_columns
from halfseen.logs.refusal import refuse, shown, value_at
from halfseen.world.actions import TARGETED, VERB_NAMES, ActionSpace
from halfseen.world.cuts import CutEpisodes
from halfseen.world.log_checks import (
    ATTEMPT_BY,
    Lists,
    check_attempts,
    check_doings,
    check_drop_outs,
    check_lists,
    check_numbers,
    check_reached,
    lists_in,
    object_numbers,
    robots_in,
)
from halfseen.world.state import NO_ATTEMPT, Robots, TableState, Workspace

FREE, PARKED, OUT = "FREE", "PARKED", "OUT"
DROP_OUT_CAUSE = "battery"
_OF_ROBOT = ("does", "since_s", "decisions_to_go")
_FREE, _PARKED, _OUT, _UNKNOWN = -1, -2, -3, -4
_IDLE = {FREE: _FREE, PARKED: _PARKED, OUT: _OUT}


def robot_columns(states: TableState, begun: Int[np.ndarray, "rows 2"]) -> dict[str, pd.Series]:
    """Who decided in the stages that were begun, (path, stage) from 0, and what each robot was at."""
    path, stage = begun.T
    robots, decider = states.robots, states.decider
    assert robots is not None
    assert decider is not None
    found = {"robot": pd.Series(decider[path, stage].astype(np.int64))}
    for r in range(robots.num_robots):
        at = path, stage, r
        is_busy, verb = robots.is_busy[at], robots.verb[at]
        objects = np.char.add(" ", robots.target[at].astype(str))
        words = np.char.add(np.array(VERB_NAMES)[verb], np.where(np.isin(verb, TARGETED), objects, ""))
        idle = np.where(robots.is_parked[at], PARKED, FREE)
        if robots.is_out is not None:
            idle = np.where(robots.is_out[at], OUT, idle)
        found[f"{r}_does"] = pd.Series(np.where(is_busy, words, idle))
        found[f"{r}_since_s"] = pd.Series(np.where(is_busy, robots.since_s[at].astype(np.float64), 0.0))
        found[f"{r}_decisions_to_go"] = pd.Series(robots.decisions_to_go[at].astype(np.int64))
    return found


def own_rewards(cuts: CutEpisodes, begun: Int[np.ndarray, "rows 2"]) -> dict[str, pd.Series]:
    """What each stage that was begun would have paid each robot had it been alone; NaN where it was cut."""
    path, stage = begun.T
    assert cuts.episodes.paid_alone is not None
    reward = cuts.episodes.paid_alone[path, stage].astype(np.float64)
    of_stage = np.where(cuts.is_completed[path, stage, None], reward, np.nan)
    return {f"{r}_reward": pd.Series(values) for r, values in enumerate(of_stage.T)}


def drop_out_columns(cuts: CutEpisodes, cause: str) -> dict[str, pd.Series]:
    """When each robot dropped out, and why; null where it did not before the path's end."""
    if cuts.episodes.out_s is None:
        return {}
    into_s = np.asarray(cuts.episodes.out_s, dtype=np.float64)
    duration_s = np.where(cuts.is_completed, np.asarray(cuts.episodes.duration_s, dtype=np.float64), 0.0)
    begin_s = np.cumsum(duration_s, axis=1) - duration_s
    out_s = np.where(cuts.is_begun[..., None], begin_s[..., None] + into_s, np.inf).min(axis=1)
    is_seen = np.isfinite(out_s) & (out_s <= cuts.end_s[:, None])
    found: dict[str, pd.Series] = {}
    for r in range(is_seen.shape[1]):
        found[f"{r}_out_s"] = pd.Series(np.where(is_seen[:, r], out_s[:, r], np.nan))
        found[f"{r}_out_cause"] = pd.Series(cause, index=range(len(is_seen)), dtype=object).where(is_seen[:, r], None)
    return found


def with_robot_lists(objects: pa.Table, states: TableState, action: Int[np.ndarray, "n T"]) -> pa.Table:
    """Add to the objects of a log who reaches each, what is near to it, and who made its attempts."""
    path, stage, target = (objects[name].to_numpy() for name in ("path", "stage", "object"))
    at, workspace = (path, stage - 1), states.workspace
    assert workspace is not None
    reached = workspace.is_in_reach[*at, :, target]
    near = workspace.is_near[*at, target] & states.is_object[path, 0]
    is_attempt = states.attempt_object[at] == target[:, None]
    robots, others = np.arange(reached.shape[1]), np.arange(near.shape[1])
    lists = {"reached_by": (robots, reached), "near": (others, near)}
    lists[ATTEMPT_BY] = attempted_by(states, action)[path], is_attempt
    for name, (values, is_one) in lists.items():
        objects = objects.append_column(name, lists_of(np.broadcast_to(values, is_one.shape), is_one))
    return objects


def lists_of(values: np.ndarray, is_kept: Bool[np.ndarray, "rows k"]) -> pa.ListArray:
    """A list a row, of the values that are kept."""
    offsets = np.concatenate([[0], np.cumsum(is_kept.sum(axis=1))]).astype(np.int32)
    return pa.ListArray.from_arrays(pa.array(offsets), pa.array(values[is_kept]))


def attempted_by(states: TableState, action: Int[np.ndarray, "n T"]) -> Int[np.ndarray, "n A"]:
    """Which robot made each attempt of a path: who was at its object in the stage before a state that tells of it.

    Parameters
    ----------
    states
        S_t, axes (n, T).
    action
        What was begun in each.
    """
    tried, robots, actions = states.attempt_object, states.robots, ActionSpace(states.num_objects)
    assert robots is not None
    assert states.decider is not None
    stage = np.maximum(np.argmax(tried != NO_ATTEMPT, axis=1) - 1, 0)
    path, slot = np.indices(stage.shape)
    is_decider = states.decider[path, stage][..., None] == np.arange(robots.num_robots)
    verb, target = (of(action[path, stage])[..., None] for of in (actions.verb, actions.target))
    verb = np.where(is_decider, verb, np.where(robots.is_busy, robots.verb, -1)[path, stage])
    target = np.where(is_decider, target, robots.target[path, stage])
    is_at_it = np.isin(verb, TARGETED) & (target == tried.max(axis=1)[path, slot][..., None])
    return np.argmax(is_at_it, axis=-1)


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
        A log that holds what logs of tables must (`log_checks`).
    horizon
        T, the decisions of all robots together; None where it is not known.

    Raises
    ------
    LogError
        A rule of robots is broken (`log_checks`), a column of a robot is missing, or a robot is none of them.
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
    remedy = f"it is {', '.join((*_IDLE, *VERB_NAMES))}, the verbs of an object with its number"
    refuse(stages, wrong[code], lambda row: f"{robot}_does is {shown(words[code[row]])}; {remedy}")
    return known[code]


def _parsed(words: str) -> tuple[int, int]:
    verb, _, target = words.partition(" ")
    if words in _IDLE:
        return _IDLE[words], 0
    if verb not in VERB_NAMES or (target.isdecimal() != (VERB_NAMES.index(verb) in TARGETED)):
        return _UNKNOWN, 0
    return VERB_NAMES.index(verb), int(target or 0)


def attempt_slots(path: Int[np.ndarray, " n"], stage: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """Where the state of a stage holds its past attempts, told object by object: one after the other."""
    return pd.Series(path).groupby([path, stage]).cumcount().to_numpy()


def robots_by(logs: Logs, told: Told, states: TableState) -> Mapping[str, Any]:
    """What states of a log that tells of robots hold of them, by field, axes (n, T).

    Parameters
    ----------
    logs
        The log.
    told
        What it tells of its robots.
    states
        S_t without them.
    """
    stages, does = logs.stages, told.does
    at = pd.Index(logs.path_ids).get_indexer(stages["path"]), stages["stage"].to_numpy() - 1

    def spread(values: np.ndarray) -> np.ndarray:
        found = np.zeros((*states.steps_to_go.shape, *values.shape[1:]), dtype=values.dtype)
        found[at] = values
        return found

    def numbers(what: str) -> np.ndarray:
        return np.stack([stages[f"{r}_{what}"].to_numpy() for r in range(does.shape[1])], axis=1)

    is_out = does[..., 0] == _OUT
    robots = Robots(
        is_busy=spread(does[..., 0] >= 0),
        is_parked=spread(does[..., 0] == _PARKED),
        verb=spread(np.maximum(does[..., 0], 0).astype(np.int32)),
        target=spread(does[..., 1].astype(np.int32)),
        since_s=spread(numbers("since_s").astype(np.float32)),
        decisions_to_go=spread(numbers("decisions_to_go").astype(np.int32)),
        is_out=spread(is_out) if is_out.any() or robots_that_may_drop_out(logs.paths) else None,
    )
    return {
        "robots": robots,
        "workspace": _workspaces(logs, states, told),
        "decider": spread(told.decider),
        "attempt_robot": _attempt_robots(logs, states),
    }


def _attempt_robots(logs: Logs, states: TableState) -> Int[np.ndarray, "n T A"] | None:
    """Who made each past attempt; None where the log does not tell."""
    assert logs.objects is not None
    if ATTEMPT_BY not in logs.objects.columns:
        return None
    by = lists_in(logs.objects, ATTEMPT_BY)
    path = pd.Index(logs.path_ids).get_indexer(logs.objects["path"])[by.row]
    stage = logs.objects["stage"].to_numpy()[by.row] - 1
    found = np.zeros(states.attempt_object.shape, dtype=np.int32)
    found[path, stage, attempt_slots(path, stage)] = by.values
    return found


def _workspaces(logs: Logs, states: TableState, told: Told) -> Workspace:
    assert logs.objects is not None
    objects, near = logs.objects, told.near
    number, shape = object_numbers(objects), states.is_object.shape
    path, stage, target = pd.Index(logs.path_ids).get_indexer(objects["path"]), objects["stage"].to_numpy() - 1, number
    begin = np.arange(len(objects)) - objects.groupby(["path", "stage"]).cumcount().to_numpy()
    is_in_reach = np.zeros((*shape[:2], told.is_reached.shape[1], shape[2]), dtype=bool)
    is_near = np.zeros((*shape, shape[2]), dtype=bool)
    is_in_reach[path, stage, :, target] = told.is_reached
    other = number[begin[near.row] + near.values.astype(np.int64)]
    is_near[path[near.row], stage[near.row], target[near.row], other] = True
    return Workspace(is_in_reach, is_near)


def cut_at_drop_outs(logs: Logs) -> Logs:
    """Cut each path where its first robot dropped out, with the cause of that.

    The stage in which it fell is not completed, also where it ended there since robots that waited were free: without
    the drop-out it would have gone on.

    Parameters
    ----------
    logs
        The log of a team.
    """
    robots = robots_that_may_drop_out(logs.paths)
    if not robots:
        return logs
    out_s = logs.paths[[f"{r}_out_s" for r in robots]].to_numpy(dtype=np.float64)
    first = np.argmin(np.where(np.isnan(out_s), np.inf, out_s), axis=1)
    rows = np.arange(len(out_s))
    first_s, is_out = out_s[rows, first], ~np.isnan(out_s).all(axis=1)
    causes = np.stack([_causes(logs.paths, r) for r in robots], axis=1)[rows, first]
    paths = logs.paths.drop(columns=[f"{r}_{what}" for r in robots for what in ("out_s", "out_cause")], errors="ignore")
    paths = paths.assign(
        end_s=np.where(is_out, first_s, paths["end_s"]),
        ending=np.where(is_out, CUT, paths["ending"]),
        cause=np.where(is_out, causes, paths["cause"].astype(object)),
    )
    return Logs(*_stages_before(logs, paths, first_s), reward_unit=logs.reward_unit)


def _causes(paths: pd.DataFrame, robot: int) -> np.ndarray:
    name = f"{robot}_out_cause"
    return paths[name].to_numpy(dtype=object) if name in paths.columns else np.full(len(paths), None, dtype=object)


def _stages_before(logs: Logs, paths: pd.DataFrame, first_s: np.ndarray) -> Any:
    """Stages, paths and objects, up to the stage in which the first drop-out of each path fell."""
    stages = logs.stages
    path_row = pd.Index(logs.path_ids).get_indexer(stages["path"])
    at_s = first_s[path_row]
    begin_s = stages["elapsed_s"].groupby(path_row).shift(fill_value=0.0).to_numpy()
    is_after = begin_s >= at_s
    is_in = ~is_after & ~(stages["elapsed_s"].to_numpy() < at_s) & ~np.isnan(at_s)
    outcomes = ["elapsed_s", "reward", *filter(is_own_reward, stages.columns)]
    stages = stages.assign(**{name: stages[name].mask(pd.Series(is_in)) for name in outcomes})[~is_after]
    if logs.objects is None:
        return stages, paths
    kept = pd.DataFrame(stages[["path", "stage"]])
    return stages, paths, logs.objects.merge(kept, on=["path", "stage"])
