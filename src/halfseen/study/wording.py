"""How numbers, shares and kinds of cuts are written for people: in figures, tables and sentences alike."""

import math
from collections.abc import Sequence
from fractions import Fraction

MISSING = "–"
_LARGEST_DENOMINATOR = 12
_MOST_DECIMALS = 6
_SMALLEST_PLAIN_P = 1e-4
_SMALLEST_P = 1e-300
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

_SHARES_IN_WORDS = {"1/2": "half", "1/3": "a third", "2/3": "two thirds", "1/4": "a quarter", "1/6": "a sixth"}

CUT_KIND_NAMES = {
    "independent": "independent cuts",
    "occlusion": "cuts where much is hidden",
    "attempt": "the operator's hand",
}
"""Kind of cut → name for people."""

CUT_KIND_NOTES = {
    "independent": "they fall whatever happens on the table",
    "occlusion": "cuts whose hazard grows with occlusion",
    "attempt": "cuts whose hazard grows while an attempt drags on",
}
"""Kind of cut → what it is."""


def share(value: float) -> str:
    """Write a share as a fraction where it is one: ``1/6``, ``37 %``, ``none``."""
    if value == 0:
        return "none"
    fraction = Fraction(value).limit_denominator(_LARGEST_DENOMINATOR)
    if abs(float(fraction) - value) < 1e-6:
        return str(fraction)
    return f"{100 * value:.3g} %"


def share_in_words(value: float) -> str:
    """Write a share as running text does: ``half``, ``a third``; otherwise as `share`."""
    return _SHARES_IN_WORDS.get(share(value), share(value))


def amount(value: float, decimals: int = 2) -> str:
    """Write a number with a true minus sign; a dash where there is none."""
    if not math.isfinite(value):
        return MISSING
    text = f"{value:.{decimals}f}"
    is_zero = not text.strip("-0.")
    return text.lstrip("-") if is_zero else text.replace("-", "−")


def measured(value: float, measure: str) -> str:
    """Write a value of one of `halfseen.study.results.MEASURES`: two decimals of reward, three digits of a time."""
    return amount(value, 2 if measure == "reward" else _decimals(value, 3))


def interval(low: float, high: float) -> str:
    """Write an interval of rewards: ``0.12 to 0.34``; a dash where there is none."""
    return _interval(low, high, 2)


def difference(mean: float, low: float, high: float, measure: str) -> tuple[str, str]:
    """Write a difference and its interval alike: of times, as many digits as the interval's width makes worthwhile.

    Returns
    -------
    tuple of str
        The difference; its interval.
    """
    decimals = 2 if measure == "reward" else min(_decimals(high - low, 2), _decimals(mean, 4))
    return amount(mean, decimals), _interval(low, high, decimals)


def _interval(low: float, high: float, decimals: int) -> str:
    if not (math.isfinite(low) and math.isfinite(high)):
        return MISSING
    return f"{amount(low, decimals)} to {amount(high, decimals)}"


def _decimals(value: float, num_digits: int) -> int:
    """Decimals that show so many digits of a value."""
    if value == 0 or not math.isfinite(value):
        return num_digits
    return min(max(num_digits - 1 - math.floor(math.log10(abs(value))), 0), _MOST_DECIMALS)


def p_value(value: float) -> str:
    """Write a p-value with two digits, small ones as a power of ten."""
    if not math.isfinite(value):
        return MISSING
    if value > 0.99:
        return "> 0.99"
    if value >= _SMALLEST_PLAIN_P:
        return f"{value:.{max(2, 1 - math.floor(math.log10(value)))}f}"
    if value < _SMALLEST_P:
        return "< 10" + str(round(math.log10(_SMALLEST_P))).translate(_SUPERSCRIPTS)
    mantissa, exponent = f"{value:.1e}".split("e")
    return f"{mantissa} × 10" + str(int(exponent)).translate(_SUPERSCRIPTS)


def listed(parts: Sequence[str], word: str = "and") -> str:
    """Join parts as a sentence does: ``a``, ``a and b``, ``a, b and c``."""
    if len(parts) < 2:
        return "".join(parts)
    return f"{', '.join(parts[:-1])} {word} {parts[-1]}"
