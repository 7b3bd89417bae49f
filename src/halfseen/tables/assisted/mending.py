"""Log-odds that a recorder got wrong, made anew: what its labels say under the fitted law.

A policy sees log-odds, not labels. Along the log both are known, and what the fitted law makes of the same labels rises
with what the recorder made of them: means between quantiles, straight lines between these. Where a look that shows
nothing new is no news, and nothing was found, what was seen of an object says all: then the fitted law is asked.
"""

from dataclasses import replace

import numpy as np

from halfseen.arrays import Array, library_of, record
from halfseen.shapes import Bool, Float
from halfseen.tables.laws.evidence import Labels
from halfseen.tables.laws.recorder import moved_by
from halfseen.world.number import Number
from halfseen.world.seeing import KnownSeeing, PersistentSeeing
from halfseen.world.state import TableState

NUM_KNOTS = 16


@record
class Mending:
    """Log-odds as a law has them, by what was recorded and seen.

    Parameters
    ----------
    recorded, mended
        A rising function of log-odds, straight between these.
    prior
        Log-odds before any label; what is recorded below it was looked at, and nothing was found.
    law
        Of what was looked at and found clean; None where each look is news, and the function holds for all.
    """

    recorded: Float[np.ndarray, " k"]
    mended: Float[np.ndarray, " k"]
    prior: Number
    law: PersistentSeeing | None = None

    def __call__(self, state: TableState) -> TableState:
        """The same state, its log-odds made anew."""
        xp = library_of(state.log_odds)
        log_odds = xp.interp(state.log_odds, self.recorded, self.mended)
        if self.law is not None:
            log_odds = xp.where(state.log_odds < self.prior, self.prior + _of_nothing(self.law, state.seen), log_odds)
        return replace(state, log_odds=log_odds.astype(np.float32))


def _of_nothing(law: PersistentSeeing, seen: Array) -> Array:
    """Log-odds that it adds to have found nothing in this share of the surface."""
    xp, (if_dirty, if_clean) = library_of(seen), law.found_by(seen)
    return xp.log(xp.maximum(1.0 - if_dirty, 1e-6)) - xp.log(xp.maximum(1.0 - if_clean, 1e-6))


def mending_of(told: Labels, law: KnownSeeing, dirty_share: float) -> Mending | None:
    """Learn it from the labels of a log; None where it has none.

    Parameters
    ----------
    told
        The labels, those of each object in order.
    law
        What they are to mean.
    dirty_share
        P(DIRTY) before any label.
    """
    if not len(told.trajectory):
        return None
    prior = np.log(dirty_share) - np.log1p(-dirty_share)
    order = np.argsort(told.object, kind="stable")
    begins = np.append(True, np.diff(told.object[order]) != 0)
    recorded, mended = (prior + _running(moves[order], begins) for moves in (told.moved, moved_by(law, told)))
    persistent = law if isinstance(law, PersistentSeeing) else None
    if persistent is not None:
        is_found = told.says_dirty[order]
        recorded, mended = recorded[is_found], mended[is_found]
    # What was never seen is as before.
    recorded, mended = np.append(recorded, prior), np.append(mended, prior)
    edges = np.unique(np.quantile(recorded, np.linspace(0.0, 1.0, NUM_KNOTS + 1)))
    part = np.searchsorted(edges[1:-1], recorded, side="right")
    count = np.bincount(part)
    x, y = (np.bincount(part, each)[count > 0] / count[count > 0] for each in (recorded, mended))
    x, is_new = np.unique(x.astype(np.float32), return_index=True)
    return Mending(x, np.maximum.accumulate(y).astype(np.float32)[is_new], float(prior), persistent)


def _running(moves: Float[np.ndarray, " n"], begins: Bool[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Sums of the moves of each object so far."""
    total = np.cumsum(moves)
    first = np.flatnonzero(begins)
    return total - np.repeat(total[first] - moves[first], np.diff(np.append(first, len(moves))))
