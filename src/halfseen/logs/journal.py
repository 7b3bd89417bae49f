"""The journal of a recorder: one event per line, each line chained to the line above by a checksum.

::

    FOLDER/
      journal.jsonl      the first part; the recorder holds its lock, whichever part it writes
      journal-2.jsonl    once a part is large, the next trajectory begins a new part
      journal-3.jsonl    the last part, to which the recorder appends

Each part is a complete journal: parts may be copied and read one by one, and those between the first and the last
moved away. The first must stay during recording, or another recorder would find no lock.

A line is a JSON array of a checksum and an event: ``["9f3c2a11",{"event":"done","at_s":4.5,"reward":1.0}]``. The
checksum is the CRC-32 of the event's bytes, continued from the checksum of the line above. It reveals a line that was
changed, moved or lost. A last line without a line end was torn by a kill or a full disk, and is ignored.

After a power failure a page in the middle may hold zeros. Lines that fail the check are left out. The lines above are
kept, and so are those below, from the first line whose checksum continues the one that the line above it states. A
session below such lines may start its chain from 0.

Events, with the clock `at_s` of the trajectory [s]:

==========  ===========================================================================================================
journal     the first line: format and version
session     a recorder was opened; a trajectory in progress above it was interrupted; ``reward_unit`` if known
resumed     after a session: the interrupted trajectory goes on
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
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

from halfseen.errors import LogError, warn
from halfseen.logs.columns import converting
from halfseen.reading import TABLE, opened, reason_of
from halfseen.writing import is_locked

FORMAT, VERSION = "halfseen-journal", 2
HEADER = {"event": "journal", "format": FORMAT, "version": VERSION}
OLDER = HEADER | {"version": 1}
"""Header of older journals, in which trajectories were called paths."""

MOST_LINE_BYTES = 256 * 10**6
"""Size limit of an event; memory holds one at a time."""

HOLE = {"event": "hole"}
"""Yielded in place of lines that fail the check."""

MOST_TOLD = 5
"""Number of runs of such lines that a warning names."""

_SESSION = b'{"event":"session"'
_CHECKSUM, _EVENT = slice(2, 10), slice(12, -2)


def journal_line(event: dict[str, Any], checksum: int) -> tuple[bytes, int]:
    """Write an event as a line; `checksum` is that of the line above, 0 for the first line.

    Returns
    -------
    line : bytes
        The line with its line end.
    checksum : int
        Checksum of the line.
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
        Complete lines read so far, and their bytes.
    checksum
        Checksum that the last line states; None if it states none.
    holes
        First and last line number of each run of lines that fail the check.
    reward_unit
        Unit of the rewards, from the first session that states one; None if none does.
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
                    if event is None and self.holes and self.holes[-1][1] == self.num_lines - 1:
                        self.holes[-1] = (self.holes[-1][0], self.num_lines)
                    elif event is None:
                        self.holes.append((self.num_lines, self.num_lines))
                        yield HOLE
                    else:
                        self.reward_unit = self.reward_unit or event.get("reward_unit")
                        yield event
        except OSError as error:
            raise LogError(f"{self.file}: it cannot be read ({reason_of(error)}); copy it again") from error
        if self.holes == [(1, self.num_lines)]:
            raise LogError(
                f"{self.file}: all its lines fail their checksum, so it is not a journal or is lost; restore it"
            )

    def tell_holes(self) -> None:
        """Warn about lines that fail the check, in one line."""
        if not self.holes:
            return
        lost = ", ".join(
            str(first) if first == last else f"{first} to {last}" for first, last in self.holes[:MOST_TOLD]
        )
        more = ", …" if len(self.holes) > MOST_TOLD else ""
        num_lost = sum(last - first + 1 for first, last in self.holes)
        warn(
            self.file,
            f"{num_lost} of {self.num_lines} lines fail their checksum and are left out ({lost}{more}), as after "
            "a loss of power; all others are kept, and a trajectory in progress there counts as cut by a crash",
        )

    def refusal(self, trouble: str) -> LogError:
        """Error that names the line read last."""
        return LogError(f"{self.file}, line {self.num_lines}: {trouble}")

    def _event(self, line: bytes) -> dict[str, Any] | None:
        """The event of a line; None if it fails the check."""
        above, self.checksum = self.checksum, _stated(line)
        body = line[_EVENT]
        is_chained = above is not None and zlib.crc32(body, above) == self.checksum
        is_restarted = bool(self.holes) and body.startswith(_SESSION) and zlib.crc32(body) == self.checksum
        event = _parsed(body) if is_chained or is_restarted else None
        if self.num_lines == 0 and event is not None and event != HEADER:
            raise LogError(
                f"{self.file}, line 1: {body.decode()} is not the {FORMAT} of version {VERSION} that this halfseen "
                "reads; "
                + (converting(self.file.parent) if event == OLDER else "read it with the halfseen that wrote it")
            )
        return event


@contextmanager
def following(events: JournalEvents) -> Iterator[None]:
    """Refuse an event that passes the check but cannot follow those above it."""
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
"""Size above which the next trajectory begins a new part [B]."""

_PART = re.compile(r"journal(?:-([1-9]\d{0,8}))?\.jsonl")


def is_journal(folder: Path) -> bool:
    """Whether a recorder wrote this folder."""
    return bool(journal_parts(folder))


def journal_parts(folder: Path) -> list[Path]:
    """The parts in a folder, in the order of recording."""
    files = folder.iterdir() if folder.is_dir() else ()
    return sorted((file for file in files if _PART.fullmatch(file.name) and file.is_file()), key=_number)


def part_after(part: Path) -> Path:
    """The path of the next part, whether or not it exists."""
    return part.with_name(f"journal-{_number(part) + 1}.jsonl")


def tell_missing(parts: list[Path]) -> None:
    """Warn in one line if parts are missing between others; parts missing before the first are ignored."""
    numbers = [_number(part) for part in parts if part.stat().st_size > 0]
    missing = [part_after(parts[0].with_name(f"journal-{a}.jsonl")).name for a, b in pairwise(numbers) if b > a + 1]
    if missing:
        warn(
            parts[0].parent,
            f"the journal has no {missing[0]}, though later parts are there: what was recorded in it is left out; "
            "copy it there unless it was moved away on purpose",
        )


def _number(part: Path) -> int:
    found = _PART.fullmatch(part.name)
    return int(found[1] or 1) if found else 1


def is_being_recorded(folder: Path) -> bool:
    """Whether a process records into this folder; False where files cannot be locked."""
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
