"""The names of `halfseen.learning`, where other programs look for them."""

from halfseen.learning import __all__

__all__ = [*__all__]
