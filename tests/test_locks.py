"""Locks of files, as this system and as Windows has them."""

import os
import sys
from types import SimpleNamespace

import pytest

from halfseen import locks


@pytest.fixture
def descriptors(tmp_path):
    """Of one file, opened twice."""
    file = tmp_path / "file"
    file.write_bytes(b"abc")
    both = [os.open(file, os.O_RDWR | os.O_APPEND) for _ in range(2)]
    yield both
    for each in both:
        os.close(each)


def test_a_lock_keeps_others_out_until_it_is_closed(descriptors):
    one, other = (os.dup(each) for each in descriptors)
    reader = os.open(f"/proc/self/fd/{other}", os.O_RDONLY) if sys.platform == "linux" else os.dup(other)
    assert locks.is_locked(one)
    assert not locks.is_locked(reader)
    assert not locks.is_locked(reader, is_shared=True)
    os.close(one)
    os.close(descriptors[0])
    descriptors[0] = os.dup(other)
    assert locks.is_locked(reader, is_shared=True)
    os.close(other)
    os.close(reader)


def test_shared_locks_go_together(descriptors):
    assert all(locks.is_locked(each, is_shared=True) for each in descriptors)
    assert not locks.is_locked(descriptors[0])


class WindowsLocks:
    """Stands in for `msvcrt`: a lock is of bytes at the place of the descriptor, and is never shared."""

    LK_NBLCK = 2

    def __init__(self):
        self.held = {}

    def locking(self, descriptor, mode, num_bytes):
        assert (mode, num_bytes) == (self.LK_NBLCK, 1)
        place = (os.fstat(descriptor).st_ino, os.lseek(descriptor, 0, os.SEEK_CUR))
        if self.held.setdefault(place, descriptor) != descriptor:
            raise PermissionError(13, "Permission denied")


def test_windows_locks_a_byte_that_nobody_reads(descriptors, monkeypatch):
    windows = WindowsLocks()
    monkeypatch.setitem(sys.modules, "msvcrt", windows)
    monkeypatch.setattr(locks, "sys", SimpleNamespace(platform="win32"))
    assert locks.is_locked(descriptors[0])
    assert not locks.is_locked(descriptors[1])
    assert not locks.is_locked(descriptors[1], is_shared=True)
    assert [place for _, place in windows.held] == [locks.FAR_BYTE]
    os.write(descriptors[0], b"d")
    assert os.pread(descriptors[1], 9, 0) == b"abcd"
    assert os.read(descriptors[0], 0) == b""
