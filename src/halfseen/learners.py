"""The names of `halfseen.learning`, where other programs look for them."""

from halfseen.learning import __all__, __getattr__  # noqa: F401 - it answers for every name

__all__ = [*__all__]
