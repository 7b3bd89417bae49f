"""One BLAS thread for small systems: there a second gains little, and on a busy machine each waits for the other."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

from threadpoolctl import ThreadpoolController

SMALL = 2000
"""Rows up to which one thread serves."""


@contextmanager
def fitting_threads(num_rows: int) -> Iterator[None]:
    """Limit BLAS to one thread while a problem of few rows is solved."""
    if num_rows > SMALL:
        yield
        return
    with _controller().limit(limits=1):
        yield


@cache
def _controller() -> ThreadpoolController:
    return ThreadpoolController()
