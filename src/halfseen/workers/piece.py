"""What a worker does with a piece: it sees that it is like home, makes the piece, and sends back what came out."""

import pickle
from collections.abc import Callable
from functools import cache, lru_cache
from importlib.metadata import PackageNotFoundError, version
from typing import Any, NamedTuple

import numpy as np

import halfseen
from halfseen.errors import HalfseenError, WorkerError
from halfseen.progress import Telling, telling
from halfseen.shapes import UInt8
from halfseen.workers.threads import one_thread

PACKAGES = ("mujoco", "numpy", "pandas", "scipy")
"""What the numbers depend on, beside halfseen."""


class Home(NamedTuple):
    """Where pieces come from, as far as what comes out of them depends on it."""

    versions: dict[str, str]


class Outcome(NamedTuple):
    """What came out of a piece."""

    number: int
    result: Any
    error: HalfseenError | None = None


def versions() -> dict[str, str]:
    """Versions of the packages that are installed here, by name."""
    return dict(_installed())


@cache
def _installed() -> dict[str, str]:
    # To find them takes as long as a small piece.
    found = {"halfseen": halfseen.__version__}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def home() -> Home:
    """Describe this process."""
    return Home(versions())


def made(asker: Home, function: UInt8[np.ndarray, " bytes"], number: int, piece: Any) -> Outcome:
    """Make a piece, in a worker; errors that a user can mend are sent back as they are."""
    try:
        _check_versions(asker)
        return Outcome(number, result_of(_function(function.tobytes()), piece))
    except HalfseenError as error:
        return Outcome(number, None, error)
    except MemoryError:
        return Outcome(number, None, WorkerError("a worker is out of memory; give --workers a smaller number"))


def result_of(function: Callable[[Any], Any], piece: Any) -> Any:
    """Make a piece as every worker does: it tells nothing, and matrices use one thread, as sums depend on that."""
    with telling(Telling.NOTHING), one_thread():
        return function(piece)


def _check_versions(asker: Home) -> None:
    """Refuse to work with other versions than those of the process that asks.

    Raises
    ------
    WorkerError
        Other versions are installed here.
    """
    here = versions()
    other = [name for name, wanted in asker.versions.items() if here.get(name) != wanted]
    if other:
        others = ", ".join(f"{name} {here.get(name, 'missing')} instead of {asker.versions[name]}" for name in other)
        raise WorkerError(
            f"a worker has other versions than the machine that asks: {others}; install the same on all machines"
        )


@lru_cache(maxsize=1)
def _function(function: bytes) -> Callable[[Any], Any]:
    # It came from the process that asks, and from nowhere else; what it has worked out serves the next piece.
    try:
        return pickle.loads(function)
    except ModuleNotFoundError as error:
        raise WorkerError(
            f"a worker cannot import {error.name}, which is needed here; install it there, or set PYTHONPATH"
        ) from error
