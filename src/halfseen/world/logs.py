"""From cut episodes to `Logs`, and from the logs of tables back to the states that a policy saw.

Per object and stage a log holds: location ("TABLE" or "DISHWASHER"; "LOST" where it is in neither), occlusion, grip
(mean of its grip offset, from what shows of it), log_odds (of DIRTY), seen (share of its surface that labels have told
of), successes and failures (of past grasps), lifts, and three lists: hidden_by (the share of it that each object of the
scene hides alone, in the order of the objects), attempt_occlusions and attempt_succeeded (its past attempts, oldest
first). Where grip or seen are 0 throughout, they are not written, and a log without them is read so.
Per path it holds the scene's name, and dirty_share: P(DIRTY) of an object before any label, which log_odds start from.
Where several robots work, it holds what `robot_logs` says, besides.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
import pyarrow as pa
from jaxtyping import Bool, Float, Int

from halfseen.arrays import mapped
from halfseen.errors import LogError
from halfseen.logs import Logs
from halfseen.world.actions import TARGETED, VERB_NAMES, ActionSpace
from halfseen.world.cuts import CAUSES, CutEpisodes, CutKind
from halfseen.world.log_checks import DISHWASHER, TABLE, Lists, checked_objects, object_numbers, robots_in
from halfseen.world.number import Number
from halfseen.world.robot_logs import (
    DROP_OUT_CAUSE,
    attempt_slots,
    drop_out_columns,
    lists_of,
    own_rewards,
    robot_columns,
    robots_by,
    told_by,
    with_robot_lists,
)
from halfseen.world.scene import Scene
from halfseen.world.state import NO_ATTEMPT, TableState, attempt_counts, occlusion


def to_logs(
    cuts: CutEpisodes,
    kind: CutKind | str,
    scenes: Sequence[Scene],
    dirty_share: Number | None = None,
    drop_out_cause: str = DROP_OUT_CAUSE,
) -> Logs:
    """Write down what a recorder would have kept of these episodes.

    Parameters
    ----------
    cuts
        The episodes; path k began from scene k modulo their number.
    kind
        How they were cut.
    scenes
        Where they began.
    dirty_share
        P(DIRTY) of an object before any label, from which the log-odds started; None if it is not to be told.
    drop_out_cause
        What it is called when one of several robots drops out alone.
    """
    states, begun = cuts.episodes.states, np.argwhere(cuts.is_begun)
    stages, paths = _stages(cuts, begun), _paths(cuts, kind, scenes, dirty_share)
    objects = objects_of(states, begun)
    if states.robots is not None:
        stages = stages.assign(**robot_columns(states, begun), **own_rewards(cuts, begun))
        paths = paths.assign(**drop_out_columns(cuts, drop_out_cause))
        objects = with_robot_lists(objects, states, cuts.episodes.action)
    return Logs(stages, paths, objects)


def elapsed_s(cuts: CutEpisodes) -> Float[np.ndarray, "n T"]:
    """U_t of each completed stage [s], NaN elsewhere."""
    duration_s = np.asarray(cuts.episodes.duration_s, dtype=np.float64)
    return np.where(cuts.is_completed, np.cumsum(np.where(cuts.is_completed, duration_s, 0.0), axis=1), np.nan)


def _paths(
    cuts: CutEpisodes, kind: CutKind | str, scenes: Sequence[Scene], dirty_share: Number | None = None
) -> pd.DataFrame:
    """How each path ended, and where it began."""
    num_paths = len(cuts.end_s)
    cause = np.full(num_paths, CAUSES[kind], dtype=object)
    cause[cuts.is_finished] = None
    return pd.DataFrame(
        {
            "path": np.arange(num_paths),
            "end_s": cuts.end_s,
            "ending": np.where(cuts.is_finished, "finished", "cut"),
            "cause": cause,
            "scene": [scenes[k % len(scenes)].name for k in range(num_paths)],
            **({} if dirty_share is None else {"dirty_share": float(dirty_share)}),
        }
    )


def _stages(cuts: CutEpisodes, begun: Int[np.ndarray, "rows 2"]) -> pd.DataFrame:
    """What was done in the stages that were begun, (path, stage) from 0."""
    path, stage = begun.T
    episodes, actions = cuts.episodes, ActionSpace(cuts.episodes.states.num_objects)
    action = np.asarray(episodes.action)[path, stage]
    verb = actions.verb(action)
    is_completed = cuts.is_completed[path, stage]
    reward = np.asarray(episodes.reward, dtype=np.float64)[path, stage]
    return pd.DataFrame(
        {
            "path": path,
            "stage": stage + 1,
            "elapsed_s": elapsed_s(cuts)[path, stage],
            "action": np.array(VERB_NAMES)[verb],
            "object": pd.Series(actions.target(action), dtype="Int64").mask(~np.isin(verb, TARGETED)),
            "reward": np.where(is_completed, reward, np.nan),
            "probability": np.asarray(episodes.probability, dtype=np.float64)[path, stage],
        }
    )


def history_of(states: TableState) -> tuple[Float[np.ndarray, "*B N"], ...]:
    """Occlusion, past successes and past failures of each object."""
    return (occlusion(states), *attempt_counts(states))


def objects_of(states: TableState, begun: Int[np.ndarray, "rows 2"]) -> pa.Table:
    """What was seen of each object in the stages that were begun, (path, stage) from 0; of states with axes (n, T)."""
    is_object = states.is_object[:, 0][begun[:, 0]]
    row, target = np.nonzero(is_object)
    path, stage = begun[row].T
    seen = mapped(lambda leaf: leaf[begun[:, 0], begun[:, 1]], replace(states, robots=None, workspace=None))
    occluded, successes, failures = (values[row, target] for values in history_of(seen))
    is_attempt = seen.attempt_object[row] == target[:, None]
    shown = {"grip": seen.grip[row, target], "seen": seen.seen[row, target]}
    return pa.table(
        {
            "path": path,
            "stage": stage + 1,
            "object": target,
            "location": np.where(seen.is_on_table[row, target], TABLE, DISHWASHER).tolist(),
            "occlusion": occluded.astype(np.float64),
            **{name: values.astype(np.float64) for name, values in shown.items() if values.any()},
            "log_odds": seen.log_odds[row, target].astype(np.float64),
            "successes": successes.astype(np.int64),
            "failures": failures.astype(np.int64),
            "lifts": seen.lifts[row, target].astype(np.int64),
            "hidden_by": lists_of(seen.hides[row, target].astype(np.float64), is_object[row]),
            "attempt_occlusions": lists_of(seen.attempt_occlusion[row].astype(np.float64), is_attempt),
            "attempt_succeeded": lists_of(seen.attempt_succeeded[row], is_attempt),
        }
    )


def states_of(logs: Logs, horizon: int) -> TableState:
    """Rebuild S_t of every stage of a log of tables, axes (n, T); what has no row is an empty table.

    Objects are numbered as `object_numbers` does; one that is not in view yet is padding until it is. Where the log
    tells of robots, so do the states; where there is no row, nobody is at the table.

    Parameters
    ----------
    logs
        The log.
    horizon
        T, the decisions of all robots together.

    Raises
    ------
    LogError
        The log breaks a rule of tables or of robots; see `log_checks`.
    """
    states = _table_states(logs, horizon)
    return replace(states, **robots_by(logs, told_by(logs, horizon), states)) if robots_in(logs) else states


def check_log(logs: Logs) -> None:
    """Refuse what is no log of several robots, as a learner would; a `LogRecorder` asks it at each stage, as `check`.

    Parameters
    ----------
    logs
        The log.

    Raises
    ------
    LogError
        It breaks a rule of tables or of robots; see `log_checks`.
    """
    checked_objects(logs, logs.horizon)
    told_by(logs)


def _table_states(logs: Logs, horizon: int) -> TableState:
    frame, lists = checked_objects(logs, horizon)
    path = pd.Index(logs.path_ids).get_indexer(frame["path"])
    stage = frame["stage"].to_numpy() - 1
    target = object_numbers(frame)
    num_objects = int(target.max()) + 1
    shape = (logs.num_paths, horizon, num_objects)
    at = path, stage, target
    is_object, is_on_table = np.zeros(shape, dtype=bool), np.zeros(shape, dtype=bool)
    is_object[at] = True
    is_on_table[at] = frame["location"].to_numpy() == TABLE
    types = {"grip": np.float32, "log_odds": np.float32, "seen": np.float32, "lifts": np.int32}
    numbers = {name: np.zeros(shape, dtype=dtype) for name, dtype in types.items()}
    for name in numbers.keys() & set(frame.columns):
        numbers[name][at] = frame[name]
    tried, tried_at, succeeded = _attempts(frame, lists, at, shape[:2], horizon)
    leaves = {
        "hides": _hides(lists["hidden_by"], frame, at, shape),
        "is_object": is_object,
        "is_on_table": is_on_table,
        **numbers,
        "attempt_object": tried,
        "attempt_occlusion": tried_at,
        "attempt_succeeded": succeeded,
        "steps_to_go": np.broadcast_to(horizon - np.arange(horizon, dtype=np.int32), shape[:2]),
    }
    return TableState(**leaves)


def _hides(
    hidden_by: Lists, frame: pd.DataFrame, at: tuple, shape: tuple[int, int, int]
) -> Float[np.ndarray, "n T N N"]:
    """Lists go by the objects of their stage; states by those of the path."""
    rank = frame.groupby(["path", "stage"]).cumcount().to_numpy()
    begin = np.arange(len(rank)) - rank
    hides = np.zeros((*shape, shape[-1]), dtype=np.float32)
    hider = at[2][begin[hidden_by.row] + hidden_by.place]
    hides[(*(index[hidden_by.row] for index in at), hider)] = hidden_by.values
    return hides


def _attempts(
    frame: pd.DataFrame, lists: Mapping[str, Lists], at: tuple, shape: tuple[int, int], horizon: int
) -> tuple[Int[np.ndarray, "n T T"], Float[np.ndarray, "n T T"], Bool[np.ndarray, "n T T"]]:
    """Attempts of each stage's history, gathered from the objects; their order across objects carries nothing."""
    tried = np.full((*shape, horizon), NO_ATTEMPT, dtype=np.int32)
    occluded = np.zeros(tried.shape, dtype=np.float32)
    succeeded = np.zeros(tried.shape, dtype=bool)
    row = lists["attempt_occlusions"].row
    slot = attempt_slots(at[0][row], at[1][row])
    if len(slot) and slot.max() >= horizon:
        where = frame.iloc[row[np.argmax(slot)]]
        raise LogError(
            f"path {where['path']}, stage {where['stage']}: {slot.max() + 1} past attempts, more than the horizon of "
            f"{horizon} stages allows; raise horizon or mend attempt_occlusions"
        )
    cell = at[0][row], at[1][row], slot
    tried[cell] = at[2][row]
    occluded[cell] = lists["attempt_occlusions"].values
    succeeded[cell] = lists["attempt_succeeded"].values.astype(bool)
    return tried, occluded, succeeded
