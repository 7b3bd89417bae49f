"""The law of seeing that a recorder kept to, read back from its own log-odds; and whether labels speak against it.

Each label moved the log-odds of DIRTY of its object by

    log P(label | dirty) − log P(label | clean),

a known function of the recorder's law and of what was in view. So the law is what reproduces the moves: robust least
squares, exact but for rounding where the recorder was of that family. A robot that works remembers now and then what
hides an object otherwise than its camera saw it, so `MOST` of the moves must be reproduced, not all. Where no law does,
nothing is read.

A recorder's law may be wrong, and then its log-odds mislead anyone who goes by them. The labels themselves tell: were
the recorder right, twice the log-likelihood ratio of the best law of the family to the recorder's would be χ², with as
many degrees of freedom as the family has numbers [Wilks1938]_. Unless that is beyond `LEVEL`, the recorder's law is the
centre of the prior of the fit by labels; else they are fitted without it, as where a log holds no log-odds of its own.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from halfseen.arrays import Rows
from halfseen.shapes import Bool, Float
from halfseen.tables.assisted import Mending
from halfseen.tables.evidence import Labels, Prior
from halfseen.tables.law_seeing import Independent, Persistent
from halfseen.world.seeing import AssumedSeeing, KnownSeeing, PersistentSeeing, label_evidence

LEVEL = 0.01
"""Probability with which a right recorder is taken for a wrong one, at most."""
MOVE_ROUNDING = 2e-3
"""Root mean square of what is left of moves that are rounded."""
MOST = 0.95
"""Share of the moves that one law must have made."""
ENOUGH = 1000
"""Moves among which a law is looked for; `MOST` of all must bear it out."""
PARTS = (4, 12)
"""In how many parts of what an object shows in full view a recorder's own curves are looked for."""
MOST_STEPS = 100
"""Of a search; a law that made the moves is found in far fewer."""
RECORDER_SPREAD = 0.1
"""Standard deviation of the prior about the recorder's law, in logits."""


def read_back(
    labels: Labels, law_of: Callable[[Rows], KnownSeeing], centre: Rows, bounds: tuple[float, float]
) -> Rows | None:
    """Find the numbers of the law whose labels would have moved the log-odds as they moved; None if no one law did.

    The search begins at `centre`, where numbers stay that no label tells; each lies within `bounds`.
    """
    from scipy.optimize import least_squares

    some = Labels(*(values[:: 1 + len(labels.moved) // ENOUGH] for values in labels))

    def left(theta: Float[np.ndarray, " k"]) -> Float[np.ndarray, " m"]:
        return np.concatenate([moved_by(law_of(theta), some) - some.moved, 1e-4 * (theta - centre)])

    def read(loss: str) -> Rows | None:
        limits: Any = {"bounds": bounds, "loss": loss, "f_scale": MOVE_ROUNDING, "max_nfev": MOST_STEPS}
        theta = least_squares(left, centre, **limits).x
        squares = np.sort((moved_by(law_of(theta), labels) - labels.moved) ** 2)
        error = np.sqrt(np.mean(squares[: int(np.ceil(MOST * len(squares)))]))
        return theta if error <= MOVE_ROUNDING else None

    exact = read("linear")
    return read("soft_l1") if exact is None else exact


def moved_by(law: KnownSeeing, labels: Labels) -> Rows:
    """By how much the labels move the log-odds under a law."""
    if_dirty, if_clean = law.positive(labels.occlusion, labels.seen, labels.is_held)
    return np.asarray(label_evidence(if_dirty, if_clean, labels.says_dirty), dtype=np.float64)


class SeenBy(NamedTuple):
    """A law of seeing, and what became of the recorder's."""

    law: AssumedSeeing | PersistentSeeing
    recorder: AssumedSeeing | PersistentSeeing | None
    """The law that made the log's own log-odds; None where no law of the family did."""
    is_rejected: bool = False


def seeing_of(labels: Labels, dirty_share: float, known: KnownSeeing | None = None) -> SeenBy:
    """Fit the family that the recorder of labels kept to, about the recorder's law unless labels speak against it.

    Without any labels, the law's numbers are the prior's. Where the recorder's law is not to be had, that is about
    the law that is `known`; None for a weak prior.
    """
    from scipy.special import chdtri

    families: list[Any] = [Independent(labels, dirty_share)]
    if labels.is_persistent:
        families = [Persistent(labels, dirty_share, num_parts) for num_parts in PARTS]
    plain = families[0]
    about = None if known is None else plain.theta_of(known)
    unaided = plain.prior if about is None else Prior(about, RECORDER_SPREAD)
    told = families if len(labels.trajectory) else []
    each = ((family, read_back(labels, family.law, family.prior.mode, family.bounds)) for family in told)
    family, theta = next((pair for pair in each if pair[1] is not None), (plain, None))
    if theta is None:
        return SeenBy(plain.law(plain.fitted(unaided)), None)
    best = family.fitted(Prior(theta, family.prior.spread))
    gained = family.likelihood(best)[0] - family.likelihood(theta)[0]
    if 2.0 * gained > chdtri(len(best), LEVEL):
        return SeenBy(plain.law(plain.fitted(unaided)), family.law(theta), is_rejected=True)
    return SeenBy(family.law(family.fitted(Prior(theta, RECORDER_SPREAD))), family.law(theta))


NUM_KNOTS = 16


def mending_of(labels: Labels, law: KnownSeeing, dirty_share: float) -> Mending | None:
    """Learn it from the labels of a log; None where it has none.

    `law` is what the labels are to mean, those of each object in order.
    """
    if not len(labels.trajectory):
        return None
    prior = np.log(dirty_share) - np.log1p(-dirty_share)
    order = np.argsort(labels.object, kind="stable")
    begins = np.append(True, np.diff(labels.object[order]) != 0)
    recorded, mended = (prior + _running(moves[order], begins) for moves in (labels.moved, moved_by(law, labels)))
    persistent = law if isinstance(law, PersistentSeeing) else None
    if persistent is not None:
        is_found = labels.says_dirty[order]
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
