"""The choice of workers."""

import os
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass

from halfseen.errors import ArgumentError
from halfseen.workers import ENGINES
from halfseen.workers.pool import Engine, Pool


def num_cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@dataclass(frozen=True)
class Workers:
    """Workers, as chosen by the user; the choice does not affect the results.

    Parameters
    ----------
    num
        Number of processes on this machine; None for one per core. A cluster with an address has its own number.
    engine
        One of `halfseen.workers.ENGINES`.
    address
        Address of a Ray or Dask cluster; None for a cluster on this machine that lasts as long as the work.

    Raises
    ------
    ArgumentError
        There is no such engine, the number is not a whole number of at least 1, or it does not go with the address.
    """

    num: int | None = None
    engine: str = "processes"
    address: str | None = None

    def __post_init__(self) -> None:
        if self.engine not in ENGINES:
            raise ArgumentError(f"--engine {self.engine}: choose among {', '.join(ENGINES)}")
        if self.address is not None and self.engine == "processes":
            raise ArgumentError(
                f"--address {self.address}: processes of this machine have no address; name an --engine"
            )
        if self.address is not None and self.num is not None:
            raise ArgumentError(
                f"--workers {self.num}: the cluster at {self.address} sets its own number; leave --workers out"
            )
        if self.num is not None and not (isinstance(self.num, int) and self.num >= 1):
            raise ArgumentError(f"--workers {self.num}: give a whole number, at least 1")

    @contextmanager
    def ready(self) -> Iterator[Pool]:
        """Keep them ready within a ``with`` block.

        Raises
        ------
        WorkerError
            Nothing answers at the address.
        """
        if self.engine == "processes" and self._num == 1:
            yield Pool(None)
            return
        with self._engine() as engine:
            yield Pool(engine)

    @contextmanager
    def ready_if_worth(self) -> Iterator[Pool]:
        """Keep them ready where there may be little to do: unless chosen by the user, they start once it is worth it.

        Raises
        ------
        WorkerError
            Nothing answers at the address.
        """
        if self.num is not None or self.engine != "processes" or self._num == 1:
            with self.ready() as pool:
                yield pool
            return
        with ExitStack() as stack:
            yield Pool(None, lambda: stack.enter_context(self._engine()))

    @property
    def _num(self) -> int:
        return self.num or num_cores()

    def _engine(self) -> AbstractContextManager[Engine]:
        from halfseen.workers import engines

        if self.engine == "processes":
            return engines.processes(self._num)
        begin = engines.on_ray if self.engine == "ray" else engines.on_dask
        return begin(self._num, self.address)


def checked_workers(workers: object) -> Workers:
    """Return the workers; refuse any other type."""
    if not isinstance(workers, Workers):
        raise ArgumentError(f"workers is {workers!r}; give Workers of halfseen.workers, such as Workers(4)")
    return workers


ALONE = Workers(1)
"""This process makes all pieces itself."""
