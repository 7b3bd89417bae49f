import os
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

import pytest

from halfseen.errors import ArgumentError
from halfseen.writing import left_aside, placed, refuse_unwritable, write_file


@pytest.fixture
def in_the_way(tmp_path):
    file = tmp_path / "file"
    file.write_text("in the way")
    return file


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_file_is_written_with_its_parents_and_replaced(tmp_path):
    file = tmp_path / "a" / "b.txt"
    write_file(file, b"bytes\r\n")
    write_file(file, "größer\n")
    assert file.read_bytes() == "größer\n".encode()
    assert names(file.parent) == ["b.txt"]


def test_a_file_that_cannot_be_written_is_refused_in_one_line(in_the_way):
    with pytest.raises(ArgumentError, match=r"file/b: cannot be written \(File exists\); choose another folder"):
        write_file(in_the_way / "b", "")
    assert names(in_the_way.parent) == ["file"]


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
    with pytest.raises(ArgumentError, match="there already; choose another folder, or move it away"), placed(tmp_path):
        pass


@pytest.mark.parametrize("is_overwritten", [False, True])
def test_what_comes_in_the_meantime_stays(tmp_path, is_overwritten):
    folder = tmp_path / "a"

    def slow():
        with placed(folder, overwrite=is_overwritten, marker="ours") as fresh:
            (fresh / "ours").touch()
            folder.mkdir()
            (folder / "theirs").touch()

    with pytest.raises(ArgumentError, match=r"in the meantime; what is there stays|so it is not replaced"):
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
    for there, told in (("pipe", "a device, a pipe or the like"), (".", "a folder")):
        with pytest.raises(ArgumentError, match=told):
            write_file(tmp_path / there, "")
    (tmp_path / "link").symlink_to("file")
    write_file(tmp_path / "link", "through")
    assert (tmp_path / "file").read_text() == "through"
    assert (tmp_path / "link").is_symlink()


def test_a_name_that_is_too_long_is_refused_in_one_line(tmp_path):
    with pytest.raises(ArgumentError, match=r"File name too long.; choose a shorter name"):
        write_file(tmp_path / ("n" * 300), "")
    with pytest.raises(ArgumentError, match=r"File name too long.; choose a shorter name"):
        refuse_unwritable(tmp_path / ("n" * 300))
