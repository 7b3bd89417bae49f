"""Libraries that only some users need."""

from importlib import import_module
from types import ModuleType

from halfseen.errors import ArgumentError
from halfseen.installation import command_for


def extra(module: str, name: str) -> ModuleType:
    """Import a module of an optional library.

    Parameters
    ----------
    module
        What to import.
    name
        Halfseen's extra that brings it.

    Raises
    ------
    ArgumentError
        It is not installed.
    """
    try:
        return import_module(module)
    except ImportError as error:
        raise ArgumentError(f"{module} cannot be imported ({error}); run: {command_for(name)}") from error
