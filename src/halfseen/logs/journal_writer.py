"""Writing a journal: by one process, one line at a time, without leaving partial lines behind.

Data handed to the operating system survives the process but not the machine: it stays in memory for up to half a
minute before it is on the disk. `os.fsync` waits for the disk.
"""

import os
import sys
import time
from collections.abc import Callable, Container, Iterator
from contextlib import contextmanager, suppress
from errno import EDQUOT, EFBIG, ENOSPC
from pathlib import Path
from typing import Any, NamedTuple

from halfseen.errors import ArgumentError, LogError, StorageError, within
from halfseen.logs import journal
from halfseen.logs.checks import common_unit
from halfseen.writing import is_locked

FSYNC: dict[str, Container[str]] = {
    "never": (),
    "trajectory": ("finished", "cut"),
    "stage": ("stage", "finished", "cut"),
    "event": ("resumed", "stage", "done", "running", "out", "finished", "cut"),
}
"""Events after which to wait for the disk; all earlier events are then on it, too."""


def synced_events(fsync: bool | str) -> Container[str]:
    """Events after which to wait for the disk; True means all of them, False none.

    Raises
    ------
    ArgumentError
        `fsync` is unknown.
    """
    name = ("never", "event")[fsync] if isinstance(fsync, bool) else fsync
    if name not in FSYNC:
        raise ArgumentError(f"fsync is {fsync!r}; give one of {', '.join(map(repr, FSYNC))}")
    return FSYNC[name]


def sync(descriptor: int) -> None:
    """Wait until a file or folder is on the disk.

    Raises
    ------
    OSError
        The disk cannot store it.
    """
    if sys.platform == "darwin":
        import fcntl

        with suppress(OSError):  # The equivalent of fsync elsewhere; not all file systems support it.
            fcntl.fcntl(descriptor, fcntl.F_FULLFSYNC)
            return
    os.fsync(descriptor)


def unsynced_folders(folder: Path) -> list[Path]:
    """A folder and those above it to sync so that it can be found: the ones created with it, and the one above them."""
    above = folder.absolute().parents
    num_missing = next(number for number, each in enumerate(above) if each.exists())
    return [folder, *above[: num_missing + 1]]


def sync_folder(folder: Path) -> None:
    """Wait until the names in a folder are on the disk; an unreadable folder is skipped."""
    with suppress(PermissionError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            sync(descriptor)
        finally:
            os.close(descriptor)


_NO_ROOM = (ENOSPC, EDQUOT, EFBIG)
_FLAGS = os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0)
LOCK_TRIES, LOCK_PAUSE_S = 3, 0.02


class _Held(NamedTuple):
    """Committed state of a journal, with the part that is being written."""

    part: Path
    descriptor: int
    num_bytes: int
    checksum: int
    known: Any


