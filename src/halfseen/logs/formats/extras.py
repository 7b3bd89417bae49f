"""Libraries that only some users need, and whatever they raise."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from types import ModuleType

from halfseen.errors import ArgumentError, HalfseenError, LogError
from halfseen.installation import command_for
from halfseen.reading import reason_of


def extra(module: str, name: str) -> ModuleType:
    """Import a module of the optional library that halfseen's extra of a name brings.

    Raises
    ------
    ArgumentError
        It is not installed.
    """
    try:
        return import_module(module)
    except ImportError as error:
        raise ArgumentError(f"{module} cannot be imported ({error}); run: {command_for(name)}") from error


@contextmanager
def refused(
    place: object,
    trouble: str,
    remedy: str,
    missing: str | None = None,
    passed: tuple[type[Exception], ...] = (HalfseenError, MemoryError),
) -> Iterator[None]:
    """Refuse what a library cannot read: with a broken file it raises nearly anything.

    Raises
    ------
    LogError
        Anything was raised but what is `passed`; `missing` is said of a file that is not there.
    """
    try:
        yield
    except passed:
        raise
    except Exception as error:
        if missing is not None and isinstance(error, FileNotFoundError):
            raise LogError(f"{place}: {missing}") from error
        raise LogError(f"{place}: {trouble} ({reason_of(error)}); {remedy}") from error
