"""Tails of Student's t, and where a function crosses 0.

SciPy has both; loading them takes longer than all else that a verdict on some hundred trajectories needs.
"""

from collections.abc import Callable
from itertools import pairwise
from math import copysign, erfc, exp, lgamma, log, log1p, sqrt

AS_NORMAL = 1e7
"""Degrees of freedom from which t is taken for normal, which changes a tail by 1e-7 of its size for |x| < 1."""
RESOLUTION = 1e-13
"""Relative, of what is found step by step."""
TINY = 1e-300


def upper_tail(x: float, freedom: float) -> float:
    """P(T > x) of a t distribution."""
    if freedom >= AS_NORMAL:
        return 0.5 * erfc(x / sqrt(2.0))
    beyond = 0.5 * _incomplete_beta(freedom, x * x)
    return beyond if x >= 0.0 else 1.0 - beyond


def crossing(function: Callable[[float], float], low: float, high: float) -> float:
    """Where a function crosses 0 between two ends at which its signs differ, by Ridders' method [Ridders1979]_."""
    at_low, at_high, before = function(low), function(high), low
    while True:
        middle = 0.5 * (low + high)
        at_middle = function(middle)
        spread = sqrt(at_middle * at_middle - at_low * at_high)
        if spread == 0.0:
            return middle if at_low * at_high else (low if at_low == 0.0 else high)
        found = middle + (middle - low) * copysign(1.0, at_low - at_high) * at_middle / spread
        value = function(found)
        step = RESOLUTION * max(abs(found), TINY)
        if value == 0.0 or (abs(found - before) <= step and function(found - step) * function(found + step) <= 0.0):
            return found
        ends = sorted([(low, at_low), (middle, at_middle), (found, value), (high, at_high)])
        (low, at_low), (high, at_high) = next(
            (left, right) for left, right in pairwise(ends) if left[1] * right[1] <= 0.0
        )
        before = found


def _incomplete_beta(freedom: float, squared: float) -> float:
    """I_z(ν/2, ½) with z = ν / (ν + x²): P(|T| > x)."""
    a, b = 0.5 * freedom, 0.5
    log_z, log_rest = -log1p(squared / freedom), -log1p(freedom / squared) if squared > 0.0 else -float("inf")
    front = exp(_log_gamma_step(a) - lgamma(b) + a * log_z + b * log_rest)
    if squared * (a + 1.0) > freedom * (b + 1.0):
        return front * _fraction(a, b, exp(log_z)) / a
    return 1.0 - front * _fraction(b, a, exp(log_rest)) / b


def _log_gamma_step(a: float) -> float:
    """Ln Γ(a + ½) − ln Γ(a), for large a by its asymptotic series, which loses no digits."""
    if a < 100.0:
        return lgamma(a + 0.5) - lgamma(a)
    return 0.5 * log(a) - 1.0 / (8.0 * a) + 1.0 / (192.0 * a**3) - 1.0 / (640.0 * a**5)


def _fraction(a: float, b: float, z: float) -> float:
    """The continued fraction of I_z(a, b), by the modified method of Lentz [Lentz1976]_."""
    d = 1.0 / (1.0 - (a + b) * z / (a + 1.0) or TINY)
    c, fraction, n = 1.0, d, 0
    while True:
        n += 1
        even = n * (b - n) * z / ((a + 2 * n - 1.0) * (a + 2 * n))
        odd = -(a + n) * (a + b + n) * z / ((a + 2 * n) * (a + 2 * n + 1.0))
        for numerator in (even, odd):
            d = 1.0 / (1.0 + numerator * d or TINY)
            c = 1.0 + numerator / c or TINY
            fraction *= c * d
        if abs(c * d - 1.0) <= 1e-15 or n > 10_000:
            return fraction
