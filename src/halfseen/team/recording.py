"""From cut episodes of a team to `Logs`: those of a table, and which robot decided, and what the others were at.

Beside the columns of one robot's log, a stage holds `robot` (from 0) and, for each robot r, what it was at when that
stage began: r_does ("WASH 3", "WAIT", "FREE", "PARKED", "OUT"), r_since_s (for how long, 0 where it is free) and
r_decisions_to_go; and r_reward, what the stage would have paid it had it been alone (its own attempts that ended in it,
the price of its seconds, and at its own end that of what was left dirty in its reach).
Where robots may drop out, a path holds r_out_s and r_out_cause, null where robot r did not.
Per object it holds two lists more: reached_by (numbers of the robots that reach it) and near (the objects of the stage
that are too near to it for two robots at once, by their place among these, itself included).
"""

from collections.abc import Sequence
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pyarrow as pa
from jaxtyping import Array, Int

from halfseen.logs import Logs
from halfseen.logs.columns import require_columns
from halfseen.logs.refusal import refuse, shown, value_at
from halfseen.logs.robot_checks import robots_that_may_drop_out
from halfseen.team.log_checks import check_doings, check_lists, check_numbers, check_reached, robots_in
from halfseen.team.state import Robots, TeamState, Workspace
from halfseen.world.action_space import TARGETED
from halfseen.world.cuts import CutEpisodes, CutKind
from halfseen.world.number import Number
from halfseen.world.recording import VERB_NAMES, lists_of, objects_of, paths_of, stages_of
from halfseen.world.recording import states_of as table_states_of
from halfseen.world.scene import Scene
from halfseen.world.state import TableState
from halfseen.world.table_checks import lists_in, object_numbers

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
    return Logs(stages, paths, _objects(of_table, states.workspace, begun))


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


def _objects(of_table: CutEpisodes, workspace: Workspace, begun: Int[np.ndarray, "rows 2"]) -> pa.Table:
    objects = objects_of(of_table, begun)
    path, stage, target = (objects[name].to_numpy() for name in ("path", "stage", "object"))
    reached = np.asarray(workspace.is_in_reach)[path, stage - 1, :, target]
    near = (
        np.asarray(workspace.is_near)[path, stage - 1, target] & np.asarray(of_table.episodes.states.is_object)[path, 0]
    )
    for name, is_one in (("reached_by", reached), ("near", near)):
        objects = objects.append_column(
            name, lists_of(np.broadcast_to(np.arange(is_one.shape[1]), is_one.shape), is_one)
        )
    return objects


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
        The log breaks a rule of tables or of teams (`team.log_checks`), a column of a robot is missing, or a robot is
        none of them.
    """
    stages = logs.stages
    num_robots = robots_in(logs)
    require_columns(
        "stages", stages, ("robot", *(f"{r}_{what}" for r in range(max(num_robots, 1)) for what in _OF_ROBOT))
    )
    table = table_states_of(logs, horizon)
    at = pd.Index(logs.path_ids).get_indexer(stages["path"]), stages["stage"].to_numpy() - 1
    decider = _decider(stages, num_robots)
    shape = logs.num_paths, horizon

    def spread(values: np.ndarray) -> Array:
        found = np.zeros((*shape, *values.shape[1:]), dtype=values.dtype)
        found[at] = values
        return jnp.asarray(found)

    does = np.stack([_doing(stages, r) for r in range(num_robots)], axis=1)
    check_doings(logs, decider, does, _FREE, table.num_objects)
    check_numbers(stages, decider, num_robots)
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
    space = _workspaces(logs, table, num_robots)
    check_reached(logs, decider, np.asarray(space.is_in_reach)[(*at, decider)])
    return TeamState(table, robots, space, spread(decider))


def _decider(stages: pd.DataFrame, num_robots: int) -> Int[np.ndarray, " rows"]:
    decider = pd.Index(range(num_robots)).get_indexer(stages["robot"])
    remedy = f"its columns tell of robots 0 to {num_robots - 1}; name it so, or add what it does"
    refuse(stages, decider < 0, lambda row: f"robot is {shown(value_at(stages, 'robot', row))}, but {remedy}")
    return decider.astype(np.int32)


def _doing(stages: pd.DataFrame, robot: int) -> Int[np.ndarray, "rows 2"]:
    """Verb (−1 if free, −2 if parked, −3 if out) and object of what a robot is at."""
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


def _workspaces(logs: Logs, table: TableState, num_robots: int) -> Workspace:
    assert logs.objects is not None
    objects = logs.objects
    require_columns("objects", objects, ("reached_by", "near"))
    number, shape = object_numbers(objects), table.is_object.shape
    at = pd.Index(logs.path_ids).get_indexer(objects["path"]), objects["stage"].to_numpy() - 1, number
    begin = np.arange(len(objects)) - objects.groupby(["path", "stage"]).cumcount().to_numpy()
    reach, near = lists_in(objects, "reached_by"), lists_in(objects, "near")
    check_lists(objects, reach, near, num_robots)
    is_in_reach = np.zeros((*shape[:2], num_robots, shape[2]), dtype=bool)
    is_near = np.zeros((*shape, shape[2]), dtype=bool)
    path, stage, target = at
    is_in_reach[path[reach.row], stage[reach.row], reach.values.astype(np.int64), target[reach.row]] = True
    other = number[begin[near.row] + near.values.astype(np.int64)]
    is_near[path[near.row], stage[near.row], target[near.row], other] = True
    return Workspace(jnp.asarray(is_in_reach), jnp.asarray(is_near))


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
