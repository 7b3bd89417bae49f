"""A backend of joblib whose calls are tasks of a cluster, which gives them to another worker where one is lost.

The backends that Ray and joblib bring cannot be used: Ray's cannot stream what comes out, and its pool does not outlive
the loss of a node; joblib's for Dask waits for ever for a task that Dask has given up.
"""

from abc import abstractmethod
from collections.abc import Callable, Collection
from typing import Any

from joblib.parallel import ParallelBackendBase

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
    def result(self, task: Task) -> Any:
        """Give what came out of a task that is over, or raise what went wrong."""

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

    def retrieve_result_callback(self, out: Task) -> Any:
        """Give what came out."""
        return self.result(out)

    def abort_everything(self, ensure_ready: bool = True) -> None:
        """Let go of what is not over."""
        self.cancel(list(self._begun))
        self._begun.clear()


def called(call: Call) -> Any:
    """Call it, in a worker."""
    return call()
