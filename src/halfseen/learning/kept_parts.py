"""Parts of a log as they are laid out, kept on disk between passes: reading and checking them takes longest.

What cannot be kept is no loss but of time: whoever asks lays it out anew, to the same bytes. A file holds named tuples
of arrays, one in another: first what lies in what, as JSON in an array of text, then the arrays as NumPy writes them.
What is read can do nothing but hold numbers.
"""

import json
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias
from uuid import uuid4

import numpy as np

from halfseen.censoring import StageClocks
from halfseen.learning.recursion import Norms
from halfseen.learning.rows import PathArrays, Rows, StateChoices
from halfseen.learning.task import Encoded

Tree: TypeAlias = Any
"""None, a text, an array, or a tuple of trees: a plain one, or one of `KINDS`."""

KINDS = {kind.__name__: kind for kind in (PathArrays, StageClocks, Encoded, Rows, StateChoices, Norms)}


def num_bytes_of(tree: Tree) -> int:
    """Bytes of the arrays; those that repeat themselves are written out."""
    return sum(leaf.nbytes for leaf in _taken_apart(tree)[1])


def write_tree(file: Path, tree: Tree) -> None:
    """Write a tree.

    Raises
    ------
    OSError
        The disk is full, say; what is written then is no tree.
    """
    nested, leaves = _taken_apart(tree)
    with file.open("wb") as opened:
        np.save(opened, np.array(json.dumps(nested)), allow_pickle=False)
        for leaf in leaves:
            # Texts of an index are objects to pandas; they say how long they are where they are written.
            np.save(opened, leaf.astype(str) if leaf.dtype == object else leaf, allow_pickle=False)


def read_tree(file: Path) -> Tree:
    """Read what `write_tree` has written; texts come back as objects.

    Raises
    ------
    FileNotFoundError
        There is none.
    """
    with file.open("rb") as opened:
        nested = json.loads(str(np.load(opened, allow_pickle=False)))

        def built(told: Any) -> Tree:
            if told is None or isinstance(told, str):
                return told
            if told == {}:
                leaf = np.load(opened, allow_pickle=False)
                return leaf.astype(object) if leaf.dtype.kind == "U" else leaf
            ((kind, parts),) = told.items()
            children = tuple(map(built, parts))
            return KINDS[kind](*children) if kind in KINDS else children

        return built(nested)


def _taken_apart(tree: Tree) -> tuple[Any, list[np.ndarray]]:
    """What lies in what, an array being ``{}``; and the arrays in that order."""
    if tree is None or isinstance(tree, str):
        return tree, []
    if isinstance(tree, np.ndarray):
        return {}, [tree]
    if not isinstance(tree, tuple) or type(tree) is not KINDS.get(type(tree).__name__, tuple):
        raise TypeError(f"{type(tree).__name__} is no tree of arrays")
    parts = [_taken_apart(part) for part in tree]
    return {type(tree).__name__: [nested for nested, _ in parts]}, [leaf for _, leaves in parts for leaf in leaves]


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

    def found(self, kind: str, number: int, anew: Callable[[], Tree]) -> Tree:
        """Read a part, or make it and keep it, where there is room."""
        file = self._folder / f"{kind}-{number}"
        known = _read(file)
        if known is not None:
            return known
        made = anew()
        self.keep(kind, number, made)
        return made

    def keep(self, kind: str, number: int, part: Tree) -> None:
        """Keep a part, if there is room; what is there already is replaced."""
        if num_bytes_of(part) <= self.most_bytes:
            _write(self._folder / f"{kind}-{number}", part)

    def read(self, kind: str, number: int) -> Tree:
        """Read what is kept of a part; None if nothing is."""
        return _read(self._folder / f"{kind}-{number}")

    def forget(self, kind: str, number: int) -> None:
        """Make room."""
        file = self._folder / f"{kind}-{number}"
        for each in (file, _matrix_of(file)):
            each.unlink(missing_ok=True)

    @property
    def _folder(self) -> Path:
        return Path(self.name if self.is_shared else _own_folder(self.name).name)


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


@lru_cache(maxsize=1)
def _own_folder(name: str) -> TemporaryDirectory:
    return TemporaryDirectory(prefix="halfseen-")


def _write(file: Path, part: Tree) -> None:
    """Write a part whole; if the disk is full, nothing of it is left."""
    matrix = None
    if isinstance(part, Rows):
        # Most of it is read by slices and not at all in others, so it has a file of its own.
        matrix, part = part.matrix, part._replace(matrix=np.zeros((0, 0)))
    beside = file.with_name(f"{file.name}.{os.getpid()}")
    try:
        if matrix is not None:
            np.save(_matrix_of(beside), matrix, allow_pickle=False)
            _matrix_of(beside).replace(_matrix_of(file))
        write_tree(beside, part)
        beside.replace(file)
    except OSError:
        for each in (beside, _matrix_of(beside), _matrix_of(file)):
            each.unlink(missing_ok=True)


def _read(file: Path) -> Tree:
    try:
        part = read_tree(file)
        if isinstance(part, Rows):
            part = part._replace(matrix=np.load(_matrix_of(file), mmap_mode="r", allow_pickle=False))
    except FileNotFoundError:
        return None
    return part


def _matrix_of(file: Path) -> Path:
    return file.with_name(f"{file.name}.npy")
