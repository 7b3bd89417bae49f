"""The journal: what a recorder saw, one event a line, each line chained to those above it by a checksum.

A line is a JSON array of a checksum and an event: ``["9f3c2a11",{"event":"done","at_s":4.5,"reward":1.0}]``. The
checksum is the CRC-32 of the event's bytes that goes on from the checksum of the line above, so that a line that was
changed, moved or lost shows. A last line without its end was torn by a kill or a full disk, and is ignored.

Events, with the clock `at_s` of the path [s]:

==========  ===========================================================================================================
journal     the first line: format and version
session     a recorder was opened; a path in progress above it was torn; ``reward_unit`` where the recorder was told it
stage       a stage began: path, stage, covariates, objects, robot, action, object, probability; the first also has
            ``columns``
done        the stage in progress was completed: reward; ``is_given`` where the clock was given, not read
running     the path was still in progress
out         one of several robots dropped out: robot, cause
finished    the path reached its own end
cut         the path was cut: cause
==========  ===========================================================================================================
"""

import json
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from halfseen.errors import LogError

JOURNAL = "journal.jsonl"
FORMAT, VERSION = "halfseen-journal", 1
HEADER = {"event": "journal", "format": FORMAT, "version": VERSION}

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
        The checksum of the last of them.
    reward_unit
        What rewards are counted in, as the first recorder said that did; None if none did.
    """

    def __init__(self, file: Path) -> None:
        self.file = file
        self.num_lines = 0
        self.num_bytes = 0
        self.checksum = 0
        self.reward_unit: str | None = None

    def __iter__(self) -> Iterator[dict[str, Any]]:
        try:
            with self.file.open("rb") as stream:
                for line in stream:
                    if not line.endswith(b"\n"):
                        return
                    event = self._event(line)
                    self.num_lines += 1
                    self.num_bytes += len(line)
                    self.reward_unit = self.reward_unit or event.get("reward_unit")
                    yield event
        except OSError as error:
            raise LogError(f"{self.file}: it cannot be read ({error.strerror}); copy it again") from error

    def refusal(self, trouble: str) -> LogError:
        """Name the line that was read last."""
        return LogError(f"{self.file}, line {self.num_lines}: {trouble}")

    def _event(self, line: bytes) -> dict[str, Any]:
        checksum = zlib.crc32(line[_EVENT], self.checksum)
        if line[_CHECKSUM] != b"%08x" % checksum:
            what = f"{self.file}, line {self.num_lines + 1}: its checksum does not fit"
            raise LogError(
                f"{what}, so it was changed, or lines above it are lost; restore the file from a copy, or delete from "
                f"this line on to keep the {self.num_lines} above"
            )
        self.checksum = checksum
        event = json.loads(line[_EVENT])
        if self.num_lines == 0 and event != HEADER:
            raise LogError(
                f"{self.file}, line 1: {line[_EVENT].decode()} is not the {FORMAT} of version {VERSION} that this "
                "halfseen reads; read it with the halfseen that wrote it"
            )
        return event
