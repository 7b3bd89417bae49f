"""What an engine is, to those who give it work."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import halfseen
from halfseen.errors import WorkerError


class Engine(NamedTuple):
    """A backend of joblib that is ready for work."""

    backend: str
    """Name by which joblib knows it."""
    num_workers: int
    """Pieces that are made at once."""
    losses: tuple[type[BaseException], ...]
    """What it raises when a worker was lost and the engine itself has given up."""
    place: str
    """What it is called in messages."""
    is_here: bool
    """Whether its workers are processes of this machine, with its folders."""
    options: Mapping[str, Any] = MappingProxyType({})
    """What else joblib tells the backend."""


def without_halfseen(place: str) -> WorkerError:
    """What is said of a cluster that cannot read a piece."""
    return WorkerError(f"{place} has workers without halfseen; install halfseen {halfseen.__version__} there")
