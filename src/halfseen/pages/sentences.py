"""Sentences: lists and counts as people write them, and the one template in which claims are told."""

from collections.abc import Sequence
from dataclasses import dataclass

from halfseen.evaluation.estimate import Estimate
from halfseen.pages.numbers import amount, interval, p_value

SUPPORTED, NOT_SUPPORTED, INCONCLUSIVE = "supported", "not supported", "inconclusive"


def listed(parts: Sequence[str], word: str = "and") -> str:
    """Join parts as a sentence does.

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
    """Begin with a capital, and end with a full stop unless there is an end."""
    return capitalised(words) + ("" if words.endswith(("?", ".", "!")) else ".")


def capitalised(words: str) -> str:
    """Begin with a capital."""
    return words[:1].upper() + words[1:]


@dataclass(frozen=True)
class Claim:
    """That one thing is better than another, what was found of it, and what a test says.

    Parameters
    ----------
    subject, rival
        What is compared.
    asserted, denied
        The claim as a verb, and its denial: ``earns more than``, ``does not earn more than``.
    gain
        Paired difference, above 0 where it speaks for the claim.
    p_value
        One-sided, adjusted for the number of claims that are tested together; None where the 95 % interval decides.
    alpha
        Level of the test.
    note
        What the two earned, for the bracket of the sentence.
    decimals
        With which the gain is written.
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
        """The verb that the verdict leaves: that of the claim, its denial, or neither."""
        verbs = {SUPPORTED: self.asserted, NOT_SUPPORTED: self.denied}
        return verbs.get(self.verdict, "shows no significant difference from")

    @property
    def title(self) -> str:
        """What was found, as a statement; the first words of a figure."""
        return f"{self.subject} {self.found} {self.rival}"

    @property
    def numbers(self) -> str:
        """The gain with its 95 % interval, and the p-value where there was a test."""
        low_high = interval(self.gain.low, self.gain.high, self.decimals)
        parts = [self.note] if self.note else []
        parts.append(f"difference {amount(self.gain.value, self.decimals)}, 95 % interval {low_high}")
        if self.p_value is not None:
            written = p_value(self.p_value)
            parts.append(f"adjusted p {written if written[0] in '<>' else f'= {written}'}")
        return "; ".join(parts)

    @property
    def sentence(self) -> str:
        """The template: claim, verdict, estimate, test."""
        return f"{self.subject} {self.asserted} {self.rival}: {self.verdict} ({self.numbers})."
