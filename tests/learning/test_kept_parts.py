"""Parts that are kept on disk come back as they were, and what cannot be kept is laid out anew."""

import numpy as np
import pytest

from halfseen.censoring import StageClocks
from halfseen.learning import kept_parts
from halfseen.learning.kept_parts import KeptParts, num_bytes_of
from halfseen.learning.rows import TrajectoryArrays
from halfseen.learning.sums import Norms
from halfseen.learning.task import Encoded


def part(seed, ids=(2**53, 7)):
    clocks = StageClocks(
        trajectory_ids=np.array(ids, dtype=object if isinstance(ids[0], str) else None),
        elapsed_s=np.array([[1.0, np.nan], [0.5, 2.0]]),
        end_s=np.array([1.5, 2.0]),
        is_finished=np.array([False, True]),
        is_begun=np.broadcast_to(True, (2, 2)),
        covariates=np.zeros((2, 2, 0)),
        covariate_names=("age", "a longer name"),
    )
    encoded = Encoded(np.arange(8.0).reshape(2, 2, 1, 2), np.ones((2, 2, 2), dtype=bool), np.array([[0, 1], [1, 0]]))
    reward = np.random.default_rng(seed).normal(size=(2, 2))
    return TrajectoryArrays(clocks, encoded, np.ones((2, 2), dtype=bool), np.full((2, 2), np.nan), reward)


def assert_same(here, there):
    if isinstance(there, np.ndarray):
        assert here.dtype == there.dtype
        np.testing.assert_array_equal(here, there)
    elif isinstance(there, tuple):
        assert type(here) is type(there)
        for one, other in zip(here, there, strict=True):
            assert_same(one, other)
    else:
        assert here == there


def test_arrays_keep_their_order_in_memory_and_every_kind_of_part_comes_back(tmp_path):
    kept = KeptParts(str(tmp_path), True, 10**6)
    norms = Norms(np.asfortranarray(np.arange(6.0).reshape(2, 3)), (np.zeros(3), np.zeros((0, 2)), None))
    kept.keep("norms", 0, norms)
    found = kept.read("norms", 0)
    assert_same(found, norms)
    assert found[0].flags.f_contiguous
    assert not found[0].flags.writeable


@pytest.mark.parametrize("is_shared", [True, False], ids=["one folder", "one a worker"])
@pytest.mark.parametrize("ids", [("a", "ünïcode"), (2**53, 7)], ids=["texts", "numbers"])
def test_a_part_comes_back_as_it_was_and_nothing_is_left_on_the_disk(is_shared, ids, tmp_path, monkeypatch):
    if is_shared:
        monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with kept_parts.kept_parts(2, is_shared) as kept:
        for number in range(2):
            kept.keep("trajectories", number, part(0, ids))
            kept.keep("trajectories", number, part(number, ids))
            assert_same(kept.read("trajectories", number), part(number, ids))
        kept.forget("trajectories", 1)
        assert kept.read("trajectories", 1) is kept.read("rows", 0) is None
    assert not list(tmp_path.iterdir())


def test_what_has_no_room_is_not_kept(tmp_path):
    size = num_bytes_of(part(0))
    for most, is_kept in ((size - 1, False), (size, True)):
        kept = KeptParts(str(tmp_path), True, most)
        kept.keep("trajectories", 0, part(0))
        assert (kept.read("trajectories", 0) is not None) == is_kept == any(tmp_path.iterdir())
    assert num_bytes_of((np.broadcast_to(0.0, (3, 4)), None, np.zeros(2, dtype=np.int8))) == 3 * 4 * 8 + 2


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()], ids=repr)
def test_what_ends_while_writing_leaves_what_was_there(tmp_path, monkeypatch, error):
    """A disk that is full keeps nothing of a part, and says nothing; who is killed leaves the part of before."""
    kept = KeptParts(str(tmp_path), True, 10**6)
    kept.keep("trajectories", 0, part(0))

    def half_written(file, part):
        file.write_bytes(b"half a part")
        raise error

    monkeypatch.setattr(kept_parts, "_write", half_written)
    try:
        kept.keep("trajectories", 0, part(1))
        assert [file.name for file in tmp_path.iterdir()] == ["trajectories-0"]
    except KeyboardInterrupt:
        assert isinstance(error, KeyboardInterrupt)
    assert_same(kept.read("trajectories", 0), part(0))
