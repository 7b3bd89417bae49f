"""Parts that are kept on disk come back as they were, and where there is no room they are laid out anew."""

import shutil
from collections import namedtuple

import numpy as np
import pytest

from halfseen.learners.q_learning import kept_parts
from halfseen.learners.q_learning.kept_parts import kept
from halfseen.learners.q_learning.transitions import Transitions


def part(seed):
    rng = np.random.default_rng(seed)
    return Transitions(
        features=rng.normal(size=(4, 3, 2, 5)),
        is_possible=rng.random((4, 3, 2)) < 0.7,
        action=rng.integers(0, 2, (4, 3)),
        reward=rng.normal(size=(4, 3)),
        weight=rng.random((4, 3)),
        is_last=rng.random((4, 3)) < 0.2,
        fold=rng.integers(0, 5, 4),
    )


@pytest.fixture
def parts():
    """Three parts, and how often each was laid out."""
    laid_out = []

    def read():
        for seed in range(3):
            laid_out.append(seed)
            yield part(seed)

    return read, laid_out


def assert_same(read):
    for found, wanted in zip(read(), map(part, range(3)), strict=True):
        for here, there in zip(found, wanted, strict=True):
            np.testing.assert_array_equal(here, there)
            assert getattr(here, "dtype", None) == getattr(there, "dtype", None)


def test_the_log_is_laid_out_once_and_read_back_as_it_was(parts):
    anew, laid_out = parts
    with kept(anew, 3) as read:
        for _ in range(3):
            assert_same(read)
    assert laid_out == [0, 1, 2]


def test_a_reader_that_stops_halfway_spoils_nothing(parts):
    anew, laid_out = parts
    with kept(anew, 3) as read:
        next(read())
        for _ in range(2):
            assert_same(read)
    assert laid_out == [0, 0, 1, 2]


@pytest.mark.parametrize("why", ["too large", "no room"])
def test_what_has_no_room_is_laid_out_in_each_pass(parts, monkeypatch, why):
    anew, laid_out = parts
    if why == "too large":
        monkeypatch.setattr(kept_parts, "MOST_KEPT_BYTES", 100)
    else:
        usage = namedtuple("usage", "total used free")(10, 10, 0)
        monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    with kept(anew, 3) as read:
        for _ in range(2):
            assert_same(read)
    assert laid_out == [0, 1, 2, 0, 1, 2]


def test_a_disk_that_fills_up_on_the_way_is_made_room_on(parts, monkeypatch, tmp_path):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    anew, laid_out = parts
    save, num_saved = np.save, []

    def until_full(*told, **more):
        num_saved.append(1)
        if len(num_saved) > 10:  # in the middle of the second part
            raise OSError(28, "No space left on device")
        save(*told, **more)

    monkeypatch.setattr(np, "save", until_full)
    with kept(anew, 3) as read:
        assert_same(read)
        assert [path for path in tmp_path.rglob("*") if path.is_file()] == []
        num_saved.clear()
        monkeypatch.setattr(np, "save", save)
        for _ in range(2):
            assert_same(read)
    assert laid_out == [0, 1, 2, 0, 1, 2]


def test_nothing_is_left_on_the_disk(parts, monkeypatch, tmp_path):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    anew, _ = parts
    with kept(anew, 3) as read:
        assert_same(read)
        assert list(tmp_path.iterdir())
    assert not list(tmp_path.iterdir())
