"""A recording comes back as it was; what is none is told in one line."""

import numpy as np
import pytest
from watched_runs import run

from halfseen.errors import ArgumentError
from halfseen.watch import read_recording, write_recording


def same(one, other):
    if isinstance(one, np.ndarray):
        return one.shape == other.shape and np.allclose(one, other, atol=1e-6)
    if isinstance(one, tuple):
        return len(one) == len(other) and all(same(a, b) for a, b in zip(one, other, strict=True))
    if hasattr(one, "__dataclass_fields__"):
        return all(same(getattr(one, name), getattr(other, name)) for name in one.__dataclass_fields__)
    return one == other


def test_a_recording_comes_back_as_it_was(tmp_path):
    watched = run()
    write_recording(watched, tmp_path / "run")
    assert same(watched, read_recording(tmp_path / "run"))
    assert not same(watched, run(2))


def test_the_same_run_gives_the_same_bytes(tmp_path):
    for name in ("one", "two"):
        write_recording(run(1), tmp_path / name)
    files = sorted(path.name for path in (tmp_path / "one").iterdir())
    assert len(files) == 3
    assert all((tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes() for name in files)


def test_what_is_there_is_not_replaced_unless_that_is_asked_for(tmp_path):
    write_recording(run(1), tmp_path / "run")
    with pytest.raises(ArgumentError, match="--overwrite"):
        write_recording(run(2), tmp_path / "run")
    write_recording(run(2), tmp_path / "run", overwrite=True)
    assert len(read_recording(tmp_path / "run").stages) == 2


def cut_short(folder):
    file = folder / "stage-0002.npz"
    file.write_bytes(file.read_bytes()[:500])


def lacking(folder):
    (folder / "stage-0003.npz").unlink()


def without_words(folder):
    np.savez(folder / "stage-0001.npz", points_m=np.zeros((3, 3)))


def with_objects_of_code(folder):
    np.savez(folder / "stage-0001.npz", words=np.array([{"a": 1}], dtype=object))


@pytest.mark.parametrize("harm", [cut_short, lacking, without_words, with_objects_of_code])
def test_a_broken_recording_is_told(tmp_path, harm):
    write_recording(run(), tmp_path / "run")
    harm(tmp_path / "run")
    with pytest.raises(ArgumentError, match=r"run: not a whole recording .*; record it again"):
        read_recording(tmp_path / "run")
