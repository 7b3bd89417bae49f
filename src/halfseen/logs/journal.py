"""The journal: what a recorder saw, one event a line, each line chained to those above it by a checksum.

::

    FOLDER/
      journal.jsonl      the first; anyone who records holds its lock, whichever part is written
      journal-2.jsonl    between two trajectories it goes on in another file once one is large
      journal-3.jsonl    the last, which is gone on with

Each is a whole journal by itself: parts may be copied and read one by one, and those between the first and the last
moved away. The first stays as long as somebody records: without it another recorder would find no lock.

A line is a JSON array of a checksum and an event: ``["9f3c2a11",{"event":"done","at_s":4.5,"reward":1.0}]``. The
checksum is the CRC-32 of the event's bytes that goes on from the checksum of the line above, so that a line that was
changed, moved or lost shows. A last line without its end was torn by a kill or a full disk, and is ignored.

After a loss of power a page in the middle may hold zeros. Lines that do not check are left out: what is above them is
kept, and so is what is below, from the first line whose checksum goes on from the one that the line above it states. A
session that begins below such lines may begin from 0.

One process writes, one line at a time, and leaves nothing half-written behind. What was handed to the operating system
outlives the process, not the machine: it lies in memory until the disk has it, up to half a minute. `os.fsync` waits
for the disk.

Events, with the clock `at_s` of the trajectory [s]:

==========  ===========================================================================================================
journal     the first line: format and version
session     a recorder was opened; a trajectory in progress above it was torn; ``reward_unit`` where it is known
resumed     below a session: that trajectory goes on
stage       a stage began: trajectory, stage, covariates, objects, robot, action, object, probability,
            stepped_back; the first one also has ``columns``
done        the stage in progress was completed: reward; ``is_given`` where the clock was given, not read
running     the trajectory was still in progress
out         one of several robots dropped out: robot, cause
finished    the trajectory reached its own end
cut         the trajectory was cut: cause
==========  ===========================================================================================================
"""

import json
import os
import re
import sys
import time
import zlib
from collections.abc import Callable, Container, Iterator
from contextlib import contextmanager, suppress
from errno import EDQUOT, EFBIG, ENOSPC
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

from halfseen.errors import ArgumentError, LogError, warn, within
from halfseen.locks import is_locked
from halfseen.logs.columns import common_unit, converting
from halfseen.reading import TABLE, opened, reason_of

FORMAT, VERSION = "halfseen-journal", 2
HEADER = {"event": "journal", "format": FORMAT, "version": VERSION}
OLDER = HEADER | {"version": 1}
"""Of a journal whose trajectories were called paths."""

MOST_LINE_BYTES = 256 * 10**6
"""Of an event; memory holds one at a time."""

HOLE = {"event": "hole"}
"""Given in the place of lines that do not check."""

MOST_TOLD = 5
"""Rows of such lines that a warning names."""

_SESSION = b'{"event":"session"'
_CHECKSUM, _EVENT = slice(2, 10), slice(12, -2)


def journal_line(event: dict[str, Any], checksum: int) -> tuple[bytes, int]:
    """Write an event as a line.

    Parameters
    ----------
    event
        The event.
    checksum
        The checksum of the line above; 0 for the first.

    Returns
    -------
    line : bytes
        With its end.
    checksum : int
        Its own checksum.
    """
    body = json.dumps(event, separators=(",", ":"), allow_nan=False).encode()
    checksum = zlib.crc32(body, checksum)
    return b'["%08x",%b]\n' % (checksum, body), checksum


