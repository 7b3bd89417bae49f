"""Workers of a Dask cluster."""

import warnings
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from importlib import metadata
from typing import Any

from joblib import register_parallel_backend

from halfseen.errors import WorkerError
from halfseen.workers.engine import Engine, without_halfseen
from halfseen.workers.task_backend import Call, Task, TaskBackend, called

NAME = "halfseen-dask"
CONNECT_S = 10
"""How long the scheduler has to answer [s]."""


class DaskTasks(TaskBackend):
    """A task of Dask for every call."""

    def begin(self, call: Call) -> Task:
        """Begin a call."""
        from distributed import get_client

        return get_client().submit(called, call, pure=False)

    def when_over(self, task: Task, tell: Callable[[], None]) -> None:
        """Have something called once a task is over."""
        task.add_done_callback(lambda _: tell())

    def result(self, task: Task) -> Any:
        """Give what came out of a task that is over."""
        return task.result()

    def cancel(self, tasks: Collection[Task]) -> None:
        """Let go of tasks."""
        for task in tasks:
            task.cancel()


@contextmanager
def on_dask(num: int, address: str | None) -> Iterator[Engine]:
    """Give work to the cluster at an address; without one, to a cluster of so many processes on this machine.

    Raises
    ------
    WorkerError
        Nobody answers at the address.
    """
    from distributed import Client, KilledWorker
    from distributed.client import FutureCancelledError
    from distributed.comm.core import CommClosedError

    # One thread a worker: two that execute compiled code at once can wait for one another for ever.
    here: dict[str, Any] = {"n_workers": num, "threads_per_worker": 1, "dashboard_address": None}
    try:
        with warnings.catch_warnings():
            # Other versions are told by whoever gets a piece.
            warnings.simplefilter("ignore")
            client = Client(**here) if address is None else Client(address, timeout=CONNECT_S)
    except (OSError, ValueError) as error:
        raise WorkerError(
            f"--address {address}: no Dask scheduler answers there ({error}); start one with dask scheduler, or mend "
            "the address"
        ) from error
    with client:
        threads: Any = client.nthreads()
        crowded = [name for name, num_threads in threads.items() if num_threads > 1]
        if crowded:
            raise WorkerError(
                f"--address {address}: the Dask worker {crowded[0]} has {threads[crowded[0]]} threads, and compiled "
                "code needs a process of its own; start workers with --nworkers N --nthreads 1"
            )
        try:
            # A piece that cannot be read there would never come back.
            client.run(metadata.version, "halfseen")
        except metadata.PackageNotFoundError as error:
            raise without_halfseen(f"the Dask cluster at {address}") from error
        losses = (KilledWorker, FutureCancelledError, CommClosedError)
        place = "a Dask cluster on this machine" if address is None else f"the Dask cluster at {address}"
        register_parallel_backend(NAME, DaskTasks)
        yield Engine(NAME, max(len(threads), 1), losses, place, is_here=False)
