"""What a loss of power may take from a recording, and what it costs to have it take less.

What was handed to the operating system outlives the process, not the machine: it lies in memory until the disk has it,
up to half a minute. `os.fsync` waits for the disk.
"""

import os
import sys
from collections.abc import Container
from contextlib import suppress
from pathlib import Path

from halfseen.errors import ArgumentError

FSYNC: dict[str, Container[str]] = {
    "never": (),
    "trajectory": ("finished", "cut"),
    "stage": ("stage", "finished", "cut"),
    "event": ("stage", "done", "running", "out", "finished", "cut"),
}
"""After which events the disk is waited for; whatever came before them is then on it, too."""


def synced_events(fsync: bool | str) -> Container[str]:
    """The events after which the disk is waited for; True stands for all of them, False for none.

    Raises
    ------
    ArgumentError
        It is none of those that there are.
    """
    name = ("never", "event")[fsync] if isinstance(fsync, bool) else fsync
    if name not in FSYNC:
        raise ArgumentError(f"fsync is {fsync!r}; give one of {', '.join(map(repr, FSYNC))}")
    return FSYNC[name]


def sync(descriptor: int) -> None:
    """Wait until the disk has a file or folder.

    Raises
    ------
    OSError
        It cannot take it.
    """
    if sys.platform == "darwin":
        import fcntl

        with suppress(OSError):  # What fsync does elsewhere; not all file systems know it.
            fcntl.fcntl(descriptor, fcntl.F_FULLFSYNC)
            return
    os.fsync(descriptor)


def unsynced_folders(folder: Path) -> list[Path]:
    """A folder and those above it that need to be on the disk for it to be found, as far as they are made with it."""
    above = folder.absolute().parents
    num_missing = next(number for number, each in enumerate(above) if each.exists())
    return [folder, *above[: num_missing + 1]]


def sync_folder(folder: Path) -> None:
    """Wait until the disk has the names that are in a folder; one that may not be read is left alone."""
    with suppress(PermissionError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            sync(descriptor)
        finally:
            os.close(descriptor)