class JournalEvents:
    """The events of a journal, read line by line.

    Parameters
    ----------
    file
        The journal.

    Attributes
    ----------
    num_lines, num_bytes
        Whole lines read so far, and their bytes.
    checksum
        What the last of them states; None where it states none.
    holes
        Numbers of the first and the last of lines that do not check, for each row of such lines.
    reward_unit
        What rewards are counted in, as the first recorder said that did; None if none did.
    """

    def __init__(self, file: Path) -> None:
        self.file = file
        self.num_lines = 0
        self.num_bytes = 0
        self.checksum: int | None = 0
        self.holes: list[tuple[int, int]] = []
        self.reward_unit: str | None = None

    def __iter__(self) -> Iterator[dict[str, Any]]:
        try:
            with opened(self.file, TABLE) as stream:
                while line := stream.readline(MOST_LINE_BYTES + 1):
                    if len(line) > MOST_LINE_BYTES:
                        raise LogError(
                            f"{self.file}, line {self.num_lines + 1}: it has more than {MOST_LINE_BYTES // 10**6} MB, "
                            "and no event is so large; restore it, or delete from there on to keep what is above"
                        )
                    if not line.endswith(b"\n"):
                        break
                    event = self._event(line)
                    self.num_lines += 1
                    self.num_bytes += len(line)
                    if event is None:
                        if not self._is_in_hole:
                            yield HOLE
                        self._leave_out()
                    else:
                        self.reward_unit = self.reward_unit or event.get("reward_unit")
                        yield event
        except OSError as error:
            raise LogError(f"{self.file}: it cannot be read ({reason_of(error)}); copy it again") from error
        if self.holes == [(1, self.num_lines)]:
            raise LogError(
                f"{self.file}: none of its lines checks, so it is no journal or all of it is lost; restore it"
            )

    @property
    def _is_in_hole(self) -> bool:
        """Whether the line above the one that is read does not check."""
        return bool(self.holes) and self.holes[-1][1] >= self.num_lines - 1

    def _leave_out(self) -> None:
        first = self.holes.pop()[0] if self._is_in_hole else self.num_lines
        self.holes.append((first, self.num_lines))

    def tell_holes(self) -> None:
        """Warn of lines that do not check, in one line."""
        if not self.holes:
            return
        lost = ", ".join(
            str(first) if first == last else f"{first} to {last}" for first, last in self.holes[:MOST_TOLD]
        )
        more = ", …" if len(self.holes) > MOST_TOLD else ""
        num_lost = sum(last - first + 1 for first, last in self.holes)
        warn(
            self.file,
            f"{num_lost} of {self.num_lines} lines do not check and are left out ({lost}{more}), as after "
            "a loss of power; all others are kept, and a trajectory in progress there counts as cut by a crash",
        )

    def refusal(self, trouble: str) -> LogError:
        """Name the line that was read last."""
        return LogError(f"{self.file}, line {self.num_lines}: {trouble}")

    def _event(self, line: bytes) -> dict[str, Any] | None:
        """The event of a line; None where it does not check."""
        above, self.checksum = self.checksum, _stated(line)
        body = line[_EVENT]
        is_chained = above is not None and zlib.crc32(body, above) == self.checksum
        is_anew = bool(self.holes) and body.startswith(_SESSION) and zlib.crc32(body) == self.checksum
        event = _parsed(body) if is_chained or is_anew else None
        if self.num_lines == 0 and event is not None and event != HEADER:
            raise LogError(
                f"{self.file}, line 1: {body.decode()} is not the {FORMAT} of version {VERSION} that this halfseen "
                "reads; "
                + (converting(self.file.parent) if event == OLDER else "read it with the halfseen that wrote it")
            )
        return event


@contextmanager
def following(events: JournalEvents) -> Iterator[None]:
    """Refuse an event that checks and does not go on from those above it."""
    try:
        yield
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        raise events.refusal(
            f"it cannot follow the lines above ({reason_of(error)}); delete from this line on to keep them"
        ) from error


def _stated(line: bytes) -> int | None:
    try:
        return int(line[_CHECKSUM], 16)
    except ValueError:
        return None


def _parsed(body: bytes) -> dict[str, Any] | None:
    try:
        event = json.loads(body)
    except (ValueError, RecursionError):
        return None
    return event if isinstance(event, dict) and "event" in event else None


