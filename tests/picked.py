"""Some rows of what was played."""

import numpy as np

from halfseen.arrays import mapped


def picked(tree, at):
    """The same tree, each leaf at an index."""
    return mapped(lambda leaf: leaf[at], tree)


def leaves_of(tree):
    """All arrays and numbers of a record, in order."""
    found = []

    def keep(leaf):
        found.append(leaf)
        return leaf

    mapped(keep, tree)
    return found


def assert_same(one, other):
    """All arrays and numbers of two records are equal."""
    for left, right in zip(leaves_of(one), leaves_of(other), strict=True):
        np.testing.assert_array_equal(left, right)


def repeated(tree, num):
    """A batch of so many that are all alike."""
    return mapped(lambda leaf: np.repeat(np.asarray(leaf)[None], num, axis=0), tree)
