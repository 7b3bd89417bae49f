import json
import os
import shutil

import pandas as pd
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from test_logs import assert_same
from valid_logs import small_tables, valid_tables

from halfseen.errors import ArgumentError, LogError
from halfseen.logs import Logs, read_logs
from halfseen.logs import folder as on_disk


@pytest.fixture
def logs():
    return Logs(**small_tables())


@pytest.fixture
def folder(tmp_path, logs):
    logs.write(tmp_path / "logs")
    return tmp_path / "logs"


@given(valid_tables())
def test_any_log_comes_back_as_it_was(tmp_path_factory, tables):
    logs, folder = Logs(**tables), tmp_path_factory.mktemp("logs") / "a"
    logs.write(folder)
    assert_same(logs, read_logs(folder))
    assert read_logs(folder).horizon == logs.horizon


def test_types_come_back_lists_and_nullable_integers_included(tmp_path):
    tables = small_tables()
    tables["stages"]["action"] = [0, 1, 2, 2, None]
    tables["stages"]["step"] = tables["stages"]["steps_to_go"].astype("int8")
    tables["stages"]["kind"] = pd.Categorical(["a", "b", "a", "b", "a"])
    tables["paths"]["recorded"] = pd.Timestamp("2024-05-01", tz="UTC")
    tables["objects"]["grasps"] = [[1, 2], [], [3], [], [], [], [], [], [], []]
    logs = Logs(**tables)
    logs.write(tmp_path / "logs")
    back = read_logs(tmp_path / "logs")
    assert_same(logs, back)
    assert back.stages.dtypes[["action", "step", "kind"]].astype(str).tolist() == ["Int64", "int8", "category"]
    assert back.objects["grasps"][0].tolist() == [1, 2]


def test_the_same_log_gives_the_same_bytes(tmp_path):
    tables = small_tables()
    Logs(**tables).write(tmp_path / "a")
    Logs(**{name: frame[::-1] for name, frame in tables.items()}).write(tmp_path / "b")
    names = sorted(os.listdir(tmp_path / "a"))
    assert names == ["logs.json", "objects.parquet", "paths.parquet", "stages.parquet"]
    for name in names:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_text_and_path_name_the_same_folder(tmp_path, logs, monkeypatch):
    monkeypatch.chdir(tmp_path)
    logs.write("deep/er/a=1")
    assert_same(logs, read_logs("deep/er/a=1"))


def test_existing_folder_is_refused_and_left_alone(folder, logs):
    before = {file.name: file.read_bytes() for file in folder.iterdir()}
    with pytest.raises(ArgumentError, match=r"it is there already; .* pass --overwrite \(overwrite=True\)"):
        logs.select([1]).write(folder)
    assert {file.name: file.read_bytes() for file in folder.iterdir()} == before


def test_overwrite_replaces_the_whole_folder(folder, logs):
    Logs(logs.stages, logs.paths).write(folder, overwrite=True)
    assert read_logs(folder).objects is None
    assert not (folder / "objects.parquet").exists()
    assert os.listdir(folder.parent) == ["logs"]


def test_overwrite_never_replaces_what_is_no_log(tmp_path, logs):
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(ArgumentError, match="it holds no logs"):
        logs.write(tmp_path, overwrite=True)
    assert (tmp_path / "thesis.tex").read_text() == "years of work"


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_write_that_fails_leaves_nothing_half_done(tmp_path, logs, monkeypatch, overwrite):
    folder = tmp_path / "logs"
    if overwrite:
        logs.write(folder)

    def full_disk(*args, **kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(on_disk.pq, "write_table", full_disk)
    with pytest.raises(ArgumentError, match=r"cannot be written .No space left on device"):
        logs.write(folder, overwrite=overwrite)
    assert os.listdir(tmp_path) == (["logs"] if overwrite else [])
    if overwrite:
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


def test_missing_folder_and_files_are_named(folder, tmp_path):
    with pytest.raises(LogError, match=r"nowhere: there is no such folder"):
        read_logs(tmp_path / "nowhere")
    (folder / "objects.parquet").unlink()
    with pytest.raises(LogError, match=r"objects\.parquet: it is missing; copy the whole folder"):
        read_logs(folder)
    (folder / "logs.json").unlink()
    with pytest.raises(LogError, match=r"logs\.json: it is missing, so .* holds no logs"):
        read_logs(folder)


@pytest.mark.parametrize("size", [0, 3, 100, -1])
def test_truncated_parquet_is_named(folder, size):
    file = folder / "stages.parquet"
    file.write_bytes(file.read_bytes()[:size])
    with pytest.raises(LogError, match=r"stages\.parquet: it is no whole Parquet file"):
        read_logs(folder)


def test_broken_page_in_a_whole_footer_is_named(folder):
    file = folder / "stages.parquet"
    content = bytearray(file.read_bytes())
    content[4:200] = bytes(196)
    file.write_bytes(bytes(content))
    with pytest.raises(LogError, match=r"stages\.parquet"):
        read_logs(folder)


@pytest.mark.parametrize(
    ("manifest", "message"),
    [
        ('{"format": "halfseen-logs", "version": 2}', "version 2 is not the 1 that this halfseen reads"),
        ('{"format": "halfseen-logs"}', "version None is not the 1"),
        ('{"format": "something else"}', "it does not describe logs"),
        ("[]", "it does not describe logs"),
        ("{", "it cannot be read"),
        (b"\xff\xfe", "it cannot be read"),
        ('{"format": "halfseen-logs", "version": 1}', "rows None does not count stages and paths"),
        (
            '{"format": "halfseen-logs", "version": 1, "rows": {"stages": 5, "paths": 3, "../x": 1}}',
            "rows .* does not count",
        ),
    ],
)
def test_wrong_manifest_is_named(folder, manifest, message):
    (folder / "logs.json").write_bytes(manifest if isinstance(manifest, bytes) else manifest.encode())
    with pytest.raises(LogError, match=rf"logs\.json: {message}"):
        read_logs(folder)


def test_files_of_two_logs_are_not_mixed(folder, tmp_path, logs):
    logs.select([1, 2]).write(tmp_path / "other")
    shutil.copy(tmp_path / "other" / "paths.parquet", folder)
    with pytest.raises(LogError, match=r"paths\.parquet: it has 2 rows where logs\.json counts 3"):
        read_logs(folder)


def test_broken_invariant_on_disk_is_named_with_the_folder(folder):
    stages = pd.read_parquet(folder / "stages.parquet")
    stages.loc[1, "elapsed_s"] = 1.0
    stages.to_parquet(folder / "stages.parquet")
    with pytest.raises(LogError, match=r"logs: path 1, stage 2: elapsed_s 1.0 is before"):
        read_logs(folder)


def test_manifest_counts_the_rows(folder):
    rows = json.loads((folder / "logs.json").read_text())["rows"]
    assert rows == {
        name: pq.read_metadata(folder / f"{name}.parquet").num_rows for name in ("stages", "paths", "objects")
    }
