"""Engines that run workers: loky processes of this machine, and tasks of a Ray or Dask cluster, as joblib backends.

A cluster reassigns the task of a lost worker. The backends of Ray and joblib are unusable: Ray's cannot stream results,
and its pool does not survive the loss of a node; joblib's for Dask waits for ever for a task that Dask has given up.
"""

import os
import socket
import time
import warnings
from abc import abstractmethod
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from importlib import metadata
from threading import Event, Thread
from typing import Any

from joblib import register_parallel_backend
from joblib.externals.loky import process_executor
from joblib.parallel import ParallelBackendBase

import halfseen
from halfseen.errors import WorkerError
from halfseen.workers.pool import Engine

RAY, DASK = "halfseen-ray", "halfseen-dask"
CONNECT_S = 10
"""Time within which a cluster must answer [s]."""
PARENT_S = 0.5
"""Interval between two checks that the parent process is alive [s]."""
MOST_GROWN_BYTES = 2 << 30
"""Growth of a worker's memory after which it is replaced."""


@contextmanager
def processes(num: int) -> Iterator[Engine]:
    """Run `num` worker processes."""
    options = {"initializer": _begin, "initargs": (os.getpid(),)}
    yield Engine("loky", num, (process_executor.BrokenProcessPool,), "this machine", is_here=True, options=options)


def _begin(asker: int) -> None:
    """Start a worker: it exits with its parent process, however that ended, and keeps what it has loaded."""
    Thread(target=_end_with, args=(asker,), daemon=True).start()
    # loky takes what a piece keeps for the next one for a leak, and would restart the worker.
    process_executor._MAX_MEMORY_LEAK_SIZE = MOST_GROWN_BYTES


def _end_with(asker: int) -> None:
    while os.getppid() == asker:
        time.sleep(PARENT_S)
    os._exit(1)


Call = Callable[[], Any]
Task = Any
"""A cluster's handle of a submitted call."""


class TaskBackend(ParallelBackendBase):
    """Submits a task for every call."""

    supports_retrieve_callback = True

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self._begun: set[Task] = set()

    @abstractmethod
    def begin(self, call: Call) -> Task:
        """Submit a call."""

    @abstractmethod
    def when_over(self, task: Task, tell: Callable[[], None]) -> None:
        """Have a function called once a task is over, whether it succeeded or failed."""

    @abstractmethod
    def cancel(self, tasks: Collection[Task]) -> None:
        """Cancel tasks."""

    def effective_n_jobs(self, n_jobs: int) -> int:
        """Return the number asked for."""
        return n_jobs

    def configure(self, n_jobs: int = 1, parallel: Any = None, **_: Any) -> int:
        """Prepare the backend."""
        self.parallel = parallel
        return n_jobs

    def submit(self, func: Call, callback: Callable[[Task], None] | None = None) -> Task:
        """Submit a call, and have `callback` called with its task once it is over."""
        task = self.begin(func)
        self._begun.add(task)

        def over() -> None:
            self._begun.discard(task)
            if callback is not None:
                callback(task)

        self.when_over(task, over)
        return task

    @abstractmethod
    def retrieve_result_callback(self, out: Task) -> Any:
        """Return the result of a finished task, or raise its error."""

    def abort_everything(self, ensure_ready: bool = True) -> None:
        """Cancel all unfinished tasks."""
        self.cancel(list(self._begun))
        self._begun.clear()


def called(call: Call) -> Any:
    """Make the call, in a worker."""
    return call()


def without_halfseen(place: str) -> WorkerError:
    """Return the error for a cluster that cannot unpickle a piece."""
    return WorkerError(f"{place} has workers without halfseen; install halfseen {halfseen.__version__} there")


class RayTasks(TaskBackend):
    """Submits a Ray task for every call."""

    def begin(self, call: Call) -> Task:
        """Submit a call."""
        import ray

        return ray.remote(num_cpus=1)(called).remote(call)

    def when_over(self, task: Task, tell: Callable[[], None]) -> None:
        """Have a function called once a task is over."""
        task.future().add_done_callback(lambda _: tell())

    def retrieve_result_callback(self, out: Task) -> Any:
        """Return the result of a finished task."""
        import ray

        return ray.get(out)

    def cancel(self, tasks: Collection[Task]) -> None:
        """Cancel tasks."""
        import ray

        for task in tasks:
            ray.cancel(task, force=True)


