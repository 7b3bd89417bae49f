"""What may have been meant by a name that does not exist."""

from collections.abc import Iterable
from difflib import get_close_matches


def closest(given: object, known: Iterable[object]) -> str | None:
    """Name the one of `known` that is most like `given`, capitals aside; None if none is much like it."""
    names = {str(name).lower(): str(name) for name in known}
    close = get_close_matches(str(given).lower(), names, n=1)
    return names[close[0]] if close else None


def did_you_mean(given: object, known: Iterable[object]) -> str:
    """Ask whether another name was meant: an end for a message, empty if there is none like it.

    Parameters
    ----------
    given
        What was typed.
    known
        The names that there are.
    """
    name = closest(given, known)
    return "" if name is None else f"; did you mean {name!r}?"
