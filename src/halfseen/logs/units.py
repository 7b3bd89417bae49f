"""The unit in which rewards are counted: a short text, for people."""

from collections.abc import Iterable
from typing import Any

from halfseen.errors import LogError
from halfseen.logs.columns import shown

MOST_UNIT_CHARS = 24
_UNIT_REMEDY = f"give a text of one line and at most {MOST_UNIT_CHARS} characters, such as 'parts', or leave it out"


def checked_unit(unit: Any) -> str | None:
    """Take a unit of rewards without the blanks around it; None where there is none.

    Raises
    ------
    LogError
        It is no short text.
    """
    if unit is None:
        return None
    stripped = unit.strip() if isinstance(unit, str) else ""
    if not stripped or len(stripped) > MOST_UNIT_CHARS or not stripped.isprintable():
        raise LogError(f"reward_unit is {shown(unit)}, which is no short text; {_UNIT_REMEDY}")
    return stripped


def common_unit(units: Iterable[str | None]) -> str | None:
    """The one unit of several logs; those that name none go with the others.

    Raises
    ------
    LogError
        Two are in different ones.
    """
    known = list(dict.fromkeys(unit for unit in units if unit is not None))
    if len(known) > 1:
        raise LogError(f"rewards are in {known[0]!r} and in {known[1]!r}; bring the logs to one unit before they join")
    return known[0] if known else None
