"""What a worker does with a piece: it sees that it is like home, makes the piece, and sends back what came out."""

import os
import pickle
import sys
import warnings
from collections.abc import Callable
from functools import cache, lru_cache
from importlib.metadata import PackageNotFoundError, version
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import UInt8

from halfseen.errors import HalfseenError, WorkerError
from halfseen.progress import Telling, telling
from halfseen.workers.threads import one_thread

PACKAGES = ("halfseen", "jax", "jaxlib", "mujoco", "numpy", "pandas", "scipy")
"""What the numbers depend on."""
SETTINGS = ("XLA_FLAGS", "JAX_", "NPROC")
"""Beginnings of the names of environment variables that they depend on, too."""
HERE = ("JAX_COMPILATION_CACHE", "JAX_PERSISTENT_CACHE")
"""Beginnings of the names of those that only say where this machine keeps what it compiled."""


class Home(NamedTuple):
    """Where pieces come from, as far as what comes out of them depends on it."""

    versions: dict[str, str]
    settings: dict[str, str]


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
    found = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def home() -> Home:
    """Describe this process."""
    return Home(versions(), _settings())


def _settings() -> dict[str, str]:
    told = {name: value for name, value in os.environ.items() if name.startswith(SETTINGS)}
    return {name: value for name, value in told.items() if not name.startswith(HERE)}


def made(asker: Home, function: UInt8[np.ndarray, " bytes"], number: int, piece: Any) -> Outcome:
    """Make a piece, in a worker; errors that a user can mend are sent back as they are."""
    try:
        _be_like(asker)
        return Outcome(number, result_of(_function(function.tobytes()), piece))
    except HalfseenError as error:
        return Outcome(number, None, error)
    except MemoryError:
        return Outcome(number, None, WorkerError("a worker is out of memory; give --workers a smaller number"))


def result_of(function: Callable[[Any], Any], piece: Any) -> Any:
    """Make a piece as every worker does: it tells nothing, and matrices use one thread, as sums depend on that."""
    with telling(Telling.NOTHING), one_thread(), warnings.catch_warnings():
        # Workers share what they compiled: one may find what another is just writing, and compiles it itself.
        warnings.filterwarnings("ignore", message="Error (reading|writing) persistent compilation cache")
        return function(piece)


def _be_like(asker: Home) -> None:
    """Take over the settings that numbers depend on.

    Raises
    ------
    WorkerError
        Other versions are installed here, or the compiler was set otherwise and has begun.
    """
    here = versions()
    other = [name for name, wanted in asker.versions.items() if here.get(name) != wanted]
    if other:
        told = ", ".join(f"{name} {here.get(name, 'missing')} instead of {asker.versions[name]}" for name in other)
        raise WorkerError(
            f"a worker has other versions than the machine that asks: {told}; install the same on all machines"
        )
    flags = "XLA_FLAGS"
    if "jax" in sys.modules and os.environ.get(flags) != asker.settings.get(flags):
        raise WorkerError(
            f"a worker has compiled with {flags}={os.environ.get(flags, '')!r} already, and is asked for "
            f"{asker.settings.get(flags, '')!r}; start the workers anew"
        )
    for name in _settings().keys() - asker.settings.keys():
        del os.environ[name]
    os.environ.update(asker.settings)


@lru_cache(maxsize=1)
def _function(function: bytes) -> Callable[[Any], Any]:
    # It came from the process that asks, and from nowhere else; what it has worked out serves the next piece.
    try:
        return pickle.loads(function)
    except ModuleNotFoundError as error:
        raise WorkerError(
            f"a worker cannot import {error.name}, which is needed here; install it there, or set PYTHONPATH"
        ) from error
