import os

import pytest

from halfseen.errors import ArgumentError
from halfseen.logs import Logs, read_logs
from halfseen.logs import folder as on_disk
from valid_logs import assert_same, small_tables


@pytest.fixture
def logs():
    return Logs(**small_tables())


@pytest.fixture
def folder(tmp_path, logs):
    logs.write(tmp_path / "logs")
    return tmp_path / "logs"


def test_the_same_log_gives_the_same_bytes(tmp_path):
    tables = small_tables()
    Logs(**tables).write(tmp_path / "a")
    Logs(**{name: frame[::-1] for name, frame in tables.items()}).write(tmp_path / "b")
    names = sorted(os.listdir(tmp_path / "a"))
    assert names == ["logs.json", "objects.parquet", "stages.parquet", "trajectories.parquet"]
    for name in names:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_text_and_path_name_the_same_folder(tmp_path, logs, monkeypatch):
    monkeypatch.chdir(tmp_path)
    logs.write("deep/er/a=1")
    assert_same(logs, read_logs("deep/er/a=1"))


def test_overwrite_replaces_the_whole_folder(folder, logs):
    Logs(logs.stages, logs.trajectories).write(folder, overwrite=True)
    assert read_logs(folder).objects is None
    assert not (folder / "objects.parquet").exists()
    assert os.listdir(folder.parent) == ["logs"]
    with pytest.raises(ArgumentError, match=r"it is there already; .* pass --overwrite \(overwrite=True\)"):
        logs.write(folder)


def test_overwrite_never_replaces_what_is_no_log(tmp_path, logs):
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(ArgumentError, match="it holds no logs"):
        logs.write(tmp_path, overwrite=True)
    assert (tmp_path / "thesis.tex").read_text() == "years of work"


def test_an_overwrite_that_fails_leaves_what_was_there(tmp_path, folder, logs, monkeypatch):
    def full_disk(*args, **kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(on_disk.pq, "write_table", full_disk)
    with pytest.raises(ArgumentError, match=r"cannot be written .No space left on device"):
        logs.write(folder, overwrite=True)
    assert os.listdir(tmp_path) == ["logs"]
    assert_same(read_logs(folder), logs)


def test_old_logs_come_back_when_the_new_ones_cannot_be_put_in_place(folder, logs, monkeypatch):
    rename = on_disk.Path.rename

    def refuse_new(self, target):
        if self.name.endswith(".new"):
            raise OSError(5, "Input/output error")
        return rename(self, target)

    monkeypatch.setattr(on_disk.Path, "rename", refuse_new)
    with pytest.raises(ArgumentError, match="Input/output error"):
        logs.write(folder, overwrite=True)
    assert os.listdir(folder.parent) == ["logs"]
    assert_same(read_logs(folder), logs)


def test_a_file_where_the_folder_should_go(tmp_path, logs):
    (tmp_path / "file").write_text("")
    with pytest.raises(ArgumentError, match="cannot be written"):
        logs.write(tmp_path / "file" / "logs")
    with pytest.raises(ArgumentError, match="it is there already"):
        logs.write(tmp_path / "file")
