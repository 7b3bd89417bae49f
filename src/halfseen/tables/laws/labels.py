"""From the log of a table to what each look said of each object, and to what washing showed of it."""

from dataclasses import fields
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float

from halfseen.arrays import RowIds, RowMask, Rows
from halfseen.logs import Logs
from halfseen.tables.grasp.attempts import attempts
from halfseen.world.actions import Verb
from halfseen.world.config import WorldConfig
from halfseen.world.log_checks import object_numbers
from halfseen.world.logs import states_of
from halfseen.world.seeing import SAME_VIEW

NO_NEWS = 1e-4
"""Log-odds that move by less did not: what is left is rounding."""


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

    def first(self, num_paths: int) -> "Labels":
        """Keep those of the first paths."""
        kept = self.path < num_paths
        return Labels(*(values[kept] for values in self))

    @property
    def is_persistent(self) -> bool:
        """Whether the recorder counted what was seen, and took a look that shows nothing else for no news."""
        return bool(self.seen_after.any())


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
    states = _as_numpy(states_of(logs, known.horizon))
    is_held = np.diff(states.lifts, axis=1, prepend=0) > 0
    occluded, moved = _occluded(states, is_held), _moved(states, dirty_share)
    shows_more = np.diff(states.seen, axis=1, prepend=0.0) > SAME_VIEW
    path, stage, target = at = np.nonzero(((np.abs(moved) > NO_NEWS) | shows_more) & states.is_on_table)
    seen = states.seen.astype(np.float64)
    was = _shown(logs, known, states.is_object.shape)
    return Labels(
        path=path,
        object=path * states.is_object.shape[-1] + target,
        occlusion=occluded[at].astype(np.float64),
        is_held=is_held[at],
        seen=np.where(stage > 0, seen[path, stage - 1, target], 0.0),
        seen_after=seen[at],
        says_dirty=moved[at] > NO_NEWS,
        was_dirty=was[0][path, target],
        was_clean=was[1][path, target],
    )


def _as_numpy(states: Any) -> SimpleNamespace:
    return SimpleNamespace(**{each.name: np.asarray(getattr(states, each.name)) for each in fields(states)})


def _moved(states: SimpleNamespace, dirty_share: float) -> Float[np.ndarray, "n T N"]:
    """How far each look moved the log-odds; the first one that shows an object from the prior."""
    prior = np.float32(np.log(dirty_share) - np.log1p(-dirty_share))
    log_odds = np.where(states.is_object, states.log_odds, prior)
    return np.diff(log_odds, axis=1, prepend=np.full_like(log_odds[:, :1], prior))


def _occluded(states: SimpleNamespace, is_held: Bool[np.ndarray, "n T N"]) -> Float[np.ndarray, "n T N"]:
    """Hidden share of each object in the look before each stage; what was held up then hid nothing and was seen whole.

    What was held up is the object whose lifts were counted since the stage before.
    """
    is_hiding = (states.is_on_table & ~is_held)[:, :, None, :]
    hidden = 1.0 - np.prod(np.where(is_hiding, 1.0 - states.hides, 1.0), axis=-1)
    return np.where(is_held, 0.0, hidden)


def _shown(
    logs: Logs, known: WorldConfig, shape: tuple[int, int, int]
) -> tuple[Bool[np.ndarray, "n N"], Bool[np.ndarray, "n N"]]:
    """Whether washing showed each object to have been dirty, and to have been clean."""
    washed = _washed(logs, known)
    is_dirty = np.abs(washed["reward"] - known.reward_wash_dirty) < np.abs(washed["reward"] - known.reward_wash_clean)
    was = np.zeros((2, shape[0], shape[2]), dtype=bool)
    was[np.where(is_dirty, 0, 1), washed["path"], washed["rank"]] = True
    return was[0], was[1]


def _washed(logs: Logs, known: WorldConfig) -> pd.DataFrame:
    """Reward, rank of the path and number of the object of each WASH that held."""
    key = ["path", "stage"]
    objects: Any = logs.objects
    ranks = objects[[*key, "object"]].assign(rank=object_numbers(objects))
    tried = attempts(logs, known.horizon)
    held = pd.DataFrame(tried.loc[tried["succeeded"].fillna(False).to_numpy(dtype=bool), key])
    done = pd.DataFrame(logs.stages.loc[logs.stages["action"] == Verb.WASH.name, [*key, "object", "reward"]])
    rows = held.merge(done, on=key).merge(ranks, on=[*key, "object"])
    return rows.assign(path=pd.Index(logs.path_ids).get_indexer(rows["path"]))
