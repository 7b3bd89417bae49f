"""No reader of a user's file hangs on a pipe, reads what is too large or too deep, or tells it in many lines."""

import json
import os
import shutil

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from foreign import episodes, write_lerobot
from halfseen.cell.calibration.law_folder import read_law
from halfseen.errors import HalfseenError
from halfseen.logs import LogStream, read_logs
from halfseen.logs.formats import (
    MAPPING_TEMPLATE,
    Queries,
    read_bag,
    read_csv,
    read_lerobot,
    read_mapping,
    read_queries,
    read_sql,
    read_step_arrays,
    read_steps,
    write_csv,
)
from halfseen.logs.parquet import bytes_of_texts, chunks_of
from halfseen.perception import read_cloud
from halfseen.perception.label_files import read_labels
from halfseen.policies import read_policy
from halfseen.policies.rule_table import read_rule_table
from halfseen.study.store import Store
from halfseen.view.recording import read_recording
from halfseen.world import read_team
from small_logs import flat_log

DEEP = "[" * 100_000


def of_folder(read):
    return lambda file: read(file.parent)


def labels(file):
    return read_labels(file, 1)


def rule(file):
    return read_rule_table(file, 1)


def piece(file):
    return Store(file.parent, {}, is_resumed=True).read(file.stem)


def lerobot(file):
    return read_lerobot(next(folder for folder in file.parents if folder.name == "lerobot"))


def mcap(file):
    (file.parent / "cell.toml").write_text(MAPPING_TEMPLATE)
    return read_bag(file, file.parent / "cell.toml")


def database(file):
    return read_sql(f"sqlite:///{file}", Queries("SELECT * FROM stages", "SELECT * FROM trajectories"))


READERS = {
    "logs.json": of_folder(read_logs),
    "logs/stages.parquet": of_folder(read_logs),
    "csv/columns.json": of_folder(read_csv),
    "csv/stages.csv": of_folder(read_csv),
    "mapping.toml": read_mapping,
    "cloud.npz": read_cloud,
    "cloud.pcd": read_cloud,
    "cloud.ply": read_cloud,
    "labels.json": labels,
    "labels.csv": labels,
    "rule.toml": rule,
    "rule.csv": rule,
    "policy.json": of_folder(read_policy),
    "policy.safetensors": of_folder(read_policy),
    "law.json": of_folder(read_law),
    "team.toml": read_team,
    "team.json": read_team,
    "recording.json": of_folder(read_recording),
    "piece.json": piece,
    "lerobot/meta/info.json": lerobot,
    "lerobot/meta/episodes/chunk-000/file-000.parquet": lerobot,
    "lerobot/data/chunk-000/file-000.parquet": lerobot,
    "steps.parquet": read_steps,
    "steps.csv": read_steps,
    "steps.feather": read_steps,
    "steps.hdf5": read_step_arrays,
    "cell.mcap": mcap,
    "cell.db": database,
    "queries.toml": read_queries,
}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Folders as they are written, which nobody changes."""
    folder = tmp_path_factory.mktemp("whole")
    flat_log().write(folder / "logs")
    write_csv(flat_log(), folder / "csv")
    (folder / "lerobot").mkdir()
    write_lerobot(folder / "lerobot", episodes())
    return folder


@pytest.fixture
def place(whole, tmp_path):
    return shutil.copytree(whole, tmp_path, dirs_exist_ok=True)


def refused(read, file):
    with pytest.raises(HalfseenError) as caught:
        read(file)
    line = str(caught.value)
    assert "\n" not in line
    assert len(line) < 600
    return line


@pytest.mark.parametrize("name", READERS)
def test_a_pipe_and_a_device_are_refused(place, name):
    file = place / name
    file.unlink(missing_ok=True)
    for kind, put in (("pipe", os.mkfifo), ("device", lambda link: link.symlink_to("/dev/zero"))):
        put(file)
        # A folder is known by its record, which is not there where another of its files is asked for.
        if name not in ("policy.safetensors",):
            assert any(word in refused(READERS[name], file) for word in (f"it is a {kind}", "no such", "missing"))
        file.unlink()


@pytest.mark.parametrize("name", READERS)
def test_what_is_too_large_is_refused_unread(place, name):
    with (place / name).open("wb") as file:
        file.truncate(65 * 10**9)  # a hole: nothing is written
    assert any(word in refused(READERS[name], place / name) for word in ("65,000 MB", "missing"))


@pytest.mark.parametrize("name", [name for name in READERS if name.endswith((".json", ".toml"))])
def test_what_is_too_deep_or_no_text_is_refused(place, name):
    for content in (DEEP, "a = " + DEEP, b"\xff\xfe\x00", "1e999", "9" * 5000):
        (place / name).write_bytes(content if isinstance(content, bytes) else content.encode())
        refused(READERS[name], place / name)


def test_a_table_of_few_bytes_and_many_values_is_refused_before_it_is_read(place, monkeypatch):
    monkeypatch.setattr("halfseen.reading.ALWAYS_UNPACKED", 10**5)
    file = place / "logs" / "stages.parquet"
    table = pa.table({"trajectory": np.zeros(10**6, np.int64), "stage": np.zeros(10**6, np.int64)})
    pq.write_table(table, file)
    assert "unpacked, it has 16 MB" in refused(read_logs, place / "logs")
    assert "unpacked, it has 16 MB" in refused(lambda folder: list(LogStream(folder)), place / "logs")


@pytest.mark.parametrize("nested", [False, True])
def test_a_text_that_is_stored_once_counts_in_every_row(place, monkeypatch, nested):
    monkeypatch.setattr("halfseen.logs.parquet.ALWAYS_UNPACKED", 10**5)
    file = place / "texts.parquet"
    texts = pa.DictionaryArray.from_arrays(pa.array([0, 1, None] * 1000), ["n" * 700, "m" * 50])
    plain = texts.cast(pa.string())
    column = pa.ListArray.from_arrays(np.arange(0, 3001, 3), plain) if nested else plain
    pq.write_table(pa.table({"x": column, "y": np.arange(len(column))}), file)
    told = bytes_of_texts(chunks_of(file), file, pq.ParquetFile(file))
    assert told == sum(len(text or "") for text in plain.to_pylist())


@pytest.mark.parametrize("column", ["trajectory", "stage", "action"])
def test_part_by_part_a_missing_column_is_refused_too(place, column):
    file = place / "logs" / "stages.parquet"
    pq.write_table(pq.read_table(file).drop_columns([column]), file)
    assert f"there is no column '{column}'" in refused(LogStream, place / "logs")


def test_a_type_that_is_nested_too_deeply_is_refused(place):
    file = place / "csv" / "columns.json"
    told = json.loads(file.read_text())
    told["tables"]["stages"]["x1"] = "list<" * 5000 + "double" + ">" * 5000
    file.write_text(json.dumps(told))
    assert "nested more than 64 levels" in refused(read_csv, place / "csv")
    file.unlink()
    stages = pd.read_csv(place / "csv" / "stages.csv", float_precision="round_trip").assign(x1="[" * 3000 + "]" * 3000)
    stages.to_csv(place / "csv" / "stages.csv", index=False)
    read_csv(place / "csv")
