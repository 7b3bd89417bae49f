"""Workers of a Dask cluster."""

import warnings
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from importlib import metadata
from threading import Event, Thread
from typing import Any

from joblib import register_parallel_backend

from halfseen.errors import WorkerError
from halfseen.workers.engine import Engine, without_halfseen
from halfseen.workers.task_backend import Call, Task, TaskBackend, called

NAME = "halfseen-dask"
CONNECT_S = 10
"""How long the scheduler has to answer [s]."""
LOOK_S = 1.0
"""Between two looks whether there are workers [s]."""
EMPTY_S = 20.0
"""How long there may be none before what was begun counts as lost [s]: Dask itself would wait for ever.

Longer than it takes a cluster of this machine to let go of a worker that closed itself."""


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
        """Give what came out of a task that is over, and have no worker keep it: Dask would make it again if lost."""
        try:
            return task.result()
        finally:
            task.release()

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
            # Other versions are reported by the worker that gets it.
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
        with _watched(client, num if address is None else None):
            yield Engine(NAME, max(len(threads), 1), losses, place, is_here=False)


@contextmanager
def _watched(client: Any, num_here: int | None) -> Iterator[None]:
    """Cancel what a cluster without workers has begun, so that its loss is known; bring back workers of this machine.

    A worker that closes itself because what it did was taken from it closes its nanny, too, and none comes after it.
    """
    from distributed import Future

    is_over = Event()

    def watch() -> None:
        num_empty = 0
        while not is_over.wait(LOOK_S):
            num_empty = 0 if client.nthreads() else num_empty + 1
            if num_empty * LOOK_S >= EMPTY_S:
                num_empty = 0
                if num_here is not None:
                    client.cluster.scale(num_here)
                client.cancel([Future(key, client=client) for key in list(client.futures)])

    watcher = Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield
    finally:
        is_over.set()
        watcher.join()