class JournalWriter:
    """A journal open for appending, locked for as long as the process lives.

    Parameters
    ----------
    folder
        Folder of the journal; it and missing parents are created.
    synced
        Events after which to wait for the disk.
    restore
        Called with each event that the journal already holds.
    reward_unit
        Unit of the rewards; None for the unit already in the journal, if any.
    part_bytes
        Size above which the next trajectory begins a new part [B].

    Raises
    ------
    ArgumentError
        Another recorder holds the folder, or it cannot be written.
    LogError
        The journal is corrupted, or its rewards are in another unit.
    """

    def __init__(
        self,
        folder: Path,
        synced: Container[str],
        restore: Callable[[dict[str, Any]], None],
        reward_unit: str | None = None,
        part_bytes: int = journal.PART_BYTES,
    ) -> None:
        self._synced = synced
        self._part_bytes = part_bytes
        self._process = os.getpid()
        self._is_torn = False
        folders = unsynced_folders(folder) if synced else []
        first = folder / journal.JOURNAL
        self._lock: int | None = _locked(folder, first)
        self._held = _Held(first, self._lock, 0, 0, None)
        try:
            parts = journal.journal_parts(folder)
            journal.tell_missing(parts)
            read = [_restored(part, restore) for part in parts]
            with within(folder):
                self._reward_unit = common_unit([*(events.reward_unit for events in read), reward_unit])
            last = read[-1]
            with self._verbosity():
                descriptor = self._lock if last.file == first else os.open(last.file, _FLAGS)
                self._begin(last.file, descriptor, last.num_bytes, last.checksum or 0)
            for each in folders:
                sync_folder(each)
        except BaseException:
            self.close()
            raise

    @property
    def is_closed(self) -> bool:
        """True once it accepts no more events."""
        return self._lock is None

    @property
    def known(self) -> Any:
        """State of the recorder after the last event."""
        return self._held.known

    @known.setter
    def known(self, known: Any) -> None:
        self._held = self._held._replace(known=known)

    def append(self, event: dict[str, Any], known: Any) -> None:
        """Hand one event to the operating system, whole or not at all.

        Parameters
        ----------
        event
            The event.
        known
            State of the recorder after it; both are stored or neither, whenever Ctrl-C comes.

        Raises
        ------
        LogError
            The journal is closed or deleted, belongs to another process, or the disk is full.
        """
        if self._lock is None:
            raise LogError(f"{self._held.part}: the recorder is closed; open a new one on the folder to continue")
        if os.getpid() != self._process:
            raise LogError(
                f"{self._held.part}: the recorder belongs to process {self._process}, and this is its fork "
                f"{os.getpid()}; record in the process that opened it"
            )
        with self._verbosity():
            self._refuse_deleted()
            self._take_back()
            if self._held.num_bytes >= self._part_bytes and event["event"] == "stage" and event["stage"] == 1:
                self._begin_part()
            part, descriptor, num_bytes, checksum, _ = self._held
            line, checksum = journal.journal_line(event, checksum)
            self._is_torn = True
            _write(descriptor, line, event["event"] in self._synced)
        self._held = _Held(part, descriptor, num_bytes + len(line), checksum, known)
        self._is_torn = False

    def close(self) -> None:
        """Release the journal; closing twice is harmless."""
        if self._lock is None:
            return
        if os.getpid() == self._process:
            with suppress(OSError):
                self._take_back()
        # Do not unlock: in a fork that would release the lock of the recording process.
        lock, self._lock = self._lock, None
        for each in {lock, self._held.descriptor}:
            os.close(each)

    def _begin(self, part: Path, descriptor: int, num_bytes: int, checksum: int) -> None:
        """Begin a session after the existing lines of a part, and make it the part that is written."""
        session = {"event": "session"} | ({} if self._reward_unit is None else {"reward_unit": self._reward_unit})
        lines = b""
        for event in (session,) if num_bytes else (journal.HEADER, session):
            line, checksum = journal.journal_line(event, checksum)
            lines += line
        os.ftruncate(descriptor, num_bytes)  # drop a line torn by a kill
        _write(descriptor, lines, bool(self._synced))
        self._held = _Held(part, descriptor, num_bytes + len(lines), checksum, self.known)

    def _begin_part(self) -> None:
        """Switch to the next part; the old part stays current until the new one is complete."""
        before, part = self._held.descriptor, journal.part_after(self._held.part)
        descriptor = os.open(part, _FLAGS)
        try:
            self._begin(part, descriptor, 0, 0)
        finally:
            for each in {before, descriptor} - {self._held.descriptor, self._lock}:
                os.close(each)
        if self._synced:
            sync_folder(part.parent)

    def _refuse_deleted(self) -> None:
        """Refuse to write into a file that has no name any more: what it holds is lost once it is closed."""
        part, descriptor, *_ = self._held
        if os.fstat(descriptor).st_nlink == 0 and not _is_there(descriptor, part):
            raise LogError(
                f"{part}: it was deleted while it was recorded, so the event would be lost; open a new recorder on the "
                "folder, or restart the server"
            )

    def _take_back(self) -> None:
        """Remove the bytes of an event that was not committed because of Ctrl-C or a full disk."""
        if self._is_torn:
            os.ftruncate(self._held.descriptor, self._held.num_bytes)
            self._is_torn = False

    @contextmanager
    def _verbosity(self) -> Iterator[None]:
        """Remove an event that the disk could not store, and report the error."""
        try:
            yield
        except OSError as error:
            with suppress(OSError):
                self._take_back()
            remedy = "make room" if error.errno in _NO_ROOM else "see to the disk"
            raise StorageError(
                f"{self._held.part}: the event cannot be written ({error.strerror}); {remedy} and give it again; all "
                "earlier events are kept"
            ) from error


def _restored(part: Path, restore: Callable[[dict[str, Any]], None]) -> journal.JournalEvents:
    """Read a part to its end, one event at a time."""
    events = journal.JournalEvents(part)
    for event in events:
        with journal.following(events):
            restore(event)
    events.tell_holes()
    return events


def _write(descriptor: int, lines: bytes, is_synced: bool) -> None:
    num_written = os.write(descriptor, lines)
    if num_written != len(lines):
        raise OSError(ENOSPC, f"{num_written} of {len(lines)} bytes were written")
    if is_synced:
        sync(descriptor)


def _locked(folder: Path, file: Path) -> int:
    """Open the file whose lock protects the folder, once no other process holds it."""
    for _ in range(LOCK_TRIES):
        descriptor = _opened(folder, file)
        if descriptor is not None:
            try:
                if is_locked(descriptor) and _is_there(descriptor, file):
                    return descriptor
            except OSError as error:
                os.close(descriptor)
                raise ArgumentError(
                    f"{folder}: its files cannot be locked ({error.strerror}), so two recorders could mix; record "
                    "into a folder on a disk of this machine"
                ) from error
            os.close(descriptor)
        # A reader briefly holds the lock to see if a recorder runs; an earlier recorder may have removed the folder.
        time.sleep(LOCK_PAUSE_S)
    raise ArgumentError(
        f"{folder}: another recorder, of this or another process, is recording into it; close that one, or choose "
        "another folder (the lock ends with its process: nothing needs removing after a crash)"
    )


def _opened(folder: Path, file: Path) -> int | None:
    """Open the journal; None if the folder is being removed."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return os.open(file, _FLAGS, 0o644)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise ArgumentError(f"{folder}: cannot be written ({error.strerror}); choose another folder") from error


def _is_there(descriptor: int, file: Path) -> bool:
    """Whether the open file still has this name."""
    try:
        return os.path.samestat(os.fstat(descriptor), file.stat())
    except FileNotFoundError:
        return False
