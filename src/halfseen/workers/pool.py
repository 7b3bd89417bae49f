"""Pieces go to workers, and what comes out of them streams back; what a lost worker had is made again.

A worker sees that it is like the machine that asks, makes the piece, and sends back what came out.
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
from halfseen.progress import Telling, telling
from halfseen.shapes import UInt8
from halfseen.workers.threads import one_thread

Piece = TypeVar("Piece")
Result = TypeVar("Result")

MOST_LOST = 10
"""Times that workers are lost one after another, while no piece gets done, before it is given up."""


WORTH_S = 20.0
"""Workers are worth beginning where all that is left would take one process longer [s]."""

_STREAMED: dict[str, Any] = {"batch_size": 1, "pre_dispatch": "2*n_jobs"}
"""No more pieces are under way than keep all workers busy: memory is bounded, and little is lost with a worker."""


class Engine(NamedTuple):
    """A backend of joblib that is ready for work."""

    backend: str
    """Name by which joblib knows it."""
    num_workers: int
    """Pieces that are made at once."""
    losses: tuple[type[BaseException], ...]
    """What it raises when a worker was lost and the engine itself has given up."""
    place: str
    """What it is called in messages."""
    is_here: bool
    """Whether its workers are processes of this machine, with its folders."""
    options: Mapping[str, Any] = MappingProxyType({})
    """What else joblib tells the backend."""


PACKAGES = ("mujoco", "numpy", "pandas", "scipy")
"""What the numbers depend on, beside halfseen."""


class Outcome(NamedTuple):
    """What came out of a piece."""

    number: int
    result: Any
    error: HalfseenError | None = None


@cache
def versions() -> Mapping[str, str]:
    """Versions of the packages that are installed here, by name."""
    found = {"halfseen": halfseen.__version__}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def made(wanted: Mapping[str, str], function: UInt8[np.ndarray, " bytes"], number: int, piece: Any) -> Outcome:
    """Make a piece, in a worker; errors that a user can mend are sent back as they are."""
    try:
        _check_versions(wanted)
        return Outcome(number, result_of(_function(function.tobytes()), piece))
    except HalfseenError as error:
        return Outcome(number, None, error)
    except MemoryError:
        return Outcome(number, None, WorkerError("a worker is out of memory; give --workers a smaller number"))


def result_of(function: Callable[[Any], Any], piece: Any) -> Any:
    """Make a piece as every worker does: it tells nothing, and matrices use one thread, as sums depend on that."""
    with telling(Telling.NOTHING), one_thread():
        return function(piece)


def _check_versions(wanted: Mapping[str, str]) -> None:
    """Refuse to work with other versions than those of the process that asks.

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


class Pool:
    """Workers that are ready.

    Parameters
    ----------
    engine
        What runs them; None for this process alone.
    begin
        Begins an engine for a process that is alone, once what is left is worth it; None to leave it alone.
    """

    def __init__(self, engine: Engine | None, begin: Callable[[], Engine] | None = None) -> None:
        self._engine, self._begin = engine, begin

    @property
    def num_workers(self) -> int:
        """Pieces that are made at once."""
        return 1 if self._engine is None else self._engine.num_workers

    @property
    def is_here(self) -> bool:
        """Whether all workers are processes of this machine, with its folders."""
        return self._engine is None or self._engine.is_here

    def each(self, function: Callable[[Piece], Result], pieces: Iterable[Piece]) -> Iterator[tuple[int, Result]]:
        """Make pieces, and give each as soon as it is over.

        Parameters
        ----------
        function
            Makes one; it and the pieces can be pickled.
        pieces
            What there is to make.

        Yields
        ------
        tuple of int and Result
            Number of the piece, from 0 on, and what came out.

        Raises
        ------
        HalfseenError
            What the function raised.
        WorkerError
            Workers are lost again and again, or have other versions.
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
        """Have workers make what is left."""
        # It loads what a process that is alone need not wait for.
        import cloudpickle

        num_lost, lost = 0, None
        # As an array, so that joblib hands processes of this machine a large one by its memory, and not by their pipes.
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
                    f"workers of {engine.place} were lost {MOST_LOST} times, one after another "
                    f"({type(lost).__name__}), with {len(left)} pieces left; most often they were killed for want of "
                    "memory: give --workers a smaller number, and go on with what is done"
                ) from lost

    def in_order(self, function: Callable[[Piece], Result], pieces: Iterable[Piece]) -> Iterator[Result]:
        """Make pieces, and give what came out in their order."""
        waiting: dict[int, Result] = {}
        following = 0
        for number, result in self.each(function, pieces):
            waiting[number] = result
            while following in waiting:
                yield waiting.pop(following)
                following += 1


def _round(engine: Engine, function: UInt8[np.ndarray, " bytes"], left: Mapping[int, Any]) -> Iterator[tuple[int, Any]]:
    """Make what is left, until all is made or a worker is lost."""
    from joblib import Parallel, delayed, parallel_config

    # With one job joblib would make the pieces in this process, which a piece then could end.
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
            # What an error or a reader who has seen enough cancels is nothing to be warned of.
            warnings.simplefilter("ignore", UserWarning)
            outcomes.close()
