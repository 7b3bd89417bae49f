"""A pool sends pieces to workers and streams the results back; pieces of lost workers are made again.

A worker checks that its versions are those of the main process, makes the piece, and returns the result.
"""

import pickle
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache, lru_cache
from importlib.metadata import PackageNotFoundError, version
from types import MappingProxyType
from typing import Any, NamedTuple, TypeVar

import numpy as np

import halfseen
from halfseen.errors import HalfseenError, WorkerError
from halfseen.progress import Verbosity, verbosity
from halfseen.shapes import UInt8
from halfseen.workers.threads import one_thread

Piece = TypeVar("Piece")
Result = TypeVar("Result")

MOST_LOST = 10
"""Losses of workers in a row, without a finished piece, after which the pool gives up."""


WORTH_S = 20.0
"""Workers are started if the remaining pieces would take one process longer than this [s]."""

_STREAMED: dict[str, Any] = {"batch_size": 1, "pre_dispatch": "2*n_jobs"}
"""Only enough pieces are in flight to keep all workers busy: this bounds memory, and little is lost with a worker."""


class Engine(NamedTuple):
    """A joblib backend that is ready for work."""

    backend: str
    """Its name in joblib."""
    num_workers: int
    """Number of pieces that are made at once."""
    losses: tuple[type[BaseException], ...]
    """Exceptions that it raises when a worker was lost and the engine itself has given up."""
    place: str
    """Its name in messages."""
    is_here: bool
    """Whether its workers are processes of this machine, with access to its folders."""
    options: Mapping[str, Any] = MappingProxyType({})
    """Further options of the joblib backend."""


PACKAGES = ("mujoco", "numpy", "pandas", "scipy")
"""The packages that the results depend on, beside halfseen."""


class PieceResult(NamedTuple):
    """The outcome of a piece."""

    number: int
    result: Any
    error: HalfseenError | None = None


@cache
def versions() -> Mapping[str, str]:
    """Versions of the installed packages, by name."""
    found = {"halfseen": halfseen.__version__}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def made(wanted: Mapping[str, str], function: UInt8[np.ndarray, " bytes"], number: int, piece: Any) -> PieceResult:
    """Make a piece, in a worker; errors that a user can fix are returned unchanged."""
    try:
        _check_versions(wanted)
        return PieceResult(number, result_of(_function(function.tobytes()), piece))
    except HalfseenError as error:
        return PieceResult(number, None, error)
    except MemoryError:
        return PieceResult(number, None, WorkerError("a worker ran out of memory; give --workers a smaller number"))


def result_of(function: Callable[[Any], Any], piece: Any) -> Any:
    """Make a piece as a worker does: no progress output, and one thread, as the number of threads changes sums."""
    with verbosity(Verbosity.NOTHING), one_thread():
        return function(piece)


def _check_versions(wanted: Mapping[str, str]) -> None:
    """Refuse to work with versions other than those of the main process.

    Raises
    ------
    WorkerError
        Other versions are installed here.
    """
    here = versions()
    other = {name: version for name, version in wanted.items() if here.get(name) != version}
    if other:
        others = ", ".join(
            f"{name} {here.get(name, 'missing')} instead of {version}" for name, version in other.items()
        )
        raise WorkerError(f"a worker has other versions than this machine: {others}; install the same on all machines")


@lru_cache(maxsize=1)
def _function(function: bytes) -> Callable[[Any], Any]:
    # The pickle comes from the main process and nowhere else; its caches serve the next piece.
    try:
        return pickle.loads(function)
    except ModuleNotFoundError as error:
        raise WorkerError(
            f"a worker cannot import {error.name}, which is needed here; install it there, or set PYTHONPATH"
        ) from error


