"""The writing end of a journal: one process, one line at a time, and nothing half-written left behind."""

import os
import time
from collections.abc import Callable, Container
from contextlib import suppress
from errno import EDQUOT, EFBIG, ENOSPC
from pathlib import Path
from typing import Any, NamedTuple

from halfseen.errors import ArgumentError, LogError
from halfseen.logs.durability import sync, sync_folder, unsynced_folders
from halfseen.logs.journal import HEADER, JOURNAL, JournalEvents, following, journal_line
from halfseen.logs.recorded import Recorded
from halfseen.logs.refusal import within
from halfseen.logs.reward_unit import common_unit
from halfseen.writing import is_locked

_NO_ROOM = (ENOSPC, EDQUOT, EFBIG)
LOCK_TRIES, LOCK_PAUSE_S = 3, 0.02


def is_being_recorded(file: Path) -> bool:
    """Tell whether some process has this journal open for writing."""
    descriptor = os.open(file, os.O_RDONLY)
    try:
        return not is_locked(descriptor, is_shared=True)
    finally:
        os.close(descriptor)


class _Held(NamedTuple):
    """What a journal holds for good."""

    num_bytes: int
    checksum: int
    known: Recorded


class JournalWriter:
    """A journal open for appending, locked for as long as the process lives.

    Parameters
    ----------
    folder
        Where the journal lies or shall lie; missing parents are made.
    synced
        The events after which the disk is waited for.
    restore
        Called with each event that the journal already holds.
    reward_unit
        What rewards are counted in; None for what the journal already says, if it does.

    Raises
    ------
    ArgumentError
        Another recorder has the folder, or it cannot be written.
    LogError
        The journal is corrupted, or rewards above are in another unit.
    """

    def __init__(
        self,
        folder: Path,
        synced: Container[str],
        restore: Callable[[dict[str, Any]], None],
        reward_unit: str | None = None,
    ) -> None:
        self.file = folder / JOURNAL
        self._synced = synced
        self._process = os.getpid()
        self._held = _Held(0, 0, Recorded())
        self._is_torn = False
        folders = unsynced_folders(folder) if synced else []
        self._descriptor: int | None = _open(folder, self.file)
        try:
            events = JournalEvents(self.file)
            for event in events:
                with following(events):
                    restore(event)
            events.tell_holes()
            with within(self.file):
                common_unit([events.reward_unit, reward_unit])
            # What a kill tore.
            os.ftruncate(self._descriptor, events.num_bytes)
            self._held = _Held(events.num_bytes, events.checksum or 0, self.known)
            if events.num_bytes == 0:
                self.append(HEADER, self.known)
            session = {"event": "session"} | ({} if reward_unit is None else {"reward_unit": reward_unit})
            self.append(session, self.known)
            if synced:
                sync(self._descriptor)
            for each in folders:
                sync_folder(each)
        except BaseException:
            self.close()
            raise

    @property
    def is_closed(self) -> bool:
        """True once it takes no more events."""
        return self._descriptor is None

    @property
    def known(self) -> Recorded:
        """What the recorder knows after the last event."""
        return self._held.known

    @known.setter
    def known(self, known: Recorded) -> None:
        self._held = self._held._replace(known=known)

    def append(self, event: dict[str, Any], known: Recorded) -> None:
        """Hand one event to the operating system, whole or not at all.

        Parameters
        ----------
        event
            The event.
        known
            What the recorder knows once it is written: both hold, or neither, whenever Ctrl-C comes.

        Raises
        ------
        LogError
            The journal is closed, belongs to another process, or the disk is full.
        """
        if self._descriptor is None:
            raise LogError(f"{self.file}: the recorder is closed; open a new one on the folder, which goes on")
        if os.getpid() != self._process:
            raise LogError(
                f"{self.file}: the recorder belongs to process {self._process}, and this is its fork {os.getpid()}; "
                "record in the process that opened it"
            )
        num_bytes, checksum, _ = self._held
        try:
            self._take_back()
            line, checksum = journal_line(event, checksum)
            self._is_torn = True
            self._write(line, event["event"] in self._synced)
        except OSError as error:
            with suppress(OSError):
                self._take_back()
            remedy = "make room" if error.errno in _NO_ROOM else "see to the disk"
            raise LogError(
                f"{self.file}: the event cannot be written ({error.strerror}); {remedy} and give it again; all before "
                "it is kept"
            ) from error
        self._held = _Held(num_bytes + len(line), checksum, known)
        self._is_torn = False

    def close(self) -> None:
        """Let the journal go; closing twice is no harm."""
        if self._descriptor is not None:
            if os.getpid() == self._process:
                with suppress(OSError):
                    self._take_back()
            # Not unlocked: in a fork that would take the lock from the process that records.
            os.close(self._descriptor)
            self._descriptor = None

    def _take_back(self) -> None:
        """Take back what was written of an event that its caller does not know of: Ctrl-C or a full disk came first."""
        assert self._descriptor is not None
        if self._is_torn:
            os.ftruncate(self._descriptor, self._held.num_bytes)
            self._is_torn = False

    def _write(self, line: bytes, is_synced: bool) -> None:
        assert self._descriptor is not None
        num_written = os.write(self._descriptor, line)
        if num_written != len(line):
            raise OSError(ENOSPC, f"{num_written} of {len(line)} bytes fitted")
        if is_synced:
            sync(self._descriptor)


def _open(folder: Path, file: Path) -> int:
    for _ in range(LOCK_TRIES):
        descriptor = _opened(folder, file)
        if descriptor is not None:
            if is_locked(descriptor) and _is_there(descriptor, file):
                return descriptor
            os.close(descriptor)
        # A reader that asks who records holds the lock for a moment; who recorded here may have removed the folder.
        time.sleep(LOCK_PAUSE_S)
    raise ArgumentError(
        f"{folder}: another recorder, of this or another process, is recording into it; close that one, or choose "
        "another folder (the lock goes with its process: there is nothing to remove after a crash)"
    )


def _opened(folder: Path, file: Path) -> int | None:
    """Open the journal; None where the folder goes just now."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return os.open(file, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o644)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise ArgumentError(f"{folder}: cannot be written ({error.strerror}); choose another folder") from error


def _is_there(descriptor: int, file: Path) -> bool:
    """Whether what is open still goes by this name."""
    try:
        return os.path.samestat(os.fstat(descriptor), file.stat())
    except FileNotFoundError:
        return False
