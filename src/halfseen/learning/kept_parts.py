"""Parts of a log as they are laid out, kept on disk between passes: reading and checking them takes longest.

What cannot be kept is no loss but of time: whoever asks lays it out anew, to the same bytes. The folder is private to
the user and gone after the passes; its arrays are mapped, so that a pass reads no more of them than it looks at.
"""

import json
import math
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from uuid import uuid4

import numpy as np

from halfseen.censoring import StageClocks
from halfseen.learning.rows import TrajectoryArrays
from halfseen.learning.sums import Columns, Rows, StateChoices
from halfseen.learning.task import Encoded
from halfseen.learning.values import Norms

KINDS: dict[str, Any] = {
    kind.__name__: kind for kind in (TrajectoryArrays, StageClocks, Encoded, Rows, Columns, StateChoices, Norms, tuple)
}
"""Records that a part is made of."""
ALIGNED = 64
"""Bytes; every array begins at a multiple."""
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
    """Write a line of JSON, which says what lies in what, and then the bytes of the arrays."""
    leaves: list[np.ndarray] = []
    head = json.dumps(_described(part, leaves)).encode()
    with file.open("wb") as opened:
        opened.write(head + b" " * (-(len(head) + 1) % ALIGNED) + b"\n")
        for leaf in leaves:
            opened.write(np.ascontiguousarray(leaf).data)
            opened.write(bytes(-leaf.nbytes % ALIGNED))


def _described(part: Any, leaves: list[np.ndarray]) -> Any:
    if type(part) in KINDS.values():
        return {type(part).__name__: [_described(each, leaves) for each in part]}
    if not isinstance(part, np.ndarray):
        return part
    if part.dtype == object:
        return {"texts": part.tolist()}
    by_column = part.flags.f_contiguous and not part.flags.c_contiguous
    leaves.append(part.T if by_column else part)
    return {"array": [part.dtype.str, part.shape, "F" if by_column else "C"]}


def _read(file: Path) -> Any:
    with file.open("rb") as opened:
        head = opened.readline()
    data, at = np.memmap(file, np.uint8, "r"), len(head)

    def built(described: Any) -> Any:
        nonlocal at
        if not isinstance(described, dict):
            return described
        ((kind, held),) = described.items()
        if kind == "texts":
            return np.array(held, dtype=object)
        if kind != "array":
            return tuple(map(built, held)) if kind == "tuple" else KINDS[kind](*map(built, held))
        dtype, shape, order = np.dtype(held[0]), tuple(held[1]), held[2]
        num_bytes = dtype.itemsize * math.prod(shape)
        leaf = data[at : at + num_bytes].view(dtype).reshape(shape, order=order)
        at += num_bytes + -num_bytes % ALIGNED
        return leaf

    return built(json.loads(head))


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
