"""Where a folder of logs lies: on this machine, or in an object store that an address names, such as s3://fleet/2026."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from halfseen.errors import HalfseenError, LogError

Place = Any
"""A `Path`, or what does the same in a store (``UPath``)."""


def place_of(address: str | Path | Place) -> Place:
    """Find a folder by its path or its address.

    Parameters
    ----------
    address
        A path, or an address that ``fsspec`` knows how to open.

    Raises
    ------
    LogError
        There is no such kind of store, or what opens it is not installed.
    """
    if not isinstance(address, str) or not is_remote(address):
        return address if not isinstance(address, str) else Path(address)
    # A store needs a library that nothing else does.
    from upath import UPath

    try:
        place = UPath(address)
        place.fs  # noqa: B018 - what opens the store loads here
    except (ImportError, ValueError) as error:
        reason = str(error).splitlines()[0].rstrip(".")
        raise LogError(f"{address}: it cannot be opened ({reason}); install that, or copy the folder here") from error
    return place


def is_remote(address: str) -> bool:
    """Whether it is the address of a store."""
    return "://" in address


@contextmanager
def asking(place: Place) -> Iterator[None]:
    """Tell what a store answers, whatever its library raises, in one line with the place.

    Raises
    ------
    LogError
        The store refused, or was not reached.
    """
    try:
        yield
    except (HalfseenError, FileNotFoundError):
        raise
    except Exception as error:
        if isinstance(place, Path):
            raise
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise LogError(f"{place}: the store did not answer ({reason}); check the address and your access") from error
