"""Logs in a folder, on disk or in an object store: whole or not at all, and what is missing is reported in one line."""

import os
from functools import partial
from pathlib import Path

import fsspec
import numpy as np
import pytest
from click.testing import CliRunner

from halfseen.cli.convert import convert
from halfseen.cli.learn import learn
from halfseen.errors import ArgumentError, LogError
from halfseen.learning import CensoredQLearner
from halfseen.logs import LogRecorder, Logs, LogStream, compact, read_logs, write_stream
from halfseen.policies.folder import read_policy
from refusals import refused, refused_type
from small_logs import flat_log, table_log
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
    with pytest.raises(ArgumentError, match=r"it already exists; .* pass --overwrite \(overwrite=True\)"):
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
    ("at", "fault", "message"),
    [
        ("pyarrow.parquet.write_table", full_disk, r"cannot be written .No space left on device"),
        ("pathlib.Path.rename", not_in_place, "Input/output error"),
    ],
)
def test_an_overwrite_that_fails_leaves_what_was_there(folder, logs, monkeypatch, at, fault, message):
    monkeypatch.setattr(at, fault)
    with pytest.raises(ArgumentError, match=message):
        logs.write(folder, overwrite=True)
    assert os.listdir(folder.parent) == ["logs"]
    assert_same(read_logs(folder), logs)


def test_a_file_where_the_folder_should_go(tmp_path, logs):
    (tmp_path / "file").write_text("")
    with pytest.raises(ArgumentError, match="cannot be written"):
        logs.write(tmp_path / "file" / "logs")
    with pytest.raises(ArgumentError, match="it already exists"):
        logs.write(tmp_path / "file")


# Object stores.


@pytest.fixture
def store(tmp_path):
    """A store in memory with two logs, and nothing else."""
    memory = fsspec.filesystem("memory")
    for name, log in (("flat", flat_log()), ("tables", table_log())):
        log.write(tmp_path / name)
        memory.put(str(tmp_path / name), f"/fleet/{name}", recursive=True)
    yield "memory://fleet"
    memory.rm("/fleet", recursive=True)


@pytest.mark.parametrize(("name", "log"), [("flat", flat_log), ("tables", table_log)])
def test_they_are_read(name, log, store):
    whole = log()
    for found in (read_logs(f"{store}/{name}"), next(iter(LogStream(f"{store}/{name}")))):
        for table, frame in whole.tables.items():
            assert found.tables[table].equals(frame)


def test_an_address_of_this_machine_is_one(tmp_path):
    flat_log().write(tmp_path / "logs")
    assert read_logs(f"file://{tmp_path}/logs").num_trajectories == flat_log().num_trajectories


@pytest.mark.slow
def test_they_are_learned_from_in_passes(store, tmp_path):
    words = [f"{store}/flat", "--out", str(tmp_path / "policy"), "--streaming", "--no-verdict", "--reg", "0.1"]
    result = CliRunner().invoke(learn, words, catch_exceptions=False)
    assert result.stdout.startswith(f"{tmp_path / 'policy'}: learned from 40 trajectories")
    policy = read_policy(tmp_path / "policy").policy
    known = CensoredQLearner(2, {1: ["A", "B"], 2: ["A", "C"]}, ["x1", "x2"], reg=0.1).fit(flat_log()).policy_
    np.testing.assert_allclose(policy.coefficients, known.coefficients, rtol=1e-6, atol=1e-9)


def test_one_is_converted_and_several_are_compacted(store, tmp_path):
    words = [f"{store}/flat", "--out", str(tmp_path / "here")]
    assert CliRunner().invoke(convert, words, catch_exceptions=False).exit_code == 0
    done = compact([f"{store}/flat", tmp_path / "here"], tmp_path / "all")
    assert done.num_trajectories == 2 * flat_log().num_trajectories
    assert read_logs(tmp_path / "all").trajectories["run"].iloc[0] == f"{store}/flat"


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("memory://fleet/none", "no such folder"),
        ("nosuch://bucket/logs", r"nosuch://bucket/logs: it cannot be opened \(Unsupported filesystem"),
    ],
)
def test_what_is_not_there_is_named(address, message, store):
    for read in (read_logs, LogStream):
        with refused(message, LogError):
            read(address)


@pytest.mark.parametrize("error", [PermissionError("Access Denied"), RuntimeError("no credentials\nsee the docs")])
def test_what_a_store_refuses_is_reported(error, store, monkeypatch):
    def refuses(*_, **__):
        raise error

    monkeypatch.setattr(fsspec.filesystem("memory"), "_open", refuses)
    reason = str(error).splitlines()[0]
    with refused(rf"(^memory://fleet/flat: the store did not answer \(|cannot be read).*{reason}", LogError):
        read_logs(f"{store}/flat")


@pytest.mark.parametrize("place", [3, None, flat_log()])
def test_what_is_no_path_is_refused(place):
    for use in (read_logs, LogStream, read_policy, flat_log().write, partial(write_stream, [flat_log()]), LogRecorder):
        with refused_type(f"folder is a {type(place).__name__}; give the path of a folder"):
            use(place)


def test_an_address_in_a_store_becomes_no_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for write in (flat_log().write, partial(write_stream, [flat_log()]), LogRecorder):
        for address in ("s3://bucket/logs", Path("s3://bucket/logs")):
            with refused(f"{address}: it is an address, and only logs are read from stores; give a folder"):
                write(address)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["e.csv", "e.jsonl.gz", "e.ndjson.gz"])
def test_tables_of_other_programs_are_reported_how_to_be_read(tmp_path, name):
    (tmp_path / name).touch()
    for place in (tmp_path / name, tmp_path):
        with refused(r"make a mapping of (it|its tables): halfseen convert .* --mapping-template --out", LogError):
            read_logs(place)
