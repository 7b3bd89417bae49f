"""Conversion of cut episodes to `Logs`, and of logs of tables back to the states that a policy saw.

Per object and stage, a log holds location ("TABLE" or "DISHWASHER"; "LOST" if it is in neither), occlusion, grip (mean
of its grip offset, given what is observed), log_odds (of DIRTY), seen (share of its surface that labels have covered),
successes and failures (of past grasps), lifts, and three lists: hidden_by (the share of it that each object of the
scene hides alone, in object order), attempt_occlusions and attempt_succeeded (its past attempts, oldest first). The
columns grip and seen are omitted if they are 0 throughout, and read as 0 if missing.
Per trajectory, it holds the scene's name, and dirty_share: P(DIRTY) of an object before any label, where log_odds
start.

For a team, a stage also holds `robot` (the robot that decided, from 0) and, for each robot r, its state when the stage
began: r_does ("WASH 3", "WAIT", "FREE", "PARKED", "OUT"), r_since_s (elapsed time, 0 if it is free) and
r_decisions_to_go; and r_reward, the reward of the stage had the robot been alone (its own attempts that ended in it,
the price of its seconds, and at its own end the penalty for dirty objects left in its reach).
If robots may drop out, a trajectory holds r_out_s and r_out_cause, null if robot r did not drop out.
Each object has three more lists: reached_by (the robots that reach it), near (indices of the stage's objects that are
too near to it for two robots at once, itself included) and, optionally, attempt_by (the robot of each of its past
attempts, oldest first).
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from halfseen.arrays import Number, mapped
from halfseen.errors import LogError
from halfseen.logs import Logs
from halfseen.logs.columns import robots_that_may_drop_out
from halfseen.shapes import Bool, Float, Int
from halfseen.world.actions import TARGETED, VERB_NAMES, ActionSpace
from halfseen.world.cuts import CAUSES, DROP_OUT_CAUSE, CutEpisodes, CutKind, drop_out_columns
from halfseen.world.log_checks import ATTEMPT_BY, DISHWASHER, TABLE, checked_tables
from halfseen.world.log_rows import FREE, IDLE, OUT, PARKED, TableLog
from halfseen.world.scene import Scene
from halfseen.world.state import NO_ATTEMPT, Robots, TableState, Workspace, attempt_counts, occlusion


def to_logs(
    cuts: CutEpisodes,
    kind: CutKind | str,
    scenes: Sequence[Scene],
    dirty_share: Number | None = None,
    drop_out_cause: str = DROP_OUT_CAUSE,
) -> Logs:
    """Convert episodes to the logs that a recorder would have kept.

    Parameters
    ----------
    cuts
        The episodes; trajectory k began from scene k modulo their number.
    kind
        How they were cut.
    scenes
        Their initial scenes.
    dirty_share
        P(DIRTY) of an object before any label, where the log-odds start; None to omit it.
    drop_out_cause
        Cause recorded when one of several robots drops out alone.
    """
    begun, num_trajectories = np.argwhere(cuts.is_begun), len(cuts.end_s)
    cause = np.full(num_trajectories, CAUSES[kind], dtype=object)
    cause[cuts.is_finished] = None
    trajectories = {
        "trajectory": np.arange(num_trajectories),
        "end_s": cuts.end_s,
        "ending": np.where(cuts.is_finished, "finished", "cut"),
        "cause": cause,
        "scene": [scenes[k % len(scenes)].name for k in range(num_trajectories)],
        **({} if dirty_share is None else {"dirty_share": float(dirty_share)}),
        **drop_out_columns(cuts, drop_out_cause),
    }
    stages = {**_stage_columns(cuts, begun), **_robot_columns(cuts, begun)}
    return Logs(pd.DataFrame(stages), pd.DataFrame(trajectories), objects_of(cuts.episodes.states, begun))


def elapsed_s(cuts: CutEpisodes) -> Float[np.ndarray, "n T"]:
    """U_t of each completed stage [s], NaN elsewhere."""
    duration_s = np.asarray(cuts.episodes.duration_s, dtype=np.float64)
    return np.where(cuts.is_completed, np.cumsum(np.where(cuts.is_completed, duration_s, 0.0), axis=1), np.nan)


def _stage_columns(cuts: CutEpisodes, begun: Int[np.ndarray, "rows 2"]) -> dict[str, Any]:
    """Actions, rewards and times of the stages that were begun, given as (trajectory, stage) from 0."""
    trajectory, stage = begun.T
    episodes, actions = cuts.episodes, ActionSpace(cuts.episodes.states.num_objects)
    action = episodes.action[trajectory, stage]
    verb, reward = actions.verb(action), episodes.reward[trajectory, stage].astype(np.float64)
    return {
        "trajectory": trajectory,
        "stage": stage + 1,
        "elapsed_s": elapsed_s(cuts)[trajectory, stage],
        "action": np.array(VERB_NAMES)[verb],
        "object": pd.Series(actions.target(action), dtype="Int64").mask(~np.isin(verb, TARGETED)),
        "reward": np.where(cuts.is_completed[trajectory, stage], reward, np.nan),
        "probability": episodes.probability[trajectory, stage].astype(np.float64),
    }


def _robot_columns(cuts: CutEpisodes, begun: Int[np.ndarray, "rows 2"]) -> dict[str, Any]:
    """For a team: the deciding robot, what each robot was doing, and the reward of each had it been alone."""
    episodes, at = cuts.episodes, (*begun.T,)
    states, paid_alone = episodes.states, episodes.paid_alone
    if states.robots is None or states.decider is None or paid_alone is None:
        return {}
    robots = mapped(lambda leaf: leaf[at], states.robots)
    objects = np.char.add(" ", robots.target.astype(str))
    words = np.char.add(np.array(VERB_NAMES)[robots.verb], np.where(np.isin(robots.verb, TARGETED), objects, ""))
    idle = np.where(robots.is_parked, PARKED, FREE)
    idle = idle if robots.is_out is None else np.where(robots.is_out, OUT, idle)
    was_at = {
        "does": np.where(robots.is_busy, words, idle),
        "since_s": np.where(robots.is_busy, robots.since_s.astype(np.float64), 0.0),
        "decisions_to_go": robots.decisions_to_go.astype(np.int64),
    }
    reward = np.where(cuts.is_completed[at][:, None], paid_alone[at].astype(np.float64), np.nan)
    each = range(robots.num_robots)
    return {
        "robot": states.decider[at].astype(np.int64),
        **{f"{r}_{what}": values[:, r] for r in each for what, values in was_at.items()},
        **{f"{r}_reward": reward[:, r] for r in each},
    }


def objects_of(states: TableState, begun: Int[np.ndarray, "rows 2"]) -> pa.Table:
    """Observations of each object in the stages that were begun (indexed from 0); states have axes (n, T)."""
    is_object = states.is_object[:, 0][begun[:, 0]]
    row, target = np.nonzero(is_object)
    trajectory, stage = begun[row].T
    seen = mapped(lambda leaf: leaf[begun[:, 0], begun[:, 1]], replace(states, robots=None, workspace=None))
    occluded, successes, failures = (values[row, target] for values in (occlusion(seen), *attempt_counts(seen)))
    is_attempt = seen.attempt_object[row] == target[:, None]
    shown = {"grip": seen.grip[row, target], "seen": seen.seen[row, target]}
    lists = {
        "hidden_by": (seen.hides[row, target].astype(np.float64), is_object[row]),
        "attempt_occlusions": (seen.attempt_occlusion[row].astype(np.float64), is_attempt),
        "attempt_succeeded": (seen.attempt_succeeded[row], is_attempt),
    }
    if states.workspace is not None:
        is_reached, near = states.workspace.is_in_reach[trajectory, stage, :, target], states.workspace.is_near
        lists["reached_by"] = np.arange(is_reached.shape[1]), is_reached
        lists["near"] = np.arange(states.num_objects), near[trajectory, stage, target] & is_object[row]
    if seen.attempt_robot is not None:
        lists[ATTEMPT_BY] = seen.attempt_robot[row].astype(np.int64), is_attempt
    return pa.table(
        {
            "trajectory": trajectory,
            "stage": stage + 1,
            "object": target,
            "location": np.where(seen.is_on_table[row, target], TABLE, DISHWASHER).tolist(),
            "occlusion": occluded.astype(np.float64),
            **{name: values.astype(np.float64) for name, values in shown.items() if values.any()},
            "log_odds": seen.log_odds[row, target].astype(np.float64),
            "successes": successes.astype(np.int64),
            "failures": failures.astype(np.int64),
            "lifts": seen.lifts[row, target].astype(np.int64),
            **{name: _lists(*each) for name, each in lists.items()},
        }
    )


def _lists(values: np.ndarray, is_kept: Bool[np.ndarray, "rows k"]) -> pa.ListArray:
    """One list per row, of the values that are kept."""
    offsets = np.concatenate([[0], np.cumsum(is_kept.sum(axis=1))]).astype(np.int32)
    return pa.ListArray.from_arrays(pa.array(offsets), pa.array(np.broadcast_to(values, is_kept.shape)[is_kept]))


def states_of(logs: Logs, horizon: int) -> TableState:
    """Rebuild S_t of every stage of a log of tables, axes (n, T); a stage without rows is an empty table.

    Objects are numbered by `object_numbers`; an object not yet in view is padding. If the log has columns of robots,
    the states hold robots, but none at a table without rows.

    `horizon` is T, the number of decisions over all robots.

    Raises
    ------
    LogError
        The log breaks a rule of tables or of robots; see `log_checks`.
    """
    log = checked_tables(logs, horizon)
    frame, shape = log.objects, (logs.num_trajectories, horizon, log.num_objects)
    at = (*_stage_places(logs, frame), log.target)

    def each(values: Any, dtype: Any) -> np.ndarray:
        return spread(np.asarray(values, dtype=dtype), at, shape)

    types = {"grip": np.float32, "log_odds": np.float32, "seen": np.float32, "lifts": np.int32}
    numbers = {name: each(frame.get(name, 0), dtype) for name, dtype in types.items()}
    # Lists are indexed by the objects of their stage, states by those of the trajectory.
    hidden_by = log.lists("hidden_by")
    hider = log.target[log.first[hidden_by.row] + hidden_by.place]
    hides = (*(index[hidden_by.row] for index in at), hider)
    return TableState(
        hides=spread(hidden_by.values.astype(np.float32), hides, (*shape, shape[-1])),
        is_object=each(True, bool),
        is_on_table=each(frame["location"] == TABLE, bool),
        **numbers,
        **_attempts(log, at, (*shape[:2], horizon)),
        steps_to_go=np.broadcast_to(horizon - np.arange(horizon, dtype=np.int32), shape[:2]),
        **(_of_robots(log, at, shape) if log.num_robots else {}),
    )


def _stage_places(logs: Logs, frame: pd.DataFrame) -> tuple[Int[np.ndarray, " rows"], Int[np.ndarray, " rows"]]:
    """Trajectory and stage of each row, from 0."""
    return pd.Index(logs.trajectory_ids).get_indexer(frame["trajectory"]), frame["stage"].to_numpy() - 1


def spread(values: np.ndarray, at: tuple[np.ndarray, ...], shape: tuple[int, ...], fill: float | int = 0) -> np.ndarray:
    """Scatter values to their indices in an array of a shape, filled elsewhere with `fill`."""
    found = np.full((*shape, *values.shape[1:]), fill, dtype=values.dtype)
    found[at] = values
    return found


def _attempts(log: TableLog, at: tuple[np.ndarray, ...], shape: tuple[int, ...]) -> dict[str, Any]:
    """Past attempts of each stage, gathered from the objects; their order across objects has no meaning."""
    occluded, succeeded = log.lists("attempt_occlusions"), log.lists("attempt_succeeded")
    trajectory, stage, target = (index[occluded.row] for index in at)
    slot = pd.Series(trajectory).groupby([trajectory, stage]).cumcount().to_numpy()
    if len(slot) and slot.max() >= shape[-1]:
        where = log.objects.iloc[occluded.row[np.argmax(slot)]]
        raise LogError(
            f"trajectory {where['trajectory']}, stage {where['stage']}: {slot.max() + 1} past attempts, more "
            f"than the horizon of {shape[-1]} stages allows; raise horizon or fix attempt_occlusions"
        )
    place = trajectory, stage, slot
    found = {
        "attempt_object": spread(target.astype(np.int32), place, shape, NO_ATTEMPT),
        "attempt_occlusion": spread(occluded.values.astype(np.float32), place, shape),
        "attempt_succeeded": spread(succeeded.values.astype(bool), place, shape),
    }
    if log.num_robots and ATTEMPT_BY in log.objects.columns:
        found["attempt_robot"] = spread(log.lists(ATTEMPT_BY).values.astype(np.int32), place, shape)
    return found


def _of_robots(log: TableLog, at: tuple[np.ndarray, ...], shape: tuple[int, int, int]) -> dict[str, Any]:
    """The deciding robot, what each robot is doing, and the workspace."""
    of_stage, (verb, target) = _stage_places(log.logs, log.logs.stages), np.moveaxis(log.does, -1, 0)

    def each(values: np.ndarray, dtype: Any) -> np.ndarray:
        return spread(values.astype(dtype), of_stage, shape[:2])

    is_out, near = verb == IDLE[OUT], log.lists("near")
    may_drop_out = is_out.any() or len(robots_that_may_drop_out(log.logs.trajectories)) > 0
    robots = Robots(
        is_busy=each(verb >= 0, bool),
        is_parked=each(verb == IDLE[PARKED], bool),
        verb=each(np.maximum(verb, 0), np.int32),
        target=each(target, np.int32),
        since_s=each(log.of_robots("since_s"), np.float32),
        decisions_to_go=each(log.of_robots("decisions_to_go"), np.int32),
        is_out=each(is_out, bool) if may_drop_out else None,
    )
    other = log.target[log.first[near.row] + near.values.astype(np.int64)]
    is_near = spread(np.ones(len(other), dtype=bool), (*(index[near.row] for index in at), other), (*shape, shape[-1]))
    is_in_reach = np.moveaxis(spread(log.is_reached, at, shape), -1, -2)
    workspace = Workspace(np.ascontiguousarray(is_in_reach), is_near)
    return {"robots": robots, "workspace": workspace, "decider": each(log.decider, np.int32)}