@contextmanager
def on_ray(num: int, address: str | None) -> Iterator[Engine]:
    """Use the cluster at an address; without one, start a cluster of `num` processes on this machine.

    Raises
    ------
    WorkerError
        Nothing answers at the address.
    """
    # No usage statistics are sent.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    import ray
    from ray.exceptions import NodeDiedError, OutOfMemoryError, RaySystemError, WorkerCrashedError

    quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
    if address is not None:
        _refuse_silent(address)
    try:
        with warnings.catch_warnings():
            # Ray forks to start its own programs at once, before a compiler thread can interfere.
            warnings.filterwarnings("ignore", "os.fork", RuntimeWarning)
            if address is None:
                ray.init(num_cpus=num, include_dashboard=False, **quiet)
            else:
                ray.init(address=address, **quiet)
    except (ConnectionError, RuntimeError, ValueError) as error:
        raise _nobody_at(address, _first_line(error)) from error
    try:
        register_parallel_backend(RAY, RayTasks)
        try:
            ray.get(ray.remote(metadata.version).remote("halfseen"))
        except metadata.PackageNotFoundError as error:
            raise without_halfseen(f"the Ray cluster at {address}") from error
        losses = (WorkerCrashedError, NodeDiedError, OutOfMemoryError, RaySystemError)
        place = "a Ray cluster on this machine" if address is None else f"the Ray cluster at {address}"
        num_workers = int(ray.cluster_resources().get("CPU", 1))
        yield Engine(RAY, num_workers, losses, place, is_here=False)
    finally:
        ray.shutdown()


def _refuse_silent(address: str) -> None:
    """Refuse an address with no open port: Ray itself would try for minutes."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not (host and port.isdecimal()):
        return  # auto, and addresses that Ray itself refuses
    try:
        socket.create_connection((host, int(port)), CONNECT_S).close()
    except (OSError, OverflowError) as error:
        raise _nobody_at(address, str(error)) from error


def _nobody_at(address: str | None, why: str) -> WorkerError:
    return WorkerError(
        f"--address {address}: no Ray cluster answers there ({why}); start one with ray start --head, or fix "
        "the address"
    )


def _first_line(error: BaseException) -> str:
    return str(error).strip().partition("\n")[0].rstrip(".")


LOOK_S = 1.0
"""Interval between two checks for workers [s]."""
EMPTY_S = 20.0
"""How long there may be no workers before submitted tasks count as lost [s]: Dask itself would wait for ever.

This is longer than a local cluster takes to drop a worker that closed itself."""


class DaskTasks(TaskBackend):
    """Submits a Dask task for every call."""

    def begin(self, call: Call) -> Task:
        """Submit a call."""
        from distributed import get_client

        return get_client().submit(called, call, pure=False)

    def when_over(self, task: Task, tell: Callable[[], None]) -> None:
        """Have a function called once a task is over."""
        task.add_done_callback(lambda _: tell())

    def retrieve_result_callback(self, out: Task) -> Any:
        """Return the result of a finished task, and release it: Dask would compute it again if it were lost."""
        try:
            return out.result()
        finally:
            out.release()

    def cancel(self, tasks: Collection[Task]) -> None:
        """Cancel tasks."""
        for task in tasks:
            task.cancel()


@contextmanager
def on_dask(num: int, address: str | None) -> Iterator[Engine]:
    """Use the cluster at an address; without one, start a cluster of `num` processes on this machine.

    Raises
    ------
    WorkerError
        Nothing answers at the address.
    """
    from distributed import Client, KilledWorker
    from distributed.client import FutureCancelledError
    from distributed.comm.core import CommClosedError

    # One thread per worker: two threads that execute compiled code can deadlock.
    here: dict[str, Any] = {"n_workers": num, "threads_per_worker": 1, "dashboard_address": None}
    try:
        with warnings.catch_warnings():
            # The worker that gets the piece reports other versions.
            warnings.simplefilter("ignore")
            client = Client(**here) if address is None else Client(address, timeout=CONNECT_S)
    except (OSError, ValueError) as error:
        raise WorkerError(
            f"--address {address}: no Dask scheduler answers there ({error}); start one with dask scheduler, or "
            "fix the address"
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
            # A piece that cannot be unpickled there would never return.
            client.run(metadata.version, "halfseen")
        except metadata.PackageNotFoundError as error:
            raise without_halfseen(f"the Dask cluster at {address}") from error
        losses = (KilledWorker, FutureCancelledError, CommClosedError)
        place = "a Dask cluster on this machine" if address is None else f"the Dask cluster at {address}"
        register_parallel_backend(DASK, DaskTasks)
        with _watched(client, num if address is None else None):
            yield Engine(DASK, max(len(threads), 1), losses, place, is_here=False)


@contextmanager
def _watched(client: Any, num_here: int | None) -> Iterator[None]:
    """Cancel the tasks of a cluster without workers, so that their loss is noticed; restart local workers.

    A worker that closes itself because its task was taken from it closes its nanny, too, and is not replaced.
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