JOURNAL = "journal.jsonl"
PART_BYTES = 256 * 10**6
"""Size from which on a trajectory begins in another part [B]."""

_PART = re.compile(r"journal(?:-([1-9]\d{0,8}))?\.jsonl")


def is_journal(folder: Path) -> bool:
    """Whether a recorder wrote this folder."""
    return bool(journal_parts(folder))


def journal_parts(folder: Path) -> list[Path]:
    """The parts that are there, in the order of what was recorded."""
    files = folder.iterdir() if folder.is_dir() else ()
    return sorted((file for file in files if _PART.fullmatch(file.name) and file.is_file()), key=_number)


def part_after(part: Path) -> Path:
    """The part that follows one, whether or not it is there."""
    return part.with_name(f"journal-{_number(part) + 1}.jsonl")


def tell_missing(parts: list[Path]) -> None:
    """Warn where parts are missing between others, in one line; that those before the first are gone is no harm."""
    numbers = [_number(part) for part in parts if part.stat().st_size > 0]
    missing = [part_after(parts[0].with_name(f"journal-{a}.jsonl")).name for a, b in pairwise(numbers) if b > a + 1]
    if missing:
        warn(
            parts[0].parent,
            f"the journal has no {missing[0]}, though later parts are there: what was recorded in "
            "it is left out; copy it there if it was not moved away on purpose",
        )


def _number(part: Path) -> int:
    found = _PART.fullmatch(part.name)
    return int(found[1] or 1) if found else 1


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


_NO_ROOM = (ENOSPC, EDQUOT, EFBIG)
_FLAGS = os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0)
LOCK_TRIES, LOCK_PAUSE_S = 3, 0.02


def is_being_recorded(folder: Path) -> bool:
    """Tell whether some process records into this folder; none does where files cannot be locked."""
    try:
        descriptor = os.open(folder / JOURNAL, os.O_RDONLY)
    except FileNotFoundError:
        return False
    try:
        return not is_locked(descriptor, is_shared=True)
    except OSError:
        return False
    finally:
        os.close(descriptor)


