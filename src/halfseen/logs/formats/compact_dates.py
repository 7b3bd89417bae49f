"""Dates and times of day without separators, such as 20250101T120000Z, or 20250101120000, which is no number."""

import re
from collections.abc import Sequence

FEWEST_SECONDS, FEWEST_MINUTES = 10, 5
_OF_DAY = re.compile(r"([01]?\d|2[0-3])[0-5]\d[0-5]\d")
_COMPACT = re.compile(r"(?:19|20)\d\d(?:0\d|1[0-2])[0-3]\d([T ]?)[0-2]\d[0-5]\d([0-5]\d)?(Z|[+-]\d{4})?")


def compact_format(text: str) -> str | None:
    """The format of a date and time of day without separators, as in Python; None for other texts."""
    if (found := _COMPACT.fullmatch(text)) is None:
        return None
    between, seconds, zone = found.groups("")
    return f"%Y%m%d{between}%H%M{'%S' if seconds else ''}{'%z' if zone else ''}"


def are_times_of_day(texts: Sequence[str]) -> bool:
    """Whether numbers, such as 95957, are hours, minutes and seconds: none has more than 59 of the latter two."""
    have_spread = (
        len({text[-2:] for text in texts}) >= FEWEST_SECONDS and len({text[:-2] for text in texts}) >= FEWEST_MINUTES
    )
    return have_spread and all(map(_OF_DAY.fullmatch, texts))
