"""Files and folders that are there whole or not at all; and locks, as this system and as Windows has them."""

import os
import sys
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier
from types import SimpleNamespace

import pytest

from halfseen import writing
from halfseen.errors import ArgumentError
from halfseen.writing import is_locked, left_aside, placed, refuse_unwritable, write_file


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_file_is_written_with_its_parents_and_replaced(tmp_path):
    file = tmp_path / "a" / "b.txt"
    write_file(file, b"bytes\r\n")
    write_file(file, "größer\n")
    assert file.read_bytes() == "größer\n".encode()
    assert names(file.parent) == ["b.txt"]


def test_what_was_there_stays_when_the_new_file_does_not_fit(tmp_path, monkeypatch):
    file = tmp_path / "a"
    write_file(file, "old")

    def is_full(fresh, content):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.write_bytes", is_full)
    with pytest.raises(ArgumentError, match="No space left on device"):
        write_file(file, "new")
    assert (file.read_text(), names(tmp_path)) == ("old", ["a"])


def test_threads_of_one_process_do_not_write_into_each_other(tmp_path):
    file, texts = tmp_path / "a", [str(k) * 200_000 for k in range(8)]
    with ThreadPoolExecutor(8) as threads:
        list(threads.map(lambda text: [write_file(file, text) for _ in range(5)], texts))
    assert file.read_text() in texts
    assert names(tmp_path) == ["a"]


def test_a_folder_is_there_whole_or_not_at_all(tmp_path):
    folder = tmp_path / "a" / "b"

    def fill(error=None):
        with placed(folder) as fresh:
            (fresh / "part").touch()
            assert not folder.exists()
            if error is not None:
                raise error

    with pytest.raises(KeyError):
        fill(KeyError())
    assert names(folder.parent) == []
    fill()
    assert names(folder.parent) + names(folder) == ["b", "part"]


def test_what_a_kill_left_aside_is_found(tmp_path):
    assert left_aside(tmp_path / "a[1]") is None
    (tmp_path / ".a[1].0f.old").mkdir()
    assert left_aside(tmp_path / "a[1]") == tmp_path / ".a[1].0f.old"


def test_a_folder_without_a_marker_is_never_replaced(tmp_path):
    with (
        pytest.raises(ArgumentError, match="it already exists; choose another folder, or move it away"),
        placed(tmp_path),
    ):
        pass


@pytest.mark.parametrize("is_overwritten", [False, True])
def test_what_comes_in_the_meantime_stays(tmp_path, is_overwritten):
    folder = tmp_path / "a"

    def slow():
        with placed(folder, overwrite=is_overwritten, marker="ours") as fresh:
            (fresh / "ours").touch()
            folder.mkdir()
            (folder / "theirs").touch()

    with pytest.raises(ArgumentError, match=r"in the meantime, and it is kept|so it is not replaced"):
        slow()
    assert (names(tmp_path), names(folder)) == (["a"], ["theirs"])


def test_of_many_that_write_one_folder_exactly_one_does(tmp_path):
    gate = Barrier(6)

    def write(number):
        with placed(tmp_path / "a") as fresh:
            (fresh / str(number)).touch()
            gate.wait()
        return number

    with ThreadPoolExecutor(6) as threads:
        asked = [threads.submit(write, number) for number in range(6)]
    refused = [each for each in asked if isinstance(each.exception(), ArgumentError)]
    (number,) = (each.result() for each in asked if each not in refused)
    assert (names(tmp_path), names(tmp_path / "a")) == (["a"], [str(number)])


def test_no_device_is_replaced_and_a_link_goes_on_pointing(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for there, message in (("pipe", "a device, a pipe or the like"), (".", "a folder")):
        with pytest.raises(ArgumentError, match=message):
            write_file(tmp_path / there, "")
    (tmp_path / "link").symlink_to("file")
    write_file(tmp_path / "link", "through")
    assert (tmp_path / "file").read_text() == "through"
    assert (tmp_path / "link").is_symlink()


@pytest.mark.parametrize("refused", [lambda file: write_file(file, ""), refuse_unwritable])
def test_a_name_that_is_too_long_is_refused_in_one_line(tmp_path, refused):
    with pytest.raises(ArgumentError, match=r"File name too long.; choose a shorter name"):
        refused(tmp_path / ("n" * 300))


def test_a_file_that_cannot_be_written_is_refused_in_one_line(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(ArgumentError, match=r"file/b: cannot be written \(File exists\); choose another folder"):
        write_file(tmp_path / "file" / "b", "")
    assert names(tmp_path) == ["file"]


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
    assert is_locked(one)
    assert not is_locked(reader)
    assert not is_locked(reader, is_shared=True)
    os.close(one)
    os.close(descriptors[0])
    descriptors[0] = os.dup(other)
    assert is_locked(reader, is_shared=True)
    os.close(other)
    os.close(reader)


def test_shared_locks_go_together(descriptors):
    assert all(is_locked(each, is_shared=True) for each in descriptors)
    assert not is_locked(descriptors[0])


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
    monkeypatch.setattr(writing, "sys", SimpleNamespace(platform="win32"))
    assert is_locked(descriptors[0])
    assert not is_locked(descriptors[1])
    assert not is_locked(descriptors[1], is_shared=True)
    assert [place for _, place in windows.held] == [writing.FAR_BYTE]
    os.write(descriptors[0], b"d")
    assert os.pread(descriptors[1], 9, 0) == b"abcd"
    assert os.read(descriptors[0], 0) == b""
