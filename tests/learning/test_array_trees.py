"""Named tuples of arrays come back from files as they were, and nothing else can be written."""

import numpy as np
import pytest

from halfseen.censoring import StageClocks
from halfseen.learning.kept_parts import num_bytes_of, read_tree, write_tree
from halfseen.learning.recursion import Norms
from halfseen.learning.rows import PathArrays
from halfseen.learning.task import Encoded


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
    assert type(here) is type(there)
    if isinstance(here, np.ndarray):
        assert here.dtype == there.dtype
        np.testing.assert_array_equal(here, there)
    elif isinstance(here, tuple):
        assert len(here) == len(there)
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
