"""The matrices of a learner are small: a second thread would only wait for the first."""

from contextlib import AbstractContextManager
from functools import cache
from typing import Any

from threadpoolctl import ThreadpoolController


def one_thread() -> AbstractContextManager[Any]:
    """Let BLAS, LAPACK and OpenMP use one thread in a ``with`` block; eigenvectors of 100 rows take a third as long."""
    return _threads().limit(limits=1)


@cache
def _threads() -> ThreadpoolController:
    # It lists the libraries that are loaded, which takes longer than a small fit.
    return ThreadpoolController()
