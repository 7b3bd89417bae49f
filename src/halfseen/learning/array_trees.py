"""Named tuples of arrays, one in another, as files of plain arrays: what is read can do nothing but hold numbers.

A file begins with what lies in what, as JSON in an array of text, and the arrays follow as NumPy writes them.
"""

import json
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from halfseen.censoring import StageClocks
from halfseen.learning.path_arrays import PathArrays
from halfseen.learning.rows import Rows, StateChoices
from halfseen.learning.state_values import Norms
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
