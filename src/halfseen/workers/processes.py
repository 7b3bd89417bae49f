"""Processes of this machine, by loky."""

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Thread

from joblib.externals.loky import process_executor

from halfseen.workers.engine import Engine

LOOK_S = 0.5
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
        time.sleep(LOOK_S)
    os._exit(1)
