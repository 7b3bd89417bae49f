"""A mean as a multiple of another to which the same trajectories add, with its interval by the delta method.

With φ_i and ψ_i what trajectory i adds to the two, and r = φ̄/ψ̄, what it adds to the quotient is r + (φ_i − r ψ_i)/ψ̄:
a paired difference, so that what moves both (the luck of a trajectory) moves the quotient little. The jackknife
divides, too.
"""

from collections.abc import Callable

import numpy as np

from halfseen.evaluation.comparison import WRONG_BY, Contender
from halfseen.evaluation.estimate import Estimate, estimate_of
from halfseen.shapes import Float


def share_of(policy: Contender, today: Contender, level: float) -> Estimate | None:
    """What a policy earns as a multiple of what another does; both meet the same mistake of what stands for cuts.

    None where the other's interval holds 0, or what it earns is not above 0.
    """
    return _quotient(
        policy,
        today,
        level,
        lambda share: abs(policy.uncorrected - share * today.uncorrected) + _truncated(policy, share, today),
    )


def rate_of(earned: Contender, took: Contender, level: float) -> Estimate | None:
    """What is earned for each unit of what it took; two regressions stand for cuts, and may both be wrong.

    None where nobody knows that it took anything.
    """
    return _quotient(
        earned,
        took,
        level,
        lambda rate: abs(earned.uncorrected) + abs(rate * took.uncorrected) + _truncated(earned, rate, took),
    )


def _quotient(
    above: Contender, below: Contender, level: float, uncorrected_at: Callable[[float], float]
) -> Estimate | None:
    if above.values is None or below.values is None:
        return None
    lower = below.estimate(level)
    if not lower.low > 0.0:
        return None
    quotient = float(above.values.mean()) / lower.value
    influence = quotient + (above.values - quotient * below.values) / lower.value
    size = min(above.effective_sample_size, below.effective_sample_size)
    bias = WRONG_BY * uncorrected_at(quotient) / lower.value
    return estimate_of(influence, size, level, _without(above, below), bias)


def _truncated(above: Contender, quotient: float, below: Contender) -> float:
    return above.truncated + abs(quotient) * below.truncated


def _without(above: Contender, below: Contender) -> Float[np.ndarray, " K"] | None:
    """The quotient without each fold; None where it has none."""
    if above.without is None or below.without is None or not (below.without > 0.0).all():
        return None
    return above.without / below.without
