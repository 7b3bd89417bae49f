"""How many paths like those of a log would decide whether a policy is better.

The standard error σ of a difference shrinks as 1/√n, for it is the spread of what paths add. If δ is the difference,

    n* = n·((z₀.₉₇₅ + z₀.₈) σ / (|δ| − β))²

paths find it in four logs of five, with β the bias that the interval allows for. δ is known no better than to σ, and so
n* to what one more or less of it makes.
"""

from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from halfseen.evaluation.estimate import Estimate

POWER = 0.8
"""Share of the logs that are to decide."""
MANY_TIMES = 100.0
"""More than so many times as many paths nobody records."""


class Needed(NamedTuple):
    """Paths that decide, about; ∞ where no log of a size that can be recorded does."""

    paths: float
    low: float
    high: float


def needed(difference: Estimate, num_paths: int, level: float = 0.95) -> Needed:
    """Tell n*, and between what it lies as far as δ is known.

    Parameters
    ----------
    difference
        δ, σ and β.
    num_paths
        n of the log.
    level
        Of the interval that is to exclude 0.
    """
    normal = NormalDist()
    reach = normal.inv_cdf((1.0 + level) / 2.0) + normal.inv_cdf(POWER)

    def paths(gain: float) -> float:
        known = gain - difference.bias
        found = num_paths * (reach * difference.standard_error / known) ** 2 if known > 0 else np.inf
        return found if found <= MANY_TIMES * num_paths else np.inf

    gain, error = abs(difference.value), difference.standard_error
    return Needed(paths(gain), paths(gain + error), paths(gain - error))


def paths_that_decide(difference: Estimate, num_paths: int, level: float = 0.95) -> str:
    """Say so in a clause."""
    found = needed(difference, num_paths, level)
    if np.isinf(found.paths):
        return "no log of a size that can be recorded would show so small a difference"
    most = f"to {_rounded(found.high)}" if np.isfinite(found.high) else "or many more"
    more = max(found.paths - num_paths, 0.0)
    total = f"{_rounded(found.paths)} in all ({_rounded(found.low)} {most})"
    return f"about {_rounded(more)} more paths like these would decide, {total}"


def _rounded(number: float) -> str:
    """Two digits."""
    size = 10.0 ** max(np.floor(np.log10(max(number, 1.0))) - 1.0, 0.0)
    return f"{np.round(number / size) * size:,.0f}"
