"""Times that are equal up to rounding: ticks that were added up, a clock's origin that was subtracted.

Completions come before cuts at equal times, so a tie that rounding breaks biases Ĝ. What rounding leaves stands out:
between it and the differences that are real there is a gap that chance does not make.
"""

import numpy as np

from halfseen.arrays import Rows
from halfseen.shapes import Float

LARGEST_ROUNDING = 1e-5
"""Of the span of nine in ten times; larger differences are no rounding."""
CHANCE = 1e-9
"""Of taking differences between times that fall anywhere for rounding."""
SMALLEST_RATIO = 20.0
"""Between the smallest difference that is real and the largest that is rounding."""
ROOM = 10.0
"""Times may differ by this many of the largest roundings seen."""
ULPS = 64.0
"""Units in the last place of the latest time that are rounding in any log."""


def clock_tolerance_s(time: Rows) -> float:
    """How far apart times may be that are meant to be equal [s].

    Sort the differences d_1 ≤ d_2 ≤ … between neighbouring distinct times. Were there no rounding, d_{k+1} ≥ r d_k
    would have probability r^−k. So the largest d_k with r^−k ≤ 1e-9 and r ≥ 20 is rounding, if it is at most 1e-5 of
    the span of nine in ten times, and times may differ by up to ten times as much. Where there is no such d_k, they may
    differ by 64 units in the last place.

    Parameters
    ----------
    time
        Finite times [s].
    """
    distinct = np.unique(time)
    differences = np.diff(distinct)
    gaps = np.sort(differences)
    largest_s = LARGEST_ROUNDING * float(np.quantile(time, 0.9) - distinct[0])
    small = gaps[:-1][gaps[:-1] <= largest_s]
    ratio = gaps[1 : len(small) + 1] / small
    is_clear = (np.arange(1, len(small) + 1) * np.log(ratio) >= -np.log(CHANCE)) & (ratio >= SMALLEST_RATIO)
    for k in np.flatnonzero(is_clear)[::-1].tolist():
        tolerance_s = float(small[k] * min(ROOM, np.sqrt(ratio[k])))
        begins = np.flatnonzero(np.append(True, differences > small[k]))
        widths_s = distinct[np.append(begins[1:], len(distinct)) - 1] - distinct[begins]
        if widths_s.max() <= tolerance_s:
            return tolerance_s
    return ULPS * float(np.finfo(np.float64).eps * np.abs(distinct).max())


def tied(time: Rows) -> tuple[Rows, float]:
    """Give times that are meant to be equal the earliest of them, and the tolerance [s]; 0 where there are none."""
    tolerance_s = clock_tolerance_s(time)
    distinct, place = np.unique(time, return_inverse=True)
    is_first = np.append(True, np.diff(distinct) > tolerance_s)
    return distinct[is_first][np.cumsum(is_first) - 1][place], 0.0 if is_first.all() else tolerance_s


def tied_clocks(end_s: Rows, elapsed_s: Float[np.ndarray, "n T"]) -> tuple[Rows, Float[np.ndarray, "n T"]]:
    """Make ends [s] and clocks of stages [s] equal that are meant to be; a clock may be NaN."""
    is_known = ~np.isnan(elapsed_s)
    both, _ = tied(np.concatenate([end_s, elapsed_s[is_known]]))
    clock = np.full(elapsed_s.shape, np.nan)
    clock[is_known] = both[len(end_s) :]
    return both[: len(end_s)], clock
