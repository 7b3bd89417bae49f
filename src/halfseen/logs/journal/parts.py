"""The files of a journal: between two trajectories it goes on in another once one is large.

::

    FOLDER/
      journal.jsonl      the first; whoever records holds its lock, whichever part is written
      journal-2.jsonl
      journal-3.jsonl    the last, which is gone on with

Each is a whole journal by itself: parts may be copied and read one by one, and those between the first and the last
moved away. The first stays as long as somebody records: without it another recorder would find no lock.
"""

import re
import warnings
from itertools import pairwise
from pathlib import Path

from halfseen.errors import HalfseenWarning

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
        warnings.warn(
            f"{parts[0].parent}: the journal has no {missing[0]}, though later parts are there: what was recorded in "
            "it is left out; copy it there if it was not moved away on purpose",
            HalfseenWarning,
            stacklevel=3,
        )


def _number(part: Path) -> int:
    found = _PART.fullmatch(part.name)
    return int(found[1] or 1) if found else 1
