"""Parts of a log as they are laid out, kept on disk between passes: reading and checking them takes longest.

What cannot be kept is no loss but of time: anyone who asks lays it out again, to the same bytes. The folder is private
to the user and gone after the passes; its arrays are mapped, so that a pass reads no more of them than it looks at.
"""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from uuid import uuid4

MOST_SHARE = 0.5
"""Of the room that there is on the disk, for all that is kept of a log."""


@dataclass(frozen=True)
class KeptParts:
    """A folder of parts, by kind and number; every process that asks writes and reads whole files.

    Parameters
    ----------
    name
        Of the folder, or what to call one that each process makes for itself.
    is_shared
        Whether all that ask are on this machine, and the folder is there.
    most_bytes
        That a part may take.
    """

    name: str
    is_shared: bool
    most_bytes: int

    def keep(self, kind: str, number: int, part: Any) -> None:
        """Keep a part, records of arrays in one another, if there is room; what is there already is replaced.

        A part is written whole: if the disk is full, nothing of it is left.
        """
        if num_bytes_of(part) > self.most_bytes:
            return
        file = self._file(kind, number)
        beside = file.with_name(f"{file.name}.{os.getpid()}")
        try:
            _write(beside, part)
            beside.replace(file)
        except OSError:
            beside.unlink(missing_ok=True)

    def read(self, kind: str, number: int) -> Any:
        """Read what is kept of a part; None if nothing is."""
        try:
            return _read(self._file(kind, number))
        except FileNotFoundError:
            return None

    def forget(self, kind: str, number: int) -> None:
        """Make room."""
        self._file(kind, number).unlink(missing_ok=True)

    def _file(self, kind: str, number: int) -> Path:
        folder = self.name if self.is_shared else _own_folder(self.name)
        return Path(folder) / f"{kind}-{number}"


def _write(file: Path, part: Any) -> None:
    import joblib

    joblib.dump(part, file)


def _read(file: Path) -> Any:
    import joblib

    return joblib.load(file, mmap_mode="r")


def num_bytes_of(part: Any) -> int:
    """Bytes of the arrays; those that repeat themselves are written out."""
    return sum(map(num_bytes_of, part)) if isinstance(part, tuple) else getattr(part, "nbytes", 0)


@contextmanager
def kept_parts(num_parts: int, is_shared: bool = True) -> Iterator[KeptParts]:
    """Have a place for the parts of a log, for the length of a ``with`` block.

    Parameters
    ----------
    num_parts
        Of the log.
    is_shared
        Whether all workers are on this machine; else each keeps what it has laid out itself, until it has another log.
    """
    with TemporaryDirectory(prefix="halfseen-") as name:
        most = int(MOST_SHARE * shutil.disk_usage(name).free / num_parts)
        yield KeptParts(name if is_shared else uuid4().hex, is_shared, most)


_OWN: dict[str, TemporaryDirectory] = {}


def _own_folder(name: str) -> str:
    """Folder of this process for one log; that of the log before goes."""
    if name not in _OWN:
        while _OWN:
            _OWN.popitem()[1].cleanup()
        _OWN[name] = TemporaryDirectory(prefix="halfseen-")
    return _OWN[name].name
