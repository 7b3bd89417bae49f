"""Parts of a log as they are laid out, kept on disk between passes: reading and checking them takes longest."""

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import jax
import numpy as np

from halfseen.learners.q_learning.transitions import Transitions

MOST_KEPT_BYTES = 32 << 30
"""Logs that take more than this are laid out anew in each pass."""
MOST_SHARE = 0.5
"""Of the room that there is on the disk."""

Parts = Callable[[], Iterator[Transitions]]
"""Reads the log once more, from its beginning."""


@contextmanager
def kept(parts: Parts, num_parts: int) -> Iterator[Parts]:
    """Keep parts while they are read for the first time, and read them from there after that.

    Parameters
    ----------
    parts
        Lays out the log.
    num_parts
        In how many parts, which are about as large as the first.

    Yields
    ------
    callable
        The same arrays, as often as they are asked for. Where there is no room for all, each pass lays them out anew.
    """
    with TemporaryDirectory(prefix="halfseen-") as name:
        yield _Kept(parts, num_parts, Path(name)).read


class _Kept:
    def __init__(self, parts: Parts, num_parts: int, folder: Path) -> None:
        self._parts, self._num_parts, self._folder = parts, num_parts, folder
        self._structure, self._files, self._is_whole = None, [], False

    def read(self) -> Iterator[Transitions]:
        """Read all parts once."""
        if self._is_whole:
            yield from map(self._load, self._files)
            return
        self._files.clear()
        has_room = None
        for part in self._parts():
            if has_room is None:
                has_room = self._has_room(part)
            has_room = has_room and self._is_saved(part)
            yield part
        self._is_whole = bool(has_room)

    def _has_room(self, first: Transitions) -> bool:
        num_bytes = self._num_parts * sum(np.asarray(leaf).nbytes for leaf in jax.tree.leaves(first))
        return num_bytes <= min(MOST_KEPT_BYTES, MOST_SHARE * shutil.disk_usage(self._folder).free)

    def _is_saved(self, part: Transitions) -> bool:
        """Keep a part; if the disk is full by now, keep none."""
        leaves, self._structure = jax.tree.flatten(part)
        self._files.append(self._folder / f"{len(self._files)}.npy")
        try:
            with self._files[-1].open("wb") as file:
                for leaf in leaves:
                    np.save(file, np.asarray(leaf), allow_pickle=False)
        except OSError:
            for file in self._files:
                file.unlink(missing_ok=True)
            return False
        return True

    def _load(self, path: Path) -> Transitions:
        assert self._structure is not None
        with path.open("rb") as file:
            leaves = [np.load(file, allow_pickle=False) for _ in range(self._structure.num_leaves)]
        return jax.tree.unflatten(self._structure, leaves)
