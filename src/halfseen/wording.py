"""How numbers, lists and claims are written in figures, tables and sentences."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

from halfseen.evaluation.estimate import Estimate

MISSING = "–"
SUPPORTED, NOT_SUPPORTED, INCONCLUSIVE = "supported", "not supported", "inconclusive"
MOST_DECIMALS = 6
SMALLEST_PLAIN, LARGEST_PLAIN = 1e-4, 1e6
"""Beyond these, a number has more digits than a reader takes in: a power of ten is written."""
_LARGEST_DENOMINATOR = 12
_SMALLEST_PLAIN_P = 1e-4
_SMALLEST_P = 1e-300
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_IN_WORDS = {"1/2": "half", "1/3": "a third", "2/3": "two thirds", "1/4": "a quarter", "1/6": "a sixth"}


def amount(value: float | None, decimals: int = 2) -> str:
    """Write a number with `decimals` decimals and a true minus sign; a dash if there is none.

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
    """Write a number with `num_digits` significant digits; a dash if there is none.

    Examples
    --------
    >>> significant(-12.3456), significant(1234.5), significant(12263681070.0), significant(float("nan"))
    ('−12.3', '1,234', '1.23e+10', '–')
    """
    if value is None or not math.isfinite(value) or value == 0:
        return "0" if value == 0 else MISSING
    decimals = max(num_digits - 1 - math.floor(math.log10(abs(value))), 0)
    is_plain = decimals <= MOST_DECIMALS and abs(value) < LARGEST_PLAIN
    text = f"{value:,.{decimals}f}" if is_plain else f"{value:.{num_digits - 1}e}"
    return text.replace("-", "−")


def interval(low: float, high: float, decimals: int = 2) -> str:
    """Write an interval: ``0.12 to 0.34``; a dash if there is none."""
    if not (math.isfinite(low) and math.isfinite(high)):
        return MISSING
    return f"{amount(low, decimals)} to {amount(high, decimals)}"


def estimated(value: float, low: float, high: float, decimals: int = 2) -> str:
    """Write a value with its interval: ``0.23 (0.12 to 0.34)``."""
    return f"{amount(value, decimals)} ({interval(low, high, decimals)})"


def with_interval(value: float, low: float, high: float) -> tuple[str, str]:
    """Write a value and its interval with the same number of decimals, chosen by the width of the interval.

    Examples
    --------
    >>> with_interval(9.8765, 9.4, 10.35), with_interval(1.42e-7, 1.01e-7, 1.93e-7)
    (('9.88', '9.40 to 10.35'), ('1.42e−07', '1.01e−07 to 1.93e−07'))
    """
    width = high - low
    if not (math.isfinite(value) and math.isfinite(width)):
        return significant(value), MISSING
    largest = max(abs(value), abs(low), abs(high))
    is_plain = largest == 0 or SMALLEST_PLAIN <= largest < LARGEST_PLAIN
    power = 0 if is_plain else math.floor(math.log10(largest))
    decimals = 2 if width == 0 else min(max(1 + power - math.floor(math.log10(width)), 0), MOST_DECIMALS)
    if is_plain:
        return amount(value, decimals), interval(low, high, decimals)
    written = [f"{amount(each / 10.0**power, decimals)}e{power:+03d}".replace("-", "−") for each in (value, low, high)]
    return written[0], f"{written[1]} to {written[2]}"


