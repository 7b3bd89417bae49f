"""Values outside the ranges of the logs: Q is extrapolated there, and is meaningless far outside.

The last of n + 1 independent values lies outside the range of the others in 2 of n + 1 cases, so with many covariates
nearly every state lies outside in one of them. A margin allows for that: it reaches beyond the largest of n values by
excess · ln(2 d / (n CHANCE)) for d ranges, where excess is the mean excess of the ⌈√n⌉ largest over the next one, as
tails are roughly exponential [Weissman1978]_.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from halfseen.errors import OutOfRangeError
from halfseen.shapes import Float

Range = tuple[float, float] | Mapping[str, int]
"""Least and largest value of a number; for text, the number of states of each category."""

Ranges = Mapping[str, Range]
"""Ranges in the logs of the quantities that a policy looks at."""

RangesOfStage = Callable[[int], Ranges | None]
"""Ranges in the logs where Q of a stage was learned; None if no trajectory reached it."""

Margins = Mapping[str, tuple[float, float]]
"""How far below and above its range a number may lie by chance."""

Values = Mapping[str, Mapping[str, Any]]
"""For each name of a range, the values, by what each belongs to."""

FARTHEST = 1.0
"""A value is far outside if it is beyond an end of its range by this many widths of the range."""

CHANCE = 0.01
"""Probability that a trajectory of the logs' own cell leaves the margin of any range, at either end."""

LARGEST = float(np.finfo(np.float64).max)
"""Upper bound of a margin."""

NO_MARGINS: Margins = MappingProxyType({})

ROUNDING = 1e-6
"""Relative error of values computed in single precision, such as states of tables."""
NO_TRAJECTORY = "no trajectory of the logs reached this stage"


def everything(stage: int) -> Ranges:
    """No ranges are known, so nothing lies outside."""
    return {}


def no_margins(stage: int) -> Margins:
    """No value outside a range is attributed to chance."""
    return NO_MARGINS


def most_with_margin(num_ranges: int) -> int:
    """Number of trajectories from which on no range has a margin."""
    return int(np.ceil(2.0 * num_ranges / CHANCE))


def margin(largest: Float[np.ndarray, " n"], num_ranges: int) -> float:
    """How far beyond the largest of n values the next may lie by chance; 0 if ties make that unlikely.

    Parameters
    ----------
    largest
        The largest value of each trajectory.
    num_ranges
        Number of ranges that share `CHANCE`.

    Examples
    --------
    Of 100 exponential values, the next lies more than ln 4 beyond the largest in 1 of 400 cases.

    >>> round(margin(-np.log((np.arange(100) + 0.5) / 100.0), 2), 1)
    1.4
    """
    num, top = len(largest), int(np.ceil(np.sqrt(len(largest))))
    if num <= top or num >= most_with_margin(num_ranges):
        return 0.0
    ordered = np.sort(largest)
    excess = float(np.sum(ordered[-top:] / top - ordered[-top - 1] / top))
    return min(excess * float(np.log(2.0 * num_ranges / (num * CHANCE))), LARGEST)


def middle_of(seen: Range) -> float | str:
    """Middle of a range, or the most frequent category."""
    return max(seen, key=seen.__getitem__) if isinstance(seen, Mapping) else sum(seen) / 2.0


def beyond(ranges: Ranges | None, values: Values, rounding: float = 0.0) -> tuple[str, ...]:
    """Say what lies outside, the first of each kind.

    Parameters
    ----------
    ranges
        Ranges of the logs.
    values
        For each name of a range, the values, by what each belongs to.
    rounding
        Relative error of the values; measured values are compared exactly.
    """
    found = [NO_TRAJECTORY] if ranges is None else []
    for name, seen in (ranges or {}).items():
        outside = [one for one in values[name].items() if not _is_within(seen, one[1], rounding)]
        found += [f"{whose} is {_beyond(seen, value)}" for whose, value in outside[:1]]
    return tuple(f"{one}; Q is extrapolated" for one in found)


def refuse_outside(ranges: Ranges | None, values: Values, margins: Margins = NO_MARGINS) -> None:
    """Refuse values that lie outside by more than their margin; without a margin, any value outside.

    Parameters
    ----------
    ranges
        Ranges of the logs.
    values
        For each name of a range, the values, by what each belongs to.
    margins
        Margins of ranges of numbers.

    Raises
    ------
    OutOfRangeError
        A value does; it is named, with the allowed values.
    """
    if ranges is None:
        raise OutOfRangeError(NO_TRAJECTORY)
    for name, seen in ranges.items():
        below, above = margins.get(name, (0.0, 0.0))
        wider = seen if isinstance(seen, Mapping) else (seen[0] - below, seen[1] + above)
        outside = [one for one in values[name].items() if not _is_within(wider, one[1], 0.0)]
        if outside:
            whose, value = outside[0]
            where = "farther outside the logs than chance explains" if below or above else "outside the logs"
            raise OutOfRangeError(f"{whose} is {_beyond(wider, value, where)}")


def refuse_far(ranges: Ranges | None, values: Values) -> None:
    """Refuse values so far outside that Q is meaningless: beyond an end of the range by more than its width.

    A quantity that never varied is given a width of its absolute value, and at least 1.

    Parameters
    ----------
    ranges
        Ranges of the logs.
    values
        For each name of a range, the values, by what each belongs to.

    Raises
    ------
    OutOfRangeError
        A value is; it is named, with its range and the remedy.
    """
    for name, seen in (ranges or {}).items():
        far = [] if isinstance(seen, Mapping) else [one for one in values[name].items() if _is_far(seen, one[1])]
        if far:
            whose, value = far[0]
            raise OutOfRangeError(
                f"{whose} is {_beyond(seen, value)} by more than the width of this range, so Q says nothing about it; "
                "check its unit, learn from logs that show it, or pass --extrapolate (extrapolates=True)"
            )


def _is_within(seen: Range, value: Any, rounding: float) -> bool:
    if isinstance(seen, Mapping):
        return value in seen
    low, high = seen
    slack = rounding * max(1.0, abs(low), abs(high))
    return low - slack <= value <= high + slack


def _is_far(seen: tuple[float, float], value: float) -> bool:
    low, high = seen
    width = (high - low) or max(1.0, abs(high))
    return max(low - value, value - high) > FARTHEST * width * (1.0 + ROUNDING)


def _beyond(seen: Range, value: Any, where: str = "outside the logs") -> str:
    if isinstance(seen, Mapping):
        return f"{value}, which no state of the logs showed at this stage"
    is_value, (low, high) = _distinct(float(value), seen)
    return f"{is_value}, {where} ({low} to {high})"


def _distinct(value: float, seen: tuple[float, float]) -> tuple[str, tuple[str, str]]:
    """Write a value and a range with enough digits to show on which side of it the value lies."""
    for digits in range(3, 18):
        is_value, low, high = (f"{each:.{digits}g}" for each in (value, *seen))
        if not float(low) <= float(is_value) <= float(high):
            return f"{value:.{max(digits, 4)}g}", (low, high)
    return repr(value), (repr(seen[0]), repr(seen[1]))
