"""What is said of a stage; a recording comes back as it was, and what is none is told in one line."""

from dataclasses import replace

import numpy as np
import pytest
from watched_runs import run, stage

from halfseen.errors import ArgumentError
from halfseen.view.recording import read_recording, write_recording
from halfseen.view.stage_view import stage_html


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
    for name in ("one", "two"):
        write_recording(watched, tmp_path / name)
    assert same(watched, read_recording(tmp_path / "one"))
    assert not same(watched, run(2))
    one, two = ({file.name: file.read_bytes() for file in (tmp_path / name).iterdir()} for name in ("one", "two"))
    assert one == two


def test_what_is_there_is_not_replaced_unless_that_is_asked_for(tmp_path):
    write_recording(run(1), tmp_path / "run")
    with pytest.raises(ArgumentError, match="--overwrite"):
        write_recording(run(2), tmp_path / "run")
    write_recording(run(2), tmp_path / "run", overwrite=True)
    assert len(read_recording(tmp_path / "run").stages) == 2


HARMS = {
    "stage-0002.npz": lambda file: file.write_bytes(file.read_bytes()[:500]),
    "stage-0003.npz": lambda file: file.unlink(),
    "stage-0001.npz": lambda file: np.savez(file, points_m=np.zeros((3, 3))),
    "stage-0001.npz with code": lambda file: np.savez(file, words=np.array([{"a": 1}], dtype=object)),
}


@pytest.mark.parametrize("harm", HARMS)
def test_a_broken_recording_is_told(tmp_path, harm):
    write_recording(run(), tmp_path / "run")
    HARMS[harm](tmp_path / "run" / harm.split()[0])
    with pytest.raises(ArgumentError, match=r"run: not a whole recording .*; record it again"):
        read_recording(tmp_path / "run")


def test_a_stage_says_what_is_done_why_and_what_else_there_was():
    html = stage_html(stage(2))
    for words in ("stage 2 of 3", "+2.50", "+1.00 to +4.00", "80%", "it may be doubted", "tried: 2", "(out of view)"):
        assert words in html
    assert "<strong>LIFT 0</strong>" in html
    assert "<strong>FINISH</strong>" not in html


def test_nothing_that_is_said_is_taken_for_html():
    html = stage_html(replace(stage(1), reason="<script>alert(1)</script>", events=("<img src=x>",)))
    assert "<script>" not in html
    assert "<img" not in html
