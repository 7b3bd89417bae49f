"""Parts that are kept on disk come back as they were, and what cannot be kept is laid out anew."""

import numpy as np
import pytest

from halfseen.censoring import StageClocks
from halfseen.learning import kept_parts
from halfseen.learning.kept_parts import KeptParts, num_bytes_of, read_tree, write_tree
from halfseen.learning.recursion import Norms
from halfseen.learning.rows import PathArrays, Rows
from halfseen.learning.task import Encoded


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
        same(rows, wanted)


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


def paths_named(ids):
    clocks = StageClocks(
        path_ids=ids,
        elapsed_s=np.array([[1.0, np.nan], [0.5, 2.0]]),
        end_s=np.array([1.5, 2.0]),
        is_finished=np.array([False, True]),
        is_begun=np.ones((2, 2), dtype=bool),
        covariates=np.zeros((2, 2, 0)),
        covariate_names=("age", "a longer name"),
    )
    encoded = Encoded(np.arange(8.0).reshape(2, 2, 1, 2), np.ones((2, 2, 2), dtype=bool), np.array([[0, 1], [1, 0]]))
    return PathArrays(clocks, encoded, np.ones((2, 2), dtype=bool), np.full((2, 2), np.nan), np.ones((2, 2)))


def same(here, there):
    if isinstance(there, np.ndarray):
        assert here.dtype == there.dtype
        np.testing.assert_array_equal(here, there)
    elif isinstance(there, tuple):
        assert type(here) is type(there)
        for one, other in zip(here, there, strict=True):
            same(one, other)
    else:
        assert here == there


@pytest.mark.parametrize(
    "tree",
    [
        paths_named(np.array(["a", "ünïcode"], dtype=object)),
        paths_named(np.array([2**53, 7])),
        Norms(np.eye(2)[None], (np.zeros(3), np.zeros(0))),
        (),
        (None, "text", (np.array([True]),)),
        np.array(3.0),
    ],
    ids=["texts", "numbers", "plain tuples", "nothing", "mixed", "one array"],
)
def test_a_tree_comes_back_as_it_was(tree, tmp_path):
    write_tree(tmp_path / "tree", tree)
    same(read_tree(tmp_path / "tree"), tree)


def test_arrays_that_repeat_themselves_count_as_written_out():
    assert num_bytes_of((np.broadcast_to(0.0, (3, 4)), None, np.zeros(2, dtype=np.int8))) == 3 * 4 * 8 + 2


@pytest.mark.parametrize("thing", [[1.0], {"a": 1}, 3, pytest.param(object(), id="an object")], ids=str)
def test_what_is_no_tree_is_refused(thing, tmp_path):
    with pytest.raises(TypeError, match="is no tree of arrays"):
        write_tree(tmp_path / "tree", (thing,))
