"""How numbers are written for people: in figures, tables and sentences alike."""

import math
from fractions import Fraction

MISSING = "–"
MOST_DECIMALS = 6
_LARGEST_DENOMINATOR = 12
_SMALLEST_PLAIN_P = 1e-4
_SMALLEST_P = 1e-300
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_IN_WORDS = {"1/2": "half", "1/3": "a third", "2/3": "two thirds", "1/4": "a quarter", "1/6": "a sixth"}


def amount(value: float | None, decimals: int = 2) -> str:
    """Write a number with so many decimals and a true minus sign; a dash where there is none.

    Examples
    --------
    >>> amount(-12.3456), amount(-0.001), amount(float("nan"))
    ('−12.35', '0.00', '–')
    """
    if value is None or not math.isfinite(value):
        return MISSING
    text = f"{value:,.{decimals}f}"
    return text.lstrip("-") if not text.strip("-0.,") else text.replace("-", "−")


def significant(value: float | None, num_digits: int = 3) -> str:
    """Write a number with so many significant digits; a dash where there is none.

    Examples
    --------
    >>> significant(-12.3456), significant(1234.5), significant(float("nan"))
    ('−12.3', '1,234', '–')
    """
    if value is None or not math.isfinite(value) or value == 0:
        return "0" if value == 0 else MISSING
    decimals = max(num_digits - 1 - math.floor(math.log10(abs(value))), 0)
    text = f"{value:,.{decimals}f}" if decimals <= MOST_DECIMALS else f"{value:.{num_digits - 1}e}"
    return text.replace("-", "−")


def interval(low: float, high: float, decimals: int = 2) -> str:
    """Write an interval: ``0.12 to 0.34``; a dash where there is none."""
    if not (math.isfinite(low) and math.isfinite(high)):
        return MISSING
    return f"{amount(low, decimals)} to {amount(high, decimals)}"


def estimated(value: float, low: float, high: float, decimals: int = 2) -> str:
    """Write a value with its interval: ``0.23 (0.12 to 0.34)``."""
    return f"{amount(value, decimals)} ({interval(low, high, decimals)})"


def with_interval(value: float, low: float, high: float) -> tuple[str, str]:
    """Write a value and its interval alike, with as many decimals as the width of the interval makes worthwhile.

    Examples
    --------
    >>> with_interval(9.8765, 9.4, 10.35)
    ('9.88', '9.40 to 10.35')
    """
    width = high - low
    if not (math.isfinite(value) and math.isfinite(width)):
        return significant(value), MISSING
    decimals = 2 if width == 0 else min(max(1 - math.floor(math.log10(width)), 0), MOST_DECIMALS)
    return amount(value, decimals), interval(low, high, decimals)


def percent(share: float | None) -> str:
    """Write a proportion in per cent, in one piece; a dash where there is none.

    Examples
    --------
    >>> percent(0.254).split(), percent(None)
    (['25', '%'], '–')
    """
    if share is None or not math.isfinite(share):
        return MISSING
    if 0 < share < 0.01:
        return "<\u00a01\u00a0%"
    if 0.99 < share < 1:
        return ">\u00a099\u00a0%"
    return f"{share:.0%}".replace("%", "\u00a0%")


def share(value: float) -> str:
    """Write a proportion as a fraction where it is one: ``1/6``, ``37 %``, ``none``."""
    if value == 0:
        return "none"
    fraction = Fraction(value).limit_denominator(_LARGEST_DENOMINATOR)
    return str(fraction) if abs(float(fraction) - value) < 1e-6 else f"{100 * value:.3g} %"


def share_in_words(value: float) -> str:
    """Write a proportion as running text does: ``half``, ``a third``; otherwise as `share`."""
    return _IN_WORDS.get(share(value), share(value))


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
