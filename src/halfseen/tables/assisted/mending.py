"""Log-odds that a recorder got wrong, made anew: what labels say under the fitted law, by what the recorder took them for.

A policy sees log-odds, not labels. Along the log both are known, and what the fitted law makes of the same labels rises
with what the recorder made of them: means between quantiles, straight lines between these.
"""

from dataclasses import replace

import numpy as np

from halfseen.arrays import library_of, record
from halfseen.shapes import Float
from halfseen.tables.laws.evidence import Labels
from halfseen.tables.laws.recorder import moved_by
from halfseen.world.seeing import KnownSeeing
from halfseen.world.state import TableState

NUM_KNOTS = 16


@record
class Mending:
    """A rising function of log-odds, straight between knots."""

    recorded: Float[np.ndarray, " k"]
    mended: Float[np.ndarray, " k"]

    def __call__(self, state: TableState) -> TableState:
        """The same state, its log-odds made anew."""
        log_odds = library_of(state.log_odds).interp(state.log_odds, self.recorded, self.mended)
        return replace(state, log_odds=log_odds.astype(np.float32))


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
    if not len(told.path):
        return None
    prior = np.log(dirty_share) - np.log1p(-dirty_share)
    order = np.argsort(told.object, kind="stable")
    begins = np.append(True, np.diff(told.object[order]) != 0)
    recorded, mended = (prior + _running(moves[order], begins) for moves in (told.moved, moved_by(law, told)))
    # What was never seen is as before.
    recorded, mended = np.append(recorded, prior), np.append(mended, prior)
    edges = np.unique(np.quantile(recorded, np.linspace(0.0, 1.0, NUM_KNOTS + 1)))
    part = np.searchsorted(edges[1:-1], recorded, side="right")
    count = np.bincount(part)
    x, y = (np.bincount(part, each)[count > 0] / count[count > 0] for each in (recorded, mended))
    return Mending(x.astype(np.float32), np.maximum.accumulate(y).astype(np.float32))


def _running(moves: Float[np.ndarray, " n"], begins: np.ndarray) -> Float[np.ndarray, " n"]:
    """Sums of the moves of each object so far."""
    total = np.cumsum(moves)
    first = np.flatnonzero(begins)
    return total - np.repeat(total[first] - moves[first], np.diff(np.append(first, len(moves))))