def percent(share: float | None) -> str:
    """Write a proportion in per cent, with no line break; a dash if there is none.

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
    """Write a proportion as a simple fraction if it is one: ``1/6``, ``37 %``, ``none``."""
    if value == 0:
        return "none"
    fraction = Fraction(value).limit_denominator(_LARGEST_DENOMINATOR)
    return str(fraction) if abs(float(fraction) - value) < 1e-6 else f"{100 * value:.3g} %"


def share_in_words(value: float) -> str:
    """Write a proportion as in running text: ``half``, ``a third``; otherwise as `share`."""
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
        return "< 10" + str(round(math.log10(_SMALLEST_P))).translate(SUPERSCRIPTS)
    mantissa, exponent = f"{value:.1e}".split("e")
    return f"{mantissa} × 10" + str(int(exponent)).translate(SUPERSCRIPTS)


def with_unit(number: str, unit: str | None) -> str:
    """Write a number and its unit with no line break; the number alone if the unit is unknown.

    Examples
    --------
    >>> with_unit("0.53", "parts").split(), with_unit("0.53", None)
    (['0.53', 'parts'], '0.53')
    """
    return f"{number}\u00a0{unit}" if unit else number


def labelled(quantity: str, unit: str | None) -> str:
    """Write a quantity with its unit in brackets, as on axes and in table heads.

    Examples
    --------
    >>> labelled("mean reward of a trajectory", "parts"), labelled("mean reward of a trajectory", None)
    ('mean reward of a trajectory [parts]', 'mean reward of a trajectory')
    """
    return f"{quantity} [{unit}]" if unit else quantity


def listed(parts: Sequence[str], word: str = "and") -> str:
    """Join parts as in a sentence.

    Examples
    --------
    >>> listed(["a", "b", "c"])
    'a, b and c'
    """
    return "".join(parts) if len(parts) < 2 else f"{', '.join(parts[:-1])} {word} {parts[-1]}"


def counted(count: int, one: str, many: str = "") -> str:
    """Write a count with its noun.

    Examples
    --------
    >>> counted(1, "trajectory"), counted(2000, "trajectory")
    ('1 trajectory', '2,000 trajectories')
    """
    return f"{count:,} {one if count == 1 else many or plural(one)}"


def plural(noun: str) -> str:
    """Write the plural of a regular noun: labels, trajectories."""
    return noun[:-1] + "ies" if noun.endswith("y") else noun + "s"


def as_sentence(words: str) -> str:
    """Capitalise the first letter, and add a full stop unless the sentence has an end."""
    return capitalised(words) + ("" if words.endswith(("?", ".", "!")) else ".")


def capitalised(words: str) -> str:
    """Capitalise the first letter."""
    return words[:1].upper() + words[1:]


@dataclass(frozen=True)
class Claim:
    """A claim that one thing is better than another, with its estimate and test.

    Parameters
    ----------
    subject, rival
        The things compared.
    asserted, denied
        The claim as a verb, and its denial: ``earns more than``, ``does not earn more than``.
    gain
        Paired difference, above 0 where it supports the claim.
    p_value
        One-sided, adjusted for the number of claims tested together; None where the 95 % interval decides.
    alpha
        Level of the test.
    note
        What the two earned, for the brackets of the sentence.
    decimals
        Number of decimals of the gain.
    """

    subject: str
    asserted: str
    denied: str
    rival: str
    gain: Estimate
    p_value: float | None = None
    alpha: float = 0.05
    note: str = ""
    decimals: int = 2

    @property
    def verdict(self) -> str:
        """Supported, not supported (the 95 % interval lies below 0), or inconclusive."""
        is_supported = self.gain.low > 0 if self.p_value is None else self.p_value < self.alpha
        if is_supported:
            return SUPPORTED
        return NOT_SUPPORTED if self.gain.high < 0 else INCONCLUSIVE

    @property
    def found(self) -> str:
        """The verb that follows from the verdict: that of the claim, its denial, or neither."""
        verbs = {SUPPORTED: self.asserted, NOT_SUPPORTED: self.denied}
        return verbs.get(self.verdict, "shows no significant difference from")

    @property
    def title(self) -> str:
        """The finding as a statement; the first words of a figure."""
        return f"{self.subject} {self.found} {self.rival}"

    @property
    def numbers(self) -> str:
        """The gain with its 95 % interval, and the p-value if there was a test."""
        low_high = interval(self.gain.low, self.gain.high, self.decimals)
        parts = [self.note] if self.note else []
        parts.append(f"difference {amount(self.gain.value, self.decimals)}, 95 % interval {low_high}")
        if self.p_value is not None:
            written = p_value(self.p_value)
            parts.append(f"adjusted p {written if written[0] in '<>' else f'= {written}'}")
        return "; ".join(parts)

    @property
    def sentence(self) -> str:
        """The sentence: claim, verdict, estimate, test."""
        return f"{self.subject} {self.asserted} {self.rival}: {self.verdict} ({self.numbers})."
