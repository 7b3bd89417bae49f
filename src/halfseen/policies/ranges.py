"""What lies outside what the logs showed: there Q is extrapolated."""

from collections.abc import Callable, Mapping

Ranges = Mapping[str, tuple[float, float]]
"""Least and largest value of each thing that a policy looks at."""

RangesOfStage = Callable[[int], Ranges | None]
"""Ranges that the logs showed where Q of a stage was learned; None if no path came so far."""


def everything(stage: int) -> Ranges:
    """No ranges are known, so nothing lies outside."""
    return {}


def beyond(ranges: Ranges | None, values: Mapping[str, Mapping[str, float]]) -> tuple[str, ...]:
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
    for name, (low, high) in ranges.items():
        slack = 1e-6 * max(1.0, abs(low), abs(high))
        outside = [(whose, value) for whose, value in values[name].items() if not low - slack <= value <= high + slack]
        for whose, value in outside[:1]:
            warnings.append(f"{whose} is {value:.4g}, outside the logs ({low:.3g} to {high:.3g}); Q is extrapolated")
    return tuple(warnings)
