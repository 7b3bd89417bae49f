"""What the log of a table tells of its laws: attempts, as far as each was watched, and what each look said."""

from typing import NamedTuple, TypeVar

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float

from halfseen.arrays import RowIds, RowMask, Rows
from halfseen.logs import Logs
from halfseen.tables.grasp.attempts import attempts
from halfseen.world.actions import Verb
from halfseen.world.config import WorldConfig
from halfseen.world.log_rows import object_numbers
from halfseen.world.logs import states_of
from halfseen.world.seeing import SAME_VIEW
from halfseen.world.state import TableState

AT_LIMIT = 0.98
"""An attempt that lasted this share of its limit is at the limit: clocks are rounded."""

NO_NEWS = 1e-4
"""Log-odds that move by less did not: what is left is rounding."""


class Watched(NamedTuple):
    """Attempts, each as far as it was watched; n of them."""

    path: RowIds
    """Rank of its path in the log."""
    object: RowIds
    """Number of the object; none stands in two paths."""
    occlusion: Rows
    """Hidden share when it began, in [0, 1]."""
    grip: Rows
    """Mean of the object's grip offset."""
    watched_s: Rows
    """Time for which it was watched, without transport: until it held, missed or was cut; at most the limit [s]."""
    is_held: RowMask
    is_missed: RowMask
    """Whether it was seen to miss; what neither held nor missed was cut."""


class Labels(NamedTuple):
    """Labels that were news; n of them."""

    path: RowIds
    """Rank of its path in the log."""
    object: RowIds
    """Number of the object; none stands in two paths."""
    occlusion: Rows
    """Hidden share in the look that it comes from; 0 of what is held up."""
    is_held: RowMask
    """Whether it was held up in that look."""
    seen: Rows
    """Share of its surface that the recorder counted as seen before it; 0 in a log that counts none."""
    seen_after: Rows
    """The same after it."""
    says_dirty: RowMask
    was_dirty: RowMask
    """Whether washing showed that the object was dirty."""
    was_clean: RowMask
    """Whether it showed that it was clean; of what was never washed nothing was shown."""

    @property
    def is_persistent(self) -> bool:
        """Whether the recorder counted what was seen, and took a look that shows nothing else for no news."""
        return bool(self.seen_after.any())


Told = TypeVar("Told", Watched, Labels)


def of_first(told: Told, num_paths: int) -> Told:
    """Keep what the first paths tell."""
    kept = told.path < num_paths
    return type(told)(*(values[kept] for values in told))


def watched(logs: Logs, known: WorldConfig) -> Watched:
    """List all attempts, the cut ones included.

    An attempt comes before its transport. So one that was cut when its stage had lasted c seconds had not ended within
    c − transport_s seconds, and where that is below 0 it tells nothing. A miss that lasted `AT_LIMIT` of the limit or
    more is taken to have lasted the limit.

    Parameters
    ----------
    logs
        As `attempts` reads them; where its objects have a column grip, it is used.
    known
        Of which horizon, transport_s and the limit of an attempt are used.

    Raises
    ------
    LogError
        As `attempts` does.
    """
    table, limit_s = attempts(logs, known.horizon), float(known.grasping.limit_s)
    occlusion, grip, time_s = (table[name].to_numpy(dtype=np.float64) for name in ("occlusion", "grip", "time_s"))
    is_held = _has_held(table)
    is_missed = table["is_finished"].to_numpy(dtype=bool) & ~is_held
    until_s = np.clip(time_s - float(known.transport_s), 0.0, limit_s)
    watched_s = np.where(is_missed & (until_s >= AT_LIMIT * limit_s), limit_s, until_s)
    path = pd.Index(logs.path_ids).get_indexer(table["path"]).astype(np.int64)
    return Watched(path, table["object"].to_numpy(dtype=np.int64), occlusion, grip, watched_s, is_held, is_missed)