class _Held(NamedTuple):
    """What a journal holds for good, of the part that is written."""

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
        Where the journal lies or shall lie; missing parents are made.
    synced
        The events after which the disk is waited for.
    restore
        Called with each event that the journal already holds.
    reward_unit
        What rewards are counted in; None for what the journal already says, if it does.
    part_bytes
        Size from which on a trajectory begins in another part [B].

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
        part_bytes: int = PART_BYTES,
    ) -> None:
        self._synced = synced
        self._part_bytes = part_bytes
        self._process = os.getpid()
        self._is_torn = False
        folders = unsynced_folders(folder) if synced else []
        first = folder / JOURNAL
        self._lock: int | None = _locked(folder, first)
        self._held = _Held(first, self._lock, 0, 0, None)
        try:
            parts = journal_parts(folder)
            tell_missing(parts)
            read = [_restored(part, restore) for part in parts]
            with within(folder):
                self._reward_unit = common_unit([*(events.reward_unit for events in read), reward_unit])
            last = read[-1]
            with self._telling():
                descriptor = self._lock if last.file == first else os.open(last.file, _FLAGS)
                self._begin(last.file, descriptor, last.num_bytes, last.checksum or 0)
            for each in folders:
                sync_folder(each)
        except BaseException:
            self.close()
            raise

    @property
    def is_closed(self) -> bool:
        """True once it takes no more events."""
        return self._lock is None

    @property
    def known(self) -> Any:
        """What the recorder knows after the last event."""
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
            What the recorder knows once it is written: both hold, or neither, whenever Ctrl-C comes.

        Raises
        ------
        LogError
            The journal is closed, belongs to another process, or the disk is full.
        """
        if self._lock is None:
            raise LogError(f"{self._held.part}: the recorder is closed; open a new one on the folder, which goes on")
        if os.getpid() != self._process:
            raise LogError(
                f"{self._held.part}: the recorder belongs to process {self._process}, and this is its fork "
                f"{os.getpid()}; record in the process that opened it"
            )
        with self._telling():
            self._take_back()
            if self._held.num_bytes >= self._part_bytes and event["event"] == "stage" and event["stage"] == 1:
                self._begin_part()
            part, descriptor, num_bytes, checksum, _ = self._held
            line, checksum = journal_line(event, checksum)
            self._is_torn = True
            _write(descriptor, line, event["event"] in self._synced)
        self._held = _Held(part, descriptor, num_bytes + len(line), checksum, known)
        self._is_torn = False

    def close(self) -> None:
        """Let the journal go; closing twice is no harm."""
        if self._lock is None:
            return
        if os.getpid() == self._process:
            with suppress(OSError):
                self._take_back()
        # Not unlocked: in a fork that would take the lock from the process that records.
        lock, self._lock = self._lock, None
        for each in {lock, self._held.descriptor}:
            os.close(each)

    def _begin(self, part: Path, descriptor: int, num_bytes: int, checksum: int) -> None:
        """Begin a session below what a part holds so far, and take it for the one that is written."""
        session = {"event": "session"} | ({} if self._reward_unit is None else {"reward_unit": self._reward_unit})
        lines = b""
        for event in (session,) if num_bytes else (HEADER, session):
            line, checksum = journal_line(event, checksum)
            lines += line
        os.ftruncate(descriptor, num_bytes)  # what a kill tore
        _write(descriptor, lines, bool(self._synced))
        self._held = _Held(part, descriptor, num_bytes + len(lines), checksum, self.known)

    def _begin_part(self) -> None:
        """Go on in the part that follows; until that is there whole, the one before is the one that is written."""
        before, part = self._held.descriptor, part_after(self._held.part)
        descriptor = os.open(part, _FLAGS)
        try:
            self._begin(part, descriptor, 0, 0)
        finally:
            for each in {before, descriptor} - {self._held.descriptor, self._lock}:
                os.close(each)
        if self._synced:
            sync_folder(part.parent)

    def _take_back(self) -> None:
        """Take back what was written of an event that its caller does not know of: Ctrl-C or a full disk came first."""
        if self._is_torn:
            os.ftruncate(self._held.descriptor, self._held.num_bytes)
            self._is_torn = False

    @contextmanager
    def _telling(self) -> Iterator[None]:
        """Take back what the disk did not take, and say so."""
        try:
            yield
        except OSError as error:
            with suppress(OSError):
                self._take_back()
            remedy = "make room" if error.errno in _NO_ROOM else "see to the disk"
            raise LogError(
                f"{self._held.part}: the event cannot be written ({error.strerror}); {remedy} and give it again; all "
                "before it is kept"
            ) from error


def _restored(part: Path, restore: Callable[[dict[str, Any]], None]) -> JournalEvents:
    """Read a part to its end, an event at a time."""
    events = JournalEvents(part)
    for event in events:
        with following(events):
            restore(event)
    events.tell_holes()
    return events


def _write(descriptor: int, lines: bytes, is_synced: bool) -> None:
    num_written = os.write(descriptor, lines)
    if num_written != len(lines):
        raise OSError(ENOSPC, f"{num_written} of {len(lines)} bytes fitted")
    if is_synced:
        sync(descriptor)


def _locked(folder: Path, file: Path) -> int:
    """Open the file whose lock stands for the folder, once nobody else has it."""
    for _ in range(LOCK_TRIES):
        descriptor = _opened(folder, file)
        if descriptor is not None:
            try:
                if is_locked(descriptor) and _is_there(descriptor, file):
                    return descriptor
            except OSError as error:
                os.close(descriptor)
                raise ArgumentError(
                    f"{folder}: its files cannot be locked ({error.strerror}), which keeps two recorders apart; record "
                    "into a folder on a disk of this machine"
                ) from error
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
        return os.open(file, _FLAGS, 0o644)
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
