"""The law of seeing that a recorder kept to, read back from its own log-odds; and whether labels speak against it.

Each label moved the log-odds of DIRTY of its object by

    log P(label | dirty) − log P(label | clean),

a known function of the recorder's law and of what was in view. So the law is what reproduces all moves: least squares,
exact but for rounding where the recorder was of that family. Where none does, nothing is read.

A recorder's law may be wrong, and then its log-odds mislead whoever goes by them. The labels themselves tell: were the
recorder right, twice the log-likelihood ratio of the best law of the family to the recorder's would be χ², with as many
degrees of freedom as the family has numbers [Wilks1938]_. Unless that is beyond `LEVEL`, the recorder's law is the
centre of the prior of the fit by labels; else they are fitted without it, as where a log holds no log-odds of its own.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from halfseen.arrays import Rows
from halfseen.shapes import Float
from halfseen.tables.laws.evidence import Labels
from halfseen.world.seeing import KnownSeeing, label_evidence

LEVEL = 0.01
"""Probability with which a right recorder is taken for a wrong one, at most."""
ROUNDING = 2e-3
"""Root mean square of what is left of moves that are rounded."""
SPREAD = 0.1
"""Standard deviation of the prior about the recorder's law, in logits."""


class Recorder(NamedTuple):
    """What log-odds tell of who recorded them."""

    theta: Rows
    """Numbers of the law, in the family that the log speaks for."""
    error: float
    """Root mean square of what is left of the moves."""

    @property
    def is_consistent(self) -> bool:
        """Whether one law made all the moves."""
        return self.error <= ROUNDING


def read_back(
    told: Labels, law_of: Callable[[Rows], KnownSeeing], centre: Rows, bounds: tuple[float, float]
) -> Recorder:
    """Find the law whose labels would have moved the log-odds as they moved.

    Parameters
    ----------
    told
        The labels.
    law_of
        The law of some numbers.
    centre
        Where the search begins; numbers that no label tells stay there.
    bounds
        Within which each number lies.
    """
    from scipy.optimize import least_squares

    def left(theta: Float[np.ndarray, " k"]) -> Float[np.ndarray, " m"]:
        moves = moved_by(law_of(theta), told)
        return np.concatenate([moves - told.moved, 1e-4 * (theta - centre)])

    found = least_squares(left, centre, bounds=bounds)
    return Recorder(found.x, float(np.sqrt(np.mean(found.fun[: len(told.moved)] ** 2))))


def moved_by(law: KnownSeeing, told: Labels) -> Rows:
    """By how much the labels move the log-odds under a law."""
    if_dirty, if_clean = law.positive(told.occlusion, told.seen, told.is_held)
    return np.asarray(label_evidence(if_dirty, if_clean, told.says_dirty), dtype=np.float64)


def speaks_against(log_likelihood: float, best: float, num_numbers: int) -> bool:
    """Whether labels reject a law, given its log-likelihood and the best of its family."""
    from scipy.special import chdtri

    return bool(2.0 * (best - log_likelihood) > chdtri(num_numbers, LEVEL))