class Pool:
    """A pool of workers that are ready.

    Parameters
    ----------
    engine
        The engine that runs them; None for this process alone.
    begin
        Starts an engine once the remaining work is worth it; None to stay with this process alone.
    """

    def __init__(self, engine: Engine | None, begin: Callable[[], Engine] | None = None) -> None:
        self._engine, self._begin = engine, begin

    @property
    def num_workers(self) -> int:
        """Number of pieces that are made at once."""
        return 1 if self._engine is None else self._engine.num_workers

    @property
    def is_here(self) -> bool:
        """Whether all workers are processes of this machine, with access to its folders."""
        return self._engine is None or self._engine.is_here

    def each(self, function: Callable[[Piece], Result], pieces: Iterable[Piece]) -> Iterator[tuple[int, Result]]:
        """Make pieces, and yield each result as soon as it is ready.

        Parameters
        ----------
        function
            Makes one piece; the function and the pieces can be pickled.
        pieces
            The pieces to make.

        Yields
        ------
        tuple of int and Result
            Index of the piece, from 0, and its result.

        Raises
        ------
        HalfseenError
            The function raised it.
        WorkerError
            Workers are lost repeatedly, or have other versions.
        """
        left = dict(enumerate(pieces))
        while left and self._engine is None:
            yield self._made_here(function, left)
        if left and self._engine is not None:
            yield from self._made_there(self._engine, function, left)

    def _made_here(self, function: Callable[[Piece], Result], left: dict[int, Piece]) -> tuple[int, Result]:
        """Make the next piece in this process."""
        begun = time.monotonic()
        number = next(iter(left))
        result = result_of(function, left.pop(number))
        if self._begin is not None and (time.monotonic() - begun) * len(left) > WORTH_S:
            self._engine = self._begin()
        return number, result

    def _made_there(
        self, engine: Engine, function: Callable[[Piece], Result], left: dict[int, Piece]
    ) -> Iterator[tuple[int, Result]]:
        """Have workers make the remaining pieces."""
        # This import is slow, and a process alone does not need it.
        import cloudpickle

        num_lost, lost = 0, None
        # As an array, so that joblib passes a large one to local processes by shared memory, not through their pipes.
        packed = np.frombuffer(cloudpickle.dumps(function), dtype=np.uint8)
        while left:
            try:
                for number, result in _round(engine, packed, left):
                    del left[number]
                    num_lost = 0
                    yield number, result
            except engine.losses as error:
                num_lost, lost = num_lost + 1, error
            if num_lost == MOST_LOST:
                raise WorkerError(
                    f"workers of {engine.place} were lost {MOST_LOST} times in a row ({type(lost).__name__}), "
                    f"with {len(left)} pieces left; the usual cause is a lack of memory: give --workers a "
                    "smaller number, and continue from what is done"
                ) from lost

    def in_order(self, function: Callable[[Piece], Result], pieces: Iterable[Piece]) -> Iterator[Result]:
        """Make pieces, and yield the results in order."""
        waiting: dict[int, Result] = {}
        following = 0
        for number, result in self.each(function, pieces):
            waiting[number] = result
            while following in waiting:
                yield waiting.pop(following)
                following += 1


def _round(engine: Engine, function: UInt8[np.ndarray, " bytes"], left: Mapping[int, Any]) -> Iterator[tuple[int, Any]]:
    """Make the remaining pieces, until all are made or a worker is lost."""
    from joblib import Parallel, delayed, parallel_config

    # With one job joblib would make the pieces in this process, which a piece could then kill.
    with parallel_config(engine.backend, n_jobs=max(engine.num_workers, 2), **engine.options):
        parallel: Any = Parallel(return_as="generator_unordered", **_STREAMED)
    wanted = versions()
    outcomes = parallel(delayed(made)(wanted, function, number, piece) for number, piece in list(left.items()))
    try:
        for number, result, error in outcomes:
            if error is not None:
                raise error
            yield number, result
    finally:
        with warnings.catch_warnings():
            # Cancellation by an error, or by a consumer that stops early, is no cause for a warning.
            warnings.simplefilter("ignore", UserWarning)
            outcomes.close()
