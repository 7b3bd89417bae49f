"""Parts that are kept on disk come back as they were, and what cannot be kept is laid out anew."""

import numpy as np
import pytest

from halfseen.learning import kept_parts
from halfseen.learning.kept_parts import KeptParts, num_bytes_of
from halfseen.learning.rows import Rows


def rows_of(seed):
    rng = np.random.default_rng(seed)
    return Rows(
        matrix=rng.normal(size=(9, 4)),
        reward=rng.normal(size=9),
        weight=rng.random(9),
        after=rng.integers(0, 10, 9),
        groups=np.array([[0, 0, 0, 0, 9]]),
        widths=np.array([4, 0, 0, 0]),
        share=None,
        outcome_weight=None,
        is_used=None,
        is_possible=None,
        block_of_action=np.arange(2),
        choices=None,
    )


class Maker:
    """Makes parts, and notes which."""

    def __init__(self):
        self.made = []

    def __call__(self, number):
        self.made.append(number)
        return rows_of(number)


def read_all(kept, maker):
    found = [kept.found("rows", number, lambda number=number: maker(number)) for number in range(3)]
    for rows, wanted in zip(found, map(rows_of, range(3)), strict=True):
        for here, there in zip(rows, wanted, strict=True):
            np.testing.assert_array_equal(here, there)
            assert getattr(here, "dtype", None) == getattr(there, "dtype", None)


@pytest.mark.parametrize("is_shared", [True, False], ids=["one folder", "one a worker"])
def test_a_part_is_made_once_and_read_back_as_it_was(is_shared):
    maker = Maker()
    with kept_parts.kept_parts(3, is_shared) as kept:
        for _ in range(3):
            read_all(kept, maker)
        assert maker.made == [0, 1, 2]
        kept.forget("rows", 1)
        assert kept.read("rows", 1) is None
        read_all(kept, maker)
    assert maker.made == [0, 1, 2, 1]


def test_what_has_no_room_is_made_in_each_pass(tmp_path):
    maker, size = Maker(), num_bytes_of(rows_of(0))
    assert size == sum(leaf.nbytes for leaf in rows_of(0) if leaf is not None)
    for _ in range(2):
        read_all(KeptParts(str(tmp_path), True, size - 1), maker)
    assert maker.made == [0, 1, 2, 0, 1, 2]
    assert list(tmp_path.iterdir()) == []
    for _ in range(2):
        read_all(KeptParts(str(tmp_path), True, size), maker)
    assert maker.made == [0, 1, 2, 0, 1, 2, 0, 1, 2]


def test_a_disk_that_is_full_keeps_nothing_of_a_part(tmp_path, monkeypatch):
    maker, kept, write = Maker(), KeptParts(str(tmp_path), True, 10**6), kept_parts.write_tree

    def until_full(file, tree):
        write(file, tree)
        if "rows-1" in file.name:
            file.write_bytes(file.read_bytes()[:7])
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(kept_parts, "write_tree", until_full)
    for _ in range(2):
        read_all(kept, maker)
    assert maker.made == [0, 1, 2, 1]
    assert not [file for file in tmp_path.iterdir() if "rows-1" in file.name]


def test_nothing_is_left_on_the_disk(monkeypatch, tmp_path):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with kept_parts.kept_parts(3) as kept:
        read_all(kept, Maker())
        assert list(tmp_path.iterdir())
    assert not list(tmp_path.iterdir())


def test_who_is_killed_while_writing_leaves_what_was_there(monkeypatch):
    with kept_parts.kept_parts(1) as kept:
        kept.keep("rows", 0, rows_of(0))

        def killed(file, *_, **__):
            file.write_bytes(b"half a matrix")
            raise KeyboardInterrupt

        monkeypatch.setattr(np, "save", killed)
        with pytest.raises(KeyboardInterrupt):
            kept.keep("rows", 0, rows_of(1))
        monkeypatch.undo()
        np.testing.assert_array_equal(kept.read("rows", 0).matrix, rows_of(0).matrix)
