"""A folder that is there whole or not at all."""

import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from halfseen.errors import ArgumentError


@contextmanager
def placed(target: Path) -> Iterator[Path]:
    """Give an empty folder to write into, and put it at `target` by renaming once all went well.

    Parameters
    ----------
    target
        Where the folder goes; nothing may be there yet, missing parents are made.

    Raises
    ------
    ArgumentError
        Something is there already, or the folder cannot be written.
    """
    fresh = target.absolute().with_name(f".{target.name}.{uuid.uuid4().hex}.new")
    try:
        if target.exists() or target.is_symlink():
            raise ArgumentError(f"{target}: it is there already; choose another folder, or move it away first")
        fresh.mkdir(parents=True)
        yield fresh
        fresh.rename(target)
    except OSError as error:
        raise ArgumentError(
            f"{target}: cannot be written ({error.strerror or error}); choose another folder"
        ) from error
    finally:
        shutil.rmtree(fresh, ignore_errors=True)
