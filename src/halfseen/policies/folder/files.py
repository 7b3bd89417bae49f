"""Atomic writing and checked reading of the folder of a policy, or of a similar object."""

import hashlib
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

from halfseen.errors import ArgumentError, PolicyError
from halfseen.reading import NUMBERS, read_bytes
from halfseen.writing import left_aside, placed, refuse_taken


class FolderKind(NamedTuple):
    """What a folder holds."""

    name: str
    """Stem of its file names."""
    maker: str
    """The command that writes the folder."""

    @property
    def record(self) -> str:
        """The text file."""
        return f"{self.name}.json"

    @property
    def arrays(self) -> str:
        """The file of numbers."""
        return f"{self.name}.safetensors"

    @property
    def digests(self) -> str:
        """The file with the digests of both."""
        return f"{self.name}.sha256"


POLICY = FolderKind("policy", "halfseen learn")
RECORD, ARRAYS, DIGESTS = POLICY.record, POLICY.arrays, POLICY.digests


def check_target(folder: Path, overwrite: bool, kind: FolderKind = POLICY) -> None:
    """Refuse a folder that cannot be written to; to be called before long work.

    Raises
    ------
    ArgumentError
        The folder exists and may not be replaced, is of another kind, or also holds a recorded log.
    """
    from halfseen.logs.journal import JOURNAL

    refuse_taken(folder, overwrite, kind.record, kind.name)
    if (folder / JOURNAL).exists():
        raise ArgumentError(f"{folder}: it also holds a recorded log, {JOURNAL}, which would be lost; move that away")


def write_files(
    folder: Path,
    record: bytes,
    arrays: bytes,
    *,
    overwrite: bool,
    kind: FolderKind = POLICY,
    beside: Mapping[str, Callable[[Path], None]] = MappingProxyType({}),
) -> None:
    """Write the files to a temporary folder, then rename it to `folder`; `beside` writes further files.

    Raises
    ------
    ArgumentError
        The folder exists, holds something of another kind, or cannot be written.
    """
    with placed(folder, overwrite=overwrite, marker=kind.record, kind=kind.name) as fresh:
        (fresh / kind.arrays).write_bytes(arrays)
        (fresh / kind.record).write_bytes(record)
        (fresh / kind.digests).write_bytes(_digests(record, arrays, kind))
        for name, write in beside.items():
            write(fresh / name)


def read_files(folder: Path, kind: FolderKind = POLICY) -> tuple[bytes, bytes]:
    """Read the record and the arrays.

    Raises
    ------
    PolicyError
        The folder or a file is missing or cannot be read, or a byte of a file has changed.
    """
    if not folder.is_dir():
        raise PolicyError(f"{folder}: no such folder; {_remedy(folder, kind)}")
    record, arrays, digests = (_read(folder / name, kind) for name in (kind.record, kind.arrays, kind.digests))
    if digests == _digests(record, arrays, kind):
        return record, arrays
    files = ((kind.record, record), (kind.arrays, arrays))
    changed = [name for name, data in files if _line(name, data) not in digests]
    raise PolicyError(
        f"{folder / (changed or [kind.digests])[0]}: it was changed after it was written (its SHA-256 does not agree "
        f"with {kind.digests}); copy the whole folder again, or make it again with `{kind.maker}`"
    )


def _remedy(folder: Path, kind: FolderKind) -> str:
    """Remedy for a missing folder."""
    aside = left_aside(folder)
    if aside is None:
        return f"give the folder that `{kind.maker}` wrote"
    return f"replacing it was interrupted, and the previous folder is {aside}: rename it back"


def _digests(record: bytes, arrays: bytes, kind: FolderKind) -> bytes:
    return _line(kind.record, record) + _line(kind.arrays, arrays)


def _line(name: str, data: bytes) -> bytes:
    return f"{hashlib.sha256(data).hexdigest()}  {name}\n".encode()


def _read(file: Path, kind: FolderKind) -> bytes:
    try:
        return read_bytes(file, NUMBERS)
    except FileNotFoundError as error:
        raise PolicyError(
            f"{file}: it is missing, so {file.parent} is not a complete {kind.name}; copy the whole folder again, or "
            f"make it again with `{kind.maker}`"
        ) from error
    except OSError as error:
        raise PolicyError(f"{file}: it cannot be read ({error.strerror}); copy the whole folder again") from error