def labels(logs: Logs, known: WorldConfig, dirty_share: float) -> Labels:
    """List what every look said: DIRTY where it raised the log-odds, the other where it lowered them.

    By how much the recorder let them move is its own belief in its labels, and is not used. A look that moved nothing
    was no news, and is left out, unless it added to what counts as seen: then nothing was found in what it showed. The
    reward of a WASH that held shows what the object was; one in the last step of the
    horizon is left out, as its reward also holds the price of what is left.

    Parameters
    ----------
    logs
        As `states_of` and `attempts` read them.
    known
        Of which the horizon and the rewards of WASH are used.
    dirty_share
        P(DIRTY) before any label, which the log-odds started from.

    Raises
    ------
    LogError
        As `states_of` and `attempts` do.
    """
    states = states_of(logs, known.horizon)
    is_held = np.diff(states.lifts, axis=1, prepend=0) > 0
    moved = _moved(states, dirty_share)
    shows_more = np.diff(states.seen, axis=1, prepend=0.0) > SAME_VIEW
    path, stage, target = at = np.nonzero(((np.abs(moved) > NO_NEWS) | shows_more) & states.is_on_table)
    seen = states.seen.astype(np.float64)
    was_dirty, was_clean = _shown(logs, known, states.is_object.shape)
    return Labels(
        path=path,
        object=path * states.num_objects + target,
        occlusion=_occluded(states, is_held)[at].astype(np.float64),
        is_held=is_held[at],
        seen=np.where(stage > 0, seen[path, stage - 1, target], 0.0),
        seen_after=seen[at],
        says_dirty=moved[at] > NO_NEWS,
        was_dirty=was_dirty[path, target],
        was_clean=was_clean[path, target],
    )


def _has_held(tried: pd.DataFrame) -> RowMask:
    return tried["succeeded"].fillna(False).to_numpy(dtype=bool)


def _moved(states: TableState, dirty_share: float) -> Float[np.ndarray, "n T N"]:
    """How far each look moved the log-odds; the first one that shows an object from the prior."""
    prior = np.float32(np.log(dirty_share) - np.log1p(-dirty_share))
    log_odds = np.where(states.is_object, states.log_odds, prior)
    return np.diff(log_odds, axis=1, prepend=np.full_like(log_odds[:, :1], prior))


def _occluded(states: TableState, is_held: Bool[np.ndarray, "n T N"]) -> Float[np.ndarray, "n T N"]:
    """Hidden share of each object in the look before each stage; what was held up then hid nothing and was seen whole.

    What was held up is the object whose lifts were counted since the stage before.
    """
    is_hiding = (states.is_on_table & ~is_held)[:, :, None, :]
    hidden = 1.0 - np.prod(np.where(is_hiding, 1.0 - states.hides, 1.0), axis=-1)
    return np.where(is_held, 0.0, hidden)


def _shown(logs: Logs, known: WorldConfig, shape: tuple[int, int, int]) -> Bool[np.ndarray, "2 n N"]:
    """Whether washing showed each object to have been dirty, and to have been clean."""
    key = ["path", "stage", "object"]
    tried = attempts(logs, known.horizon)
    held = pd.DataFrame(tried.loc[_has_held(tried), key[:2]])
    done = pd.DataFrame(logs.stages.loc[logs.stages["action"] == Verb.WASH.name, [*key, "reward"]])
    assert logs.objects is not None
    numbers = pd.DataFrame(logs.objects[key]).assign(number=object_numbers(logs.objects))
    washed = held.merge(done, on=key[:2]).merge(numbers, on=key)
    is_dirty = np.abs(washed["reward"] - known.reward_wash_dirty) < np.abs(washed["reward"] - known.reward_wash_clean)
    was = np.zeros((2, shape[0], shape[2]), dtype=bool)
    was[np.where(is_dirty, 0, 1), pd.Index(logs.path_ids).get_indexer(washed["path"]), washed["number"]] = True
    return was
