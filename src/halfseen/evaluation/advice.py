"""How many paths like those of a log would decide whether a policy is better.

The half-width of an interval shrinks as 1/√n: its standard error σ is the spread of what paths add, and the bias β that
it allows for is of stages that more paths see end. With a difference of δ,

    n* = n·((β + (z₀.₉₇₅ + z₀.₈) σ) / |δ|)²

paths show it in four logs of five. For δ stands what Q alone says, which errs less than the estimate that has to be
shown, and not with it: a log that missed a difference has most often a low estimate of it. Its σ is most often too
large, for one heavy residual suffices; so σ is that of residuals that are all alike, where weights are known, and
`REST` times as much for what else is fitted. δ is taken to be known to σ.
"""

from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from halfseen.evaluation.estimate import Estimate

REST = 1.15
"""Our choice, made on logs of the cell in `examples/bin_cell`."""
POWER = 0.8
"""Share of the logs that are to decide."""
MANY_TIMES = 100.0
"""More than so many times as many paths nobody records."""


class Needed(NamedTuple):
    """How many times as many paths decide, at least 1; ∞ where no log of a size that can be recorded does."""

    times: float
    low: float
    high: float
    gain: float
    """δ."""


def needed(difference: Estimate, gain: float, level: float, alike: float | None = None) -> Needed:
    """Tell n*/n, and between what it lies as far as δ is known.

    Parameters
    ----------
    difference
        σ and β.
    gain
        δ.
    level
        Of the interval that is to exclude 0.
    alike
        Standard error if all residuals were alike; None if it is not known.
    """
    normal, error = NormalDist(), REST * alike if alike else difference.standard_error
    reach = difference.bias + (normal.inv_cdf((1.0 + level) / 2.0) + normal.inv_cdf(POWER)) * error

    def times(known: float) -> float:
        found = (reach / known) ** 2 if known > 0 else np.inf
        return max(found, 1.0) if found <= MANY_TIMES else np.inf

    return Needed(times(abs(gain)), times(abs(gain) + error), times(abs(gain) - error), gain)
