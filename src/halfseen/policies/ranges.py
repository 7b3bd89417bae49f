"""What lies outside what the logs showed: there Q is extrapolated."""

from collections.abc import Callable, Mapping
from typing import Any

Range = tuple[float, float] | Mapping[str, int]
"""Least and largest value of what is a number; of text, how many states showed each category."""

Ranges = Mapping[str, Range]
"""What the logs showed of each thing that a policy looks at."""

RangesOfStage = Callable[[int], Ranges | None]
"""Ranges that the logs showed where Q of a stage was learned; None if no path came so far."""


def everything(stage: int) -> Ranges:
    """No ranges are known, so nothing lies outside."""
    return {}


def middle_of(seen: Range) -> float | str:
    """Middle of a range, or the category that most states showed."""
    return max(seen, key=seen.__getitem__) if isinstance(seen, Mapping) else sum(seen) / 2.0


def beyond(ranges: Ranges | None, values: Mapping[str, Mapping[str, Any]]) -> tuple[str, ...]:
    """Say what lies outside, the first of each kind.

    Parameters
    ----------
    ranges
        What the logs showed.
    values
        For each name of a range, whose value, and which.
    """
    if ranges is None:
        return ("no path of the logs came to this stage; Q is extrapolated",)
    warnings = []
    for name, seen in ranges.items():
        outside = [(whose, value) for whose, value in values[name].items() if not _is_within(seen, value)]
        for whose, value in outside[:1]:
            warnings.append(f"{whose} is {_told(seen, value)}; Q is extrapolated")
    return tuple(warnings)


def _is_within(seen: Range, value: Any) -> bool:
    if isinstance(seen, Mapping):
        return value in seen
    low, high = seen
    slack = 1e-6 * max(1.0, abs(low), abs(high))
    return low - slack <= value <= high + slack


def _told(seen: Range, value: Any) -> str:
    if isinstance(seen, Mapping):
        return f"{value}, which no state of the logs showed at this stage"
    low, high = seen
    return f"{value:.4g}, outside the logs ({low:.3g} to {high:.3g})"
