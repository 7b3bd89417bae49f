"""The names of `halfseen.learning`, at the place where other programs look for them."""

from typing import Any

from halfseen import learning


def __getattr__(name: str) -> Any:
    return getattr(learning, name)
