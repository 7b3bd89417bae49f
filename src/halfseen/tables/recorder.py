"""The law of seeing that a recorder used, recovered from its own log-odds; and its test on the labels.

Each label moved the log-odds of DIRTY of its object by

    log P(label | dirty) − log P(label | clean),

a known function of the recorder's law and of the view. So the law is fitted to these changes by robust least squares,
which is exact up to rounding if the recorder's law is in the family. At work, a robot's memory of what hides an object
sometimes differs from its camera's view. So `MOST` of the changes must be reproduced, not all. Where no law reproduces
them, no law is returned.

A recorder's law may be wrong, and its log-odds then mislead a policy. This is tested on the labels. If the recorder is
right, twice the log-likelihood ratio of the best law of the family to the recorder's is χ², with as many degrees of
freedom as the family has parameters [Wilks1938]_. Unless it exceeds `LEVEL`, the prior of the fit to the labels is
centred at the recorder's law. Otherwise the law is fitted without it, as for a log without log-odds of its own.
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
"""Level of the test of the recorder."""
MOVE_ROUNDING = 2e-3
"""Root mean square of the residuals of rounded changes."""
MOST = 0.95
"""Share of the changes that one law must reproduce."""
ENOUGH = 1000
"""Number of changes used in the search; `MOST` of all must agree with the result."""
PARTS = (4, 12)
"""Numbers of parts of the surface in full view tried for a recorder's own curves."""
MOST_STEPS = 100
"""Most steps of a search; a law that made the changes is found in far fewer."""
RECORDER_SPREAD = 0.1
"""Standard deviation of the prior centred at the recorder's law, in logits."""


def read_back(
    labels: Labels, law_of: Callable[[Rows], KnownSeeing], centre: Rows, bounds: tuple[float, float]
) -> Rows | None:
    """Find the parameters of the law that reproduces the changes of the log-odds; None if no single law does.

    The search begins at `centre`, where parameters without information stay; each lies within `bounds`.
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
    """Changes of the log-odds by the labels under a law."""
    if_dirty, if_clean = law.positive(labels.occlusion, labels.seen, labels.is_held)
    return np.asarray(label_evidence(if_dirty, if_clean, labels.says_dirty), dtype=np.float64)


class SeenBy(NamedTuple):
    """A fitted law of seeing, the recorder's law, and its test."""

    law: AssumedSeeing | PersistentSeeing
    recorder: AssumedSeeing | PersistentSeeing | None
    """The law that produced the log's own log-odds; None if no law of the family did."""
    is_rejected: bool = False


def seeing_of(labels: Labels, dirty_share: float, known: KnownSeeing | None = None) -> SeenBy:
    """Fit the recorder's family to labels, with a prior centred at the recorder's law unless the labels contradict it.

    Without labels, the law is the prior's mode. Where the recorder's law is unknown or rejected, the prior is centred
    at the law `known`; None for a weak prior.
    """
    from scipy.special import chdtri

    families: list[Any] = [Independent(labels, dirty_share)]
    if labels.is_persistent:
        families = [Persistent(labels, dirty_share, num_parts) for num_parts in PARTS]
    plain = families[0]
    about = None if known is None else plain.theta_of(known)
    unaided = plain.prior if about is None else Prior(about, RECORDER_SPREAD)
    informed = families if len(labels.trajectory) else []
    each = ((family, read_back(labels, family.law, family.prior.mode, family.bounds)) for family in informed)
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
    """Learn the mending from the labels of a log, in order for each object; None without labels.

    `law` is the law under which log-odds are recomputed.
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
    # Objects never seen keep the prior.
    recorded, mended = np.append(recorded, prior), np.append(mended, prior)
    edges = np.unique(np.quantile(recorded, np.linspace(0.0, 1.0, NUM_KNOTS + 1)))
    part = np.searchsorted(edges[1:-1], recorded, side="right")
    count = np.bincount(part)
    x, y = (np.bincount(part, each)[count > 0] / count[count > 0] for each in (recorded, mended))
    x, is_new = np.unique(x.astype(np.float32), return_index=True)
    return Mending(x, np.maximum.accumulate(y).astype(np.float32)[is_new], float(prior), persistent)


def _running(moves: Float[np.ndarray, " n"], begins: Bool[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Cumulative sums of the changes of each object."""
    total = np.cumsum(moves)
    first = np.flatnonzero(begins)
    return total - np.repeat(total[first] - moves[first], np.diff(np.append(first, len(moves))))
