"""Dates without separators, such as 20250101T120000Z, or 20250101120000, which is no number."""

import re

_COMPACT = re.compile(r"(?:19|20)\d\d(?:0\d|1[0-2])[0-3]\d([T ]?)[0-2]\d[0-5]\d([0-5]\d)?(Z|[+-]\d{4})?")


def compact_format(text: str) -> str | None:
    """The format of a date and time of day without separators, as in Python; None for other texts."""
    if (found := _COMPACT.fullmatch(text)) is None:
        return None
    between, seconds, zone = found.groups("")
    return f"%Y%m%d{between}%H%M{'%S' if seconds else ''}{'%z' if zone else ''}"
