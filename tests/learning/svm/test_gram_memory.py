from types import SimpleNamespace

import pytest

from halfseen.errors import ArgumentError
from halfseen.learning.svm import spaces
from halfseen.learning.svm.spaces import advised_landmarks, check_gram_fits, free_bytes

GB = 10**9


def test_message_says_what_is_needed_what_is_free_and_what_would_fit():
    with pytest.raises(ArgumentError) as refusal:
        check_gram_fits(200_000, available_bytes=20 * GB)
    assert str(refusal.value) == (
        "the kernel matrix of 200,000 rows takes 960 GB and 20 GB are free; "
        "give num_landmarks=1000 (a low-rank kernel, 1.6 GB), or kernel='linear'"
    )


@pytest.mark.parametrize("num_buffers", [1, 3])
def test_exactly_what_fits_is_accepted(num_buffers):
    needed = 8 * num_buffers * 1000**2
    check_gram_fits(1000, num_buffers, needed)
    with pytest.raises(ArgumentError, match="1,000 rows"):
        check_gram_fits(1000, num_buffers, needed - 1)


def test_without_memory_for_landmarks_only_the_linear_kernel_is_advised():
    with pytest.raises(ArgumentError, match=r"free; give kernel='linear'$"):
        check_gram_fits(10**9, available_bytes=GB)


@pytest.mark.parametrize("num_rows", [1, 30, 1234, 200_000, 10**7])
@pytest.mark.parametrize("available", [10**4, 10**7, 20 * GB])
def test_advised_landmarks_fit_and_twice_as_many_are_too_many(num_rows, available):
    landmarks = advised_landmarks(num_rows, available)
    assert 8 * num_rows * landmarks <= available / 2
    too_many = 2 * landmarks if landmarks else 1
    assert landmarks <= min(1000, num_rows)
    assert too_many > min(1000, num_rows) or 8 * num_rows * too_many > available / 2


def test_reads_what_the_machine_and_its_container_have(tmp_path, monkeypatch):
    assert free_bytes() > 10**6
    limit, machine = tmp_path / "memory.max", SimpleNamespace(available=32 * 1024)
    monkeypatch.setattr(spaces.psutil, "virtual_memory", lambda: machine)
    monkeypatch.setattr(spaces, "CONTAINER_LIMIT", limit)
    assert free_bytes() == 32 * 1024
    limit.write_text("max\n")
    assert free_bytes() == 32 * 1024
    limit.write_text("1000\n")
    assert free_bytes() == 1000
    with pytest.raises(ArgumentError, match="1 kB are free"):
        check_gram_fits(1000)
