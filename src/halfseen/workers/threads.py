"""The matrices of a piece, and of a learner, are small: a second thread would only wait for the first."""

import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import lru_cache, wraps
from typing import Any, ParamSpec, TypeVar

from threadpoolctl import ThreadpoolController

P = ParamSpec("P")
R = TypeVar("R")


def in_one_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Run a function in `one_thread`: if other programs keep the cores busy, it may take a fiftieth of the time.

    Its sums, which depend on the number of threads, are then the same on every machine.
    """

    @wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        with one_thread():
            return function(*args, **kwargs)

    return limited


def one_thread() -> AbstractContextManager[Any]:
    """Let BLAS, LAPACK and OpenMP use one thread in a ``with`` block; eigenvectors of 100 rows take a third as long."""
    return _threads(len(sys.modules)).limit(limits=1)


@lru_cache(maxsize=1)
def _threads(num_modules: int) -> ThreadpoolController:
    # Listing the loaded libraries takes longer than a small fit; new modules may load more of them.
    return ThreadpoolController()
