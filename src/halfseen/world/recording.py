"""From cut episodes to `Logs`, and from the logs of tables back to the states that a policy saw.

Per object and stage a log holds: location ("TABLE" or "DISHWASHER"; "LOST" where it is in neither), occlusion, grip
(mean of its grip offset, from what shows of it), log_odds (of DIRTY), seen (share of its surface that labels have told
of), successes and failures (of past grasps), lifts, and three lists: hidden_by (the share of it that each object of the
scene hides alone, in the order of the objects), attempt_occlusions and attempt_succeeded (its past attempts, oldest
first). Where grip or seen are 0 throughout, they are not written, and a log without them is read so.
Per path it holds the scene's name, and dirty_share: P(DIRTY) of an object before any label, which log_odds start from.
"""

from collections.abc import Mapping, Sequence

import jax
import numpy as np
import pandas as pd
import pyarrow as pa
from jaxtyping import Bool, Float, Int

from halfseen.arrays import on_device
from halfseen.errors import LogError
from halfseen.logs import Logs
from halfseen.world.action_space import TARGETED, ActionSpace, Verb
from halfseen.world.cuts import CAUSES, CutEpisodes, CutKind
from halfseen.world.number import Number
from halfseen.world.scene import Scene
from halfseen.world.state import NO_ATTEMPT, TableState, attempt_counts, occlusion
from halfseen.world.table_checks import DISHWASHER, TABLE, Lists, checked_objects, object_numbers

VERB_NAMES = tuple(verb.name for verb in Verb)


def to_logs(cuts: CutEpisodes, kind: CutKind | str, scenes: Sequence[Scene], dirty_share: Number | None = None) -> Logs:
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
    """
    begun = np.argwhere(cuts.is_begun)
    return Logs(
        stages_of(cuts, begun), paths_of(cuts, kind, scenes, dirty_share), objects_of(cuts.episodes.states, begun)
    )


def elapsed_s(cuts: CutEpisodes) -> Float[np.ndarray, "n T"]:
    """U_t of each completed stage [s], NaN elsewhere."""
    duration_s = np.asarray(cuts.episodes.duration_s, dtype=np.float64)
    return np.where(cuts.is_completed, np.cumsum(np.where(cuts.is_completed, duration_s, 0.0), axis=1), np.nan)


def paths_of(
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


def stages_of(cuts: CutEpisodes, begun: Int[np.ndarray, "rows 2"], verbs: Sequence[str] = VERB_NAMES) -> pd.DataFrame:
    """What was done in the stages that were begun, (path, stage) from 0; `verbs` names them all."""
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
            "action": np.array(verbs)[verb],
            "object": pd.Series(actions.target(action), dtype="Int64").mask(~np.isin(verb, TARGETED)),
            "reward": np.where(is_completed, reward, np.nan),
            "probability": np.asarray(episodes.probability, dtype=np.float64)[path, stage],
        }
    )


@jax.jit
def history_of(states: TableState) -> tuple[Float[jax.Array, "*B N"], ...]:
    """Occlusion, past successes and past failures of each object of tables, axes (n, T)."""

    def one(state: TableState):
        return (occlusion(state), *attempt_counts(state))

    return jax.vmap(jax.vmap(one))(states)


def objects_of(states: TableState, begun: Int[np.ndarray, "rows 2"]) -> pa.Table:
    """What was seen of each object in the stages that were begun, (path, stage) from 0; of states with axes (n, T)."""
    occluded, successes, failures = (np.asarray(leaf) for leaf in history_of(states))
    is_object = np.asarray(states.is_object)[:, 0]
    stage_row, target = np.nonzero(is_object[begun[:, 0]])
    path, stage = begun[stage_row].T
    at = path, stage, target
    is_attempt = np.asarray(states.attempt_object)[path, stage] == target[:, None]
    tried_at = np.asarray(states.attempt_occlusion, dtype=np.float64)[path, stage]
    succeeded = np.asarray(states.attempt_succeeded)[path, stage]
    shown = {"grip": np.asarray(states.grip)[at], "seen": np.asarray(states.seen)[at]}
    return pa.table(
        {
            "path": path,
            "stage": stage + 1,
            "object": target,
            "location": np.where(np.asarray(states.is_on_table)[at], TABLE, DISHWASHER).tolist(),
            "occlusion": occluded[at].astype(np.float64),
            **{name: values.astype(np.float64) for name, values in shown.items() if values.any()},
            "log_odds": np.asarray(states.log_odds)[at].astype(np.float64),
            "successes": successes[at].astype(np.int64),
            "failures": failures[at].astype(np.int64),
            "lifts": np.asarray(states.lifts)[at].astype(np.int64),
            "hidden_by": lists_of(np.asarray(states.hides)[at].astype(np.float64), is_object[path]),
            "attempt_occlusions": lists_of(tried_at, is_attempt),
            "attempt_succeeded": lists_of(succeeded, is_attempt),
        }
    )


def lists_of(values: np.ndarray, is_kept: Bool[np.ndarray, "rows k"]) -> pa.ListArray:
    """A list a row, of the values that are kept."""
    offsets = np.concatenate([[0], np.cumsum(is_kept.sum(axis=1))]).astype(np.int32)
    return pa.ListArray.from_arrays(pa.array(offsets), pa.array(values[is_kept]))


def states_of(logs: Logs, horizon: int) -> TableState:
    """Rebuild S_t of every stage of a log of tables, axes (n, T); what has no row is an empty table.

    Objects are numbered as `object_numbers` does; one that is not in view yet is padding until it is.

    Raises
    ------
    LogError
        The log breaks a rule of tables; see `halfseen.world.table_checks`.
    """
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
    return TableState(**on_device(leaves))


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


def attempt_slots(path: Int[np.ndarray, " n"], stage: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """Where the state of a stage holds its past attempts, told object by object: one after the other."""
    return pd.Series(path).groupby([path, stage]).cumcount().to_numpy()


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
