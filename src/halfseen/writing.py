"""Atomic writes of files and folders, by writing under a temporary name and renaming; and locks.

The kernel releases a lock when its process ends, however it ends. On Windows a lock keeps others from reading the
locked bytes, and is never shared: there the lock is on a byte far behind the end of the file, and a shared lock is
exclusive.
"""

import os
import re
import shutil
import sys
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from errno import EEXIST, ENAMETOOLONG, ENOSPC, ENOTDIR, ENOTEMPTY
from glob import escape
from pathlib import Path

from halfseen.errors import ArgumentError

LOCK = ".lock"
"""File by which a folder is locked."""
FAR_BYTE = 2**30
"""Offset of the byte that is locked on Windows [B]."""


def path_of(folder: object) -> Path:
    """Return a path; refuse addresses in object stores, which would become a folder called "s3:".

    Raises
    ------
    ArgumentError
        It is such an address, or no path.
    """
    if not isinstance(folder, str | os.PathLike):
        raise ArgumentError(f"folder is a {type(folder).__name__}; give the path of a folder")
    if re.match(r"\w{2,}:/", os.fspath(folder)):
        raise ArgumentError(f"{folder}: it is an address, and only logs are read from stores; give a folder")
    return Path(folder)


def write_file(target: Path, content: str | bytes) -> None:
    """Write a file, replacing what is there; missing parents are made, and a link keeps its target.

    Raises
    ------
    ArgumentError
        The file cannot be written, or its place is taken by something like a device.
    """
    target = Path(os.path.realpath(target))
    fresh = _beside(target, "new")
    try:
        if target.exists() and not target.is_file():
            kind = "a folder" if target.is_dir() else "a device, a pipe or the like"
            raise ArgumentError(f"{target}: it is {kind}, not a file; choose another name")
        target.parent.mkdir(parents=True, exist_ok=True)
        fresh.write_bytes(content.encode() if isinstance(content, str) else content)
        fresh.replace(target)
    except OSError as error:
        raise _unwritable(target, error) from error
    finally:
        with suppress(OSError):
            fresh.unlink()


@contextmanager
def placed(target: Path, *, overwrite: bool = False, marker: str | None = None, kind: str = "logs") -> Iterator[Path]:
    """Provide an empty folder to write into, and move it to `target` if the block succeeds.

    Parameters
    ----------
    target
        Final place of the folder; missing parents are made.
    overwrite
        Replace an existing folder, if it holds `marker`.
    marker
        A file that every folder of this kind holds.
    kind
        The content of such a folder, for the message.

    Raises
    ------
    ArgumentError
        Something is there already, or has appeared in the meantime, and may not be replaced, or the folder cannot be
        written.
    """
    refuse_taken(target, overwrite, marker, kind)
    fresh = _beside(target, "new")
    try:
        fresh.mkdir(parents=True)
        yield fresh
        if overwrite and target.exists():
            _swap(fresh, target.absolute(), lambda: refuse_taken(target, overwrite, marker, kind))
        else:
            _put(fresh, target)
    except OSError as error:
        raise _unwritable(target, error) from error
    finally:
        shutil.rmtree(fresh, ignore_errors=True)


def refuse_taken(target: Path, overwrite: bool, marker: str | None, kind: str) -> None:
    """Refuse a target that exists and may not be replaced; to be called before long work, too.

    Raises
    ------
    ArgumentError
        It exists and `overwrite` is False, or it does not hold `marker`.
    """
    try:
        is_there = target.exists() or target.is_symlink()
        is_ours = marker is not None and (target / marker).exists()
    except OSError as error:
        raise _unwritable(target, error) from error
    if is_there and not overwrite:
        remedy = "move it away first" if marker is None else "pass --overwrite (overwrite=True) to replace it"
        raise ArgumentError(f"{target}: it already exists; choose another folder, or {remedy}")
    if is_there and not is_ours:
        raise ArgumentError(
            f"{target}: it holds no {kind} ({marker} is missing), so it is not replaced; choose another folder"
        )


