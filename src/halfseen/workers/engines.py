"""What may run workers: processes of this machine, by loky; and tasks of a Ray or Dask cluster, as backends of joblib.

A cluster gives a task to another worker where one is lost. The backends that Ray and joblib bring cannot be used: Ray's
cannot stream what comes out, and its pool does not outlive the loss of a node; joblib's for Dask waits for ever for a
task that Dask has given up.
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
"""How long a cluster has to answer [s]."""
PARENT_S = 0.5
"""Between two looks whether anyone who asked still lives [s]."""
MOST_GROWN_BYTES = 2 << 30
"""By how much a worker may grow before it is replaced by a new one."""


@contextmanager
def processes(num: int) -> Iterator[Engine]:
    """Give so many processes work."""
    options = {"initializer": _begin, "initargs": (os.getpid(),)}
    yield Engine("loky", num, (process_executor.BrokenProcessPool,), "this machine", is_here=True, options=options)


def _begin(asker: int) -> None:
    """Begin as a worker: it ends with the process that asks, however that ended, and keeps what it has loaded."""
    Thread(target=_end_with, args=(asker,), daemon=True).start()
    # loky takes what a piece keeps for the next one for a leak, and would begin again.
    process_executor._MAX_MEMORY_LEAK_SIZE = MOST_GROWN_BYTES


def _end_with(asker: int) -> None:
    while os.getppid() == asker:
        time.sleep(PARENT_S)
    os._exit(1)


Call = Callable[[], Any]
Task = Any
"""What a cluster calls a call that it has begun."""


class TaskBackend(ParallelBackendBase):
    """Begins a task for every call."""

    supports_retrieve_callback = True

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self._begun: set[Task] = set()

    @abstractmethod
    def begin(self, call: Call) -> Task:
        """Begin a call."""

    @abstractmethod
    def when_over(self, task: Task, tell: Callable[[], None]) -> None:
        """Have something called once a task is over, well or not."""

    @abstractmethod
    def cancel(self, tasks: Collection[Task]) -> None:
        """Let go of tasks."""

    def effective_n_jobs(self, n_jobs: int) -> int:
        """As many as are asked for."""
        return n_jobs

    def configure(self, n_jobs: int = 1, parallel: Any = None, **_: Any) -> int:
        """Get ready."""
        self.parallel = parallel
        return n_jobs

    def submit(self, func: Call, callback: Callable[[Task], None] | None = None) -> Task:
        """Begin a call, and have `callback` called with its task once it is over."""
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
        """Give what came out of a task that is over, or raise what went wrong."""

    def abort_everything(self, ensure_ready: bool = True) -> None:
        """Let go of what is not over."""
        self.cancel(list(self._begun))
        self._begun.clear()


def called(call: Call) -> Any:
    """Call it, in a worker."""
    return call()


def without_halfseen(place: str) -> WorkerError:
    """What is said of a cluster that cannot read a piece."""
    return WorkerError(f"{place} has workers without halfseen; install halfseen {halfseen.__version__} there")


class RayTasks(TaskBackend):
    """A task of Ray for every call."""

    def begin(self, call: Call) -> Task:
        """Begin a call."""
        import ray

        return ray.remote(num_cpus=1)(called).remote(call)

    def when_over(self, task: Task, tell: Callable[[], None]) -> None:
        """Have something called once a task is over."""
        task.future().add_done_callback(lambda _: tell())

    def retrieve_result_callback(self, out: Task) -> Any:
        """Give what came out of a task that is over."""
        import ray

        return ray.get(out)

    def cancel(self, tasks: Collection[Task]) -> None:
        """Let go of tasks."""
        import ray

        for task in tasks:
            ray.cancel(task, force=True)


@contextmanager
def on_ray(num: int, address: str | None) -> Iterator[Engine]:
    """Give work to the cluster at an address; without one, to a cluster of so many processes on this machine.

    Raises
    ------
    WorkerError
        Nobody answers at the address.
    """
    # Nothing is reported to anyone.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    import ray
    from ray.exceptions import NodeDiedError, OutOfMemoryError, RaySystemError, WorkerCrashedError

    quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
    if address is not None:
        _refuse_silent(address)
    try:
        with warnings.catch_warnings():
            # Ray forks to begin programs of its own at once, which no thread of a compiler has time to hinder.
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
    """Refuse an address at which no port is open: Ray itself would try for minutes."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not (host and port.isdecimal()):
        return  # auto, and what Ray itself refuses
    try:
        socket.create_connection((host, int(port)), CONNECT_S).close()
    except (OSError, OverflowError) as error:
        raise _nobody_at(address, str(error)) from error


def _nobody_at(address: str | None, why: str) -> WorkerError:
    return WorkerError(
        f"--address {address}: no Ray cluster answers there ({why}); start one with ray start --head, or mend the "
        "address"
    )


def _first_line(error: BaseException) -> str:
    return str(error).strip().partition("\n")[0].rstrip(".")


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

    def retrieve_result_callback(self, out: Task) -> Any:
        """Give what came out of a task that is over, and have no worker keep it: Dask would make it again if lost."""
        try:
            return out.result()
        finally:
            out.release()

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
        register_parallel_backend(DASK, DaskTasks)
        with _watched(client, num if address is None else None):
            yield Engine(DASK, max(len(threads), 1), losses, place, is_here=False)


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
