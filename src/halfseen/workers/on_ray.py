"""Workers of a Ray cluster."""

import os
import socket
import warnings
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from importlib import metadata
from typing import Any

from joblib import register_parallel_backend

from halfseen.errors import WorkerError
from halfseen.workers.engine import Engine, without_halfseen
from halfseen.workers.task_backend import Call, Task, TaskBackend, called

NAME = "halfseen-ray"
CONNECT_S = 10
"""How long the cluster has to answer [s]."""


class RayTasks(TaskBackend):
    """A task of Ray for every call."""

    def begin(self, call: Call) -> Task:
        """Begin a call."""
        import ray

        return ray.remote(num_cpus=1)(called).remote(call)

    def when_over(self, task: Task, tell: Callable[[], None]) -> None:
        """Have something called once a task is over."""
        task.future().add_done_callback(lambda _: tell())

    def result(self, task: Task) -> Any:
        """Give what came out of a task that is over."""
        import ray

        return ray.get(task)

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
        register_parallel_backend(NAME, RayTasks)
        try:
            ray.get(ray.remote(metadata.version).remote("halfseen"))
        except metadata.PackageNotFoundError as error:
            raise without_halfseen(f"the Ray cluster at {address}") from error
        losses = (WorkerCrashedError, NodeDiedError, OutOfMemoryError, RaySystemError)
        place = "a Ray cluster on this machine" if address is None else f"the Ray cluster at {address}"
        num_workers = int(ray.cluster_resources().get("CPU", 1))
        yield Engine(NAME, num_workers, losses, place, is_here=False)
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