def refuse_unwritable(target: Path) -> None:
    """Refuse a folder that cannot be made or written; to be called before long work.

    Raises
    ------
    ArgumentError
        The nearest existing parent is no folder, or this user may not write to it.
    """
    place = target.absolute()
    try:
        nearest = next(each for each in (place, *place.parents) if each.exists())
    except OSError as error:
        raise _unwritable(target, error) from error
    if not (nearest.is_dir() and os.access(nearest, os.W_OK)):
        kind = "may not be written by you" if nearest.is_dir() else "is not a folder"
        raise ArgumentError(f"{target}: cannot be written, as {nearest} {kind}; choose another folder")


def is_locked(descriptor: int, *, is_shared: bool = False) -> bool:
    """Take the lock of a file unless another process or descriptor has it; closing the descriptor releases it.

    Parameters
    ----------
    descriptor
        Descriptor of the file.
    is_shared
        Whether others may hold the lock at the same time.

    Returns
    -------
    bool
        Whether it was taken.

    Raises
    ------
    OSError
        Files cannot be locked there, as on some network drives.
    """
    if sys.platform == "win32":
        import msvcrt

        os.lseek(descriptor, FAR_BYTE, os.SEEK_SET)
        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        except PermissionError:
            return False
        finally:
            os.lseek(descriptor, 0, os.SEEK_SET)
        return True
    import fcntl

    try:
        fcntl.flock(descriptor, (fcntl.LOCK_SH if is_shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


@contextmanager
def held_alone(folder: Path, what: str) -> Iterator[None]:
    """Lock a folder against other processes that call this; a missing folder is made.

    The kernel releases the lock when this process ends, however it ends.

    Parameters
    ----------
    folder
        The folder.
    what
        The name of the writer, for the message.

    Raises
    ------
    ArgumentError
        Another process holds the lock, or the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise _unwritable(folder, error) from error
    try:
        if not is_locked(descriptor):
            raise ArgumentError(
                f"{folder}: another {what} is writing into it; wait until it ends, or choose another folder (the "
                "lock ends with its process: nothing needs removing after a crash)"
            )
        yield
    finally:
        os.close(descriptor)


def left_aside(target: Path) -> Path | None:
    """Find what stood at `target` if `placed` was killed between its two renames; otherwise None."""
    aside = sorted(target.absolute().parent.glob(f".{escape(target.name)}.*.old"))
    return aside[-1] if aside else None


def _beside(target: Path, suffix: str) -> Path:
    """A hidden name in the same folder that no other thread, process or host chooses."""
    place = target.absolute()
    return place.with_name(f".{place.name}.{uuid.uuid4().hex}.{suffix}")


def _unwritable(target: Path, error: OSError) -> ArgumentError:
    remedies = {ENOSPC: "make room, or choose another folder", ENAMETOOLONG: "choose a shorter name"}
    remedy = remedies.get(error.errno or 0, "choose another folder")
    return ArgumentError(f"{target}: cannot be written ({error.strerror or error}); {remedy}")


def _put(fresh: Path, target: Path) -> None:
    """Move a folder to a free place: a rename never replaces anything that has appeared in the meantime.

    Only an empty folder is replaced, which loses nothing.
    """
    try:
        fresh.rename(target)
    except OSError as error:
        if error.errno in (EEXIST, ENOTEMPTY, ENOTDIR) and os.path.lexists(target):
            raise ArgumentError(
                f"{target}: another process wrote it in the meantime, and it is kept; choose another folder"
            ) from error
        raise


def _swap(fresh: Path, target: Path, refuse: Callable[[], None]) -> None:
    """Replace `target` by `fresh`, unless refused; the old folder is restored on failure."""
    refuse()
    old = _beside(target, "old")
    target.rename(old)
    try:
        fresh.rename(target)
    except OSError:
        old.rename(target)
        raise
    if old.is_symlink():
        old.unlink()
    shutil.rmtree(old, ignore_errors=True)
