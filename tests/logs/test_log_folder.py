import os
from pathlib import Path

import pytest

from halfseen.errors import ArgumentError
from halfseen.logs import Logs, read_logs
from valid_logs import assert_same, small_tables


@pytest.fixture
def logs():
    return Logs(**small_tables())


@pytest.fixture
def folder(tmp_path, logs):
    logs.write(tmp_path / "logs")
    return tmp_path / "logs"


def test_the_same_log_gives_the_same_bytes_and_text_names_a_folder(logs, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    logs.write(tmp_path / "a")
    Logs(**{name: frame[::-1] for name, frame in small_tables().items()}).write("deep/er/b=1")
    names = sorted(os.listdir("a"))
    assert names == ["logs.json", "objects.parquet", "stages.parquet", "trajectories.parquet"]
    for name in names:
        assert Path("a", name).read_bytes() == Path("deep/er/b=1", name).read_bytes()
    assert_same(logs, read_logs("deep/er/b=1"))


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


def full_disk(*args, **kwargs):
    raise OSError(28, "No space left on device")


def not_in_place(folder, target, rename=Path.rename):
    """Rename as ever, but what is new."""
    if folder.name.endswith(".new"):
        raise OSError(5, "Input/output error")
    return rename(folder, target)


@pytest.mark.parametrize(
    ("at", "fault", "told"),
    [
        ("pyarrow.parquet.write_table", full_disk, r"cannot be written .No space left on device"),
        ("pathlib.Path.rename", not_in_place, "Input/output error"),
    ],
)
def test_an_overwrite_that_fails_leaves_what_was_there(folder, logs, monkeypatch, at, fault, told):
    monkeypatch.setattr(at, fault)
    with pytest.raises(ArgumentError, match=told):
        logs.write(folder, overwrite=True)
    assert os.listdir(folder.parent) == ["logs"]
    assert_same(read_logs(folder), logs)


def test_a_file_where_the_folder_should_go(tmp_path, logs):
    (tmp_path / "file").write_text("")
    with pytest.raises(ArgumentError, match="cannot be written"):
        logs.write(tmp_path / "file" / "logs")
    with pytest.raises(ArgumentError, match="it is there already"):
        logs.write(tmp_path / "file")
