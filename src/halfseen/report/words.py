"""How numbers are written on the page, and the sentences that say what they mean."""

import math
from collections.abc import Sequence

MISSING = "–"


def amount(value: float | None, num_digits: int = 3) -> str:
    """Write a number with so many digits and a true minus sign; a dash where there is none.

    Examples
    --------
    >>> amount(-12.3456), amount(1234.5), amount(float("nan"))
    ('−12.3', '1,234', '–')
    """
    if value is None or not math.isfinite(value):
        return MISSING
    if value == 0:
        return "0"
    decimals = max(num_digits - 1 - math.floor(math.log10(abs(value))), 0)
    text = f"{value:,.{decimals}f}" if decimals <= 6 else f"{value:.{num_digits - 1}e}"
    return text.replace("-", "−")


def with_interval(value: float, low: float, high: float) -> tuple[str, str]:
    """Write a value and its interval alike, with as many decimals as the width of the interval makes worthwhile.

    Examples
    --------
    >>> with_interval(9.8765, 9.4, 10.35)
    ('9.88', '9.40 to 10.35')
    """
    width = high - low
    if not (math.isfinite(value) and math.isfinite(width)):
        return amount(value), MISSING
    decimals = 2 if width == 0 else min(max(1 - math.floor(math.log10(width)), 0), 6)
    told = [f"{number:,.{decimals}f}" for number in (value, low, high)]
    told = [(text.lstrip("-") if not text.strip("-0.,") else text.replace("-", "−")) for text in told]
    return told[0], f"{told[1]} to {told[2]}"


def percent(share: float | None) -> str:
    """Write a share in per cent, in one piece; a dash where there is none.

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


def listed(parts: Sequence[str], word: str = "and") -> str:
    """Join parts as a sentence does.

    Examples
    --------
    >>> listed(["a", "b", "c"])
    'a, b and c'
    """
    if len(parts) < 2:
        return "".join(parts)
    return f"{', '.join(parts[:-1])} {word} {parts[-1]}"


def counted(count: int, one: str, many: str = "") -> str:
    """Write a count with its noun.

    Examples
    --------
    >>> counted(1, "path"), counted(2000, "path")
    ('1 path', '2,000 paths')
    """
    return f"{count:,} {one if count == 1 else many or one + 's'}"


def as_sentence(words: str) -> str:
    """Begin with a capital, and end with a full stop unless there is an end."""
    return words[:1].upper() + words[1:] + ("" if words.endswith(("?", ".", "!")) else ".")
