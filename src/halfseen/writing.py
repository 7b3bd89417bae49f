"""A file or a folder that is there whole or not at all: written under a name of its own, then renamed; and locks.

The kernel gives a lock back when its process ends, however it ends. On Windows a lock keeps others from reading what is
locked, and is never shared: there a byte far behind the end stands for the file, and anyone who asks for a shared lock
holds it alone.
"""

import os
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
"""File by which a folder is held."""
FAR_BYTE = 2**30
"""Place of the byte that stands for a file on Windows [B]."""


def write_file(target: Path, content: str | bytes) -> None:
    """Write a file, in place of what is there; missing parents are made, and a link goes on pointing where it did.

    Raises
    ------
    ArgumentError
        The file cannot be written there, or a device or the like is in its place.
    """
    target = Path(os.path.realpath(target))
    fresh = _beside(target, "new")
    try:
        if target.exists() and not target.is_file():
            kind = "a folder" if target.is_dir() else "a device, a pipe or the like"
            raise ArgumentError(f"{target}: it is {kind}, and no file; choose another name")
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
    """Give an empty folder to write into, and put it at `target` once all went well.

    Parameters
    ----------
    target
        Where the folder goes; missing parents are made.
    overwrite
        Replace what is there, if it holds `marker`.
    marker
        A file that every folder of this kind holds.
    kind
        What such a folder holds, for the message.

    Raises
    ------
    ArgumentError
        Something is there already, or has come in the meantime, and is not to be replaced, or the folder cannot be
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
    """Refuse a target where something is that is not to be replaced; to be called before long work, too.

    Raises
    ------
    ArgumentError
        It is there and `overwrite` is False, or it does not hold `marker`.
    """
    try:
        is_there = target.exists() or target.is_symlink()
        is_ours = marker is not None and (target / marker).exists()
    except OSError as error:
        raise _unwritable(target, error) from error
    if is_there and not overwrite:
        remedy = "move it away first" if marker is None else "pass --overwrite (overwrite=True) to replace it"
        raise ArgumentError(f"{target}: it is there already; choose another folder, or {remedy}")
    if is_there and not is_ours:
        raise ArgumentError(
            f"{target}: it holds no {kind} ({marker} is missing), so it is not replaced; choose another folder"
        )


def refuse_unwritable(target: Path) -> None:
    """Refuse a folder that could not be made or written; to be called before long work.

    Raises
    ------
    ArgumentError
        What is nearest to it is no folder, or one that this user may not write.
    """
    place = target.absolute()
    try:
        nearest = next(each for each in (place, *place.parents) if each.exists())
    except OSError as error:
        raise _unwritable(target, error) from error
    if not (nearest.is_dir() and os.access(nearest, os.W_OK)):
        kind = "may not be written by you" if nearest.is_dir() else "is no folder"
        raise ArgumentError(f"{target}: cannot be written, as {nearest} {kind}; choose another folder")


def is_locked(descriptor: int, *, is_shared: bool = False) -> bool:
    """Take the lock of a file, if no other process or descriptor has it; closing the descriptor gives it back.

    Parameters
    ----------
    descriptor
        Of the file.
    is_shared
        Whether others may have it at the same time.

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
    """Hold a folder, so that no other process that asks for it writes into it in the meantime; it is made if missing.

    The kernel gives it back when this process ends, however it ends.

    Parameters
    ----------
    folder
        Which.
    what
        What writes there, for the message.

    Raises
    ------
    ArgumentError
        Another process holds it, or it cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise _unwritable(folder, error) from error
    try:
        if not is_locked(descriptor):
            raise ArgumentError(
                f"{folder}: another {what} writes into it; wait for its end, or choose another folder (the lock goes "
                "with its process: there is nothing to remove after a crash)"
            )
        yield
    finally:
        os.close(descriptor)


def left_aside(target: Path) -> Path | None:
    """Find what stood at `target` when `placed` was killed between its two renames; None if it was not."""
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
    """Put a folder where nothing is: to rename never takes the place of what has come in the meantime.

    An empty folder alone gives way, which loses nothing.
    """
    try:
        fresh.rename(target)
    except OSError as error:
        if error.errno in (EEXIST, ENOTEMPTY, ENOTDIR) and os.path.lexists(target):
            raise ArgumentError(
                f"{target}: somebody else wrote it in the meantime; what is there stays: choose another folder"
            ) from error
        raise


def _swap(fresh: Path, target: Path, refuse: Callable[[], None]) -> None:
    """Put `fresh` in the place of `target`, unless that is to be refused; what was there comes back if that fails."""
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
