"""No reader of a user's file hangs on a pipe, reads what is too large, too deep or torn, or tells it in many lines."""

import json
import os
import re
import shutil
import sqlite3
from contextlib import closing

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.feather
import pyarrow.parquet as pq
import pytest

from bags import WITHOUT_CLOUD, mapping_for, mixed, two_trajectories, write_bag, write_mcap
from event_files import write_events
from foreign import arrays, episodes, rows_of, write_arrays, write_lerobot, write_rows
from halfseen.cell.calibration.law import read_law
from halfseen.errors import HalfseenError
from halfseen.logs import LogStream, formats, read_logs
from halfseen.logs.parquet import bytes_of_texts, chunks_of
from halfseen.perception import read_cloud
from halfseen.perception.labels import read_labels
from halfseen.policies import read_policy
from halfseen.policies.rule_files import read_rule_table
from halfseen.study.runner import Store
from halfseen.view.recording import read_recording
from halfseen.world import read_team
from small_logs import flat_log

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning:minari.utils")
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
    return formats.read_lerobot(next(folder for folder in file.parents if folder.name == "lerobot"))


def steps(file):
    return formats.read_steps(file, formats.StepRules(step_s=1.0))


def mcap(file):
    return formats.read_bag(file, file.parent / "mixed.toml")


def ros(file):
    return formats.read_bag(file, file.parents[1] / "cell.toml")


def folder_of_ros(file):
    return formats.read_bag(file.parent, file.parents[1] / "cell.toml")


def events(file):
    return formats.read_event_table(file, file.parent / "events.toml")


def minari(file):
    return formats.read_minari(file.parents[1])


def database(file):
    return formats.read_sql(f"sqlite:///{file}", formats.Queries("SELECT * FROM stages", "SELECT * FROM trajectories"))


READERS = {
    "logs.json": of_folder(read_logs),
    "logs/stages.parquet": of_folder(read_logs),
    "csv/columns.json": of_folder(formats.read_csv),
    "csv/stages.csv": of_folder(formats.read_csv),
    "mapping.toml": formats.read_mapping,
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
    **{f"steps.{kind}": steps for kind in ("parquet", "csv", "feather", "arrow")},
    "steps.hdf5": formats.read_step_arrays,
    "cell.mcap": mcap,
    "cell.db": database,
    "queries.toml": formats.read_queries,
    "events.csv": events,
    "events.parquet": events,
    "events.toml": formats.read_event_mapping,
}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Folders as they are written, which nobody changes."""
    folder = tmp_path_factory.mktemp("whole")
    flat_log().write(folder / "logs")
    formats.write_csv(flat_log(), folder / "csv")
    (folder / "lerobot").mkdir()
    write_lerobot(folder / "lerobot", episodes())
    for kind in ("parquet", "csv", "feather", "arrow"):
        write_rows(folder / "steps", rows_of(episodes(), [True] * 3), kind)
    write_arrays(folder / "steps.hdf5", arrays(episodes(), terminated=[0, 1, 2]))
    (folder / "cell.toml").write_text(WITHOUT_CLOUD)
    (folder / "mixed.toml").write_text(mapping_for(mixed))
    write_mcap(folder / "cell.mcap", two_trajectories() * 3, mixed)
    write_bag(folder / "db3", two_trajectories() * 5, "sqlite3")
    write_bag(folder / "chunks", two_trajectories() * 5, "mcap")
    with closing(sqlite3.connect(folder / "cell.db")) as connection:
        for name in ("stages", "trajectories"):
            flat_log(8).tables[name].to_sql(name, connection, index=False)
    write_events(folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MINARI_DATASETS_PATH", str(folder))
        formats.write_minari(flat_log(6), "flat-v0")
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


NO_BAG, MINARI = "it is not a complete bag .*ros2 bag reindex", "flat-v0/data/main_data.hdf5"
NO_DATABASE = (
    r"cell\.db: it is cut off: of [\d,]+ bytes [\d,]+ are there; copy it again"
    r"|cell\.db, stages: the database refuses .*no such"  # an empty file is an empty database
)
TORN = [
    *((f"steps.{kind}", steps, "steps") for kind in ("parquet", "csv", "feather", "arrow")),
    ("steps.hdf5", formats.read_step_arrays, r"steps\.hdf5: it is not a complete HDF5 file of steps"),
    *((name, read, NO_BAG) for name in ("db3/db3.db3", "chunks/chunks.mcap") for read in (ros, folder_of_ros)),
    ("cell.mcap", mcap, "it is not a complete bag"),
    (MINARI, minari, "flat-v0: "),
    ("cell.db", database, NO_DATABASE),
    ("events.parquet", events, r"events\.parquet: it is not a complete table"),
]
"""File, what reads it, and what is said where it broke off."""


@pytest.mark.parametrize(("name", "read", "message"), TORN)
def test_a_file_that_breaks_off_is_refused(place, name, read, message):
    file = place / name
    content = file.read_bytes()
    for share in (0.0, 0.05, 0.1, 0.3, 0.5, 0.6, 0.9, 0.99):
        file.write_bytes(content[: int(share * len(content))])
        assert re.search(message, refused(read, file))
    file.unlink()
    refused(read, file)


@pytest.mark.parametrize(
    ("name", "read", "extra"),
    [
        ("steps.hdf5", formats.read_step_arrays, "hdf5"),
        ("db3/db3.db3", folder_of_ros, "ros"),
        ("cell.mcap", mcap, "mcap"),
        ("cell.db", database, "sql"),
        (MINARI, minari, "minari"),
        (MINARI, lambda file: formats.write_minari(flat_log(6), "other-v0"), "minari"),
    ],
)
def test_without_its_library_the_remedy_is_named(place, monkeypatch, name, read, extra):
    def missing(module):
        raise ModuleNotFoundError(f"No module named {module!r}")

    monkeypatch.setattr("halfseen.installation.import_module", missing)
    assert re.search(rf"run: .*pip install .*\[{extra}\]'", refused(read, place / name))


@pytest.mark.parametrize("name", [name for name in READERS if name.endswith((".json", ".toml"))])
def test_what_is_too_deep_or_no_text_is_refused(place, name):
    for content in (DEEP, "a = " + DEEP, b"\xff\xfe\x00", "1e999", "9" * 5000):
        (place / name).write_bytes(content if isinstance(content, bytes) else content.encode())
        refused(READERS[name], place / name)


@pytest.mark.parametrize(
    ("name", "compression", "read"),
    [
        ("logs/stages.parquet", "snappy", of_folder(read_logs)),
        ("logs/stages.parquet", "snappy", of_folder(lambda folder: list(LogStream(folder)))),
        ("steps.parquet", "zstd", steps),
        ("steps.feather", "zstd", steps),
        ("steps.feather", "lz4", steps),
    ],
)
def test_a_table_of_few_bytes_and_many_values_is_refused_before_it_is_read(place, monkeypatch, name, compression, read):
    monkeypatch.setattr("halfseen.reading.ALWAYS_UNPACKED", 10**5)
    table = pa.table({"trajectory": np.zeros(10**6, np.int64), "stage": np.zeros(10**6, np.int64)})
    if name.endswith("feather"):
        pyarrow.feather.write_feather(table, place / name, compression=compression, chunksize=10**6)
    else:
        pq.write_table(table, place / name, compression=compression)
    monkeypatch.setattr("pyarrow.ipc.open_file", None)
    assert "unpacked, it has 16 MB" in refused(read, place / name)


@pytest.mark.parametrize("nested", [False, True])
def test_a_text_that_is_stored_once_counts_in_every_row(place, monkeypatch, nested):
    monkeypatch.setattr("halfseen.logs.parquet.ALWAYS_UNPACKED", 10**5)
    file = place / "texts.parquet"
    texts = pa.DictionaryArray.from_arrays(pa.array([0, 1, None] * 1000), ["n" * 700, "m" * 50])
    plain = texts.cast(pa.string())
    column = pa.ListArray.from_arrays(np.arange(0, 3001, 3), plain) if nested else plain
    pq.write_table(pa.table({"x": column, "y": np.arange(len(column))}), file)
    result = bytes_of_texts(chunks_of(file), file, pq.ParquetFile(file))
    assert result == sum(len(text or "") for text in plain.to_pylist())


@pytest.mark.parametrize("column", ["trajectory", "stage", "action"])
def test_part_by_part_a_missing_column_is_refused_too(place, column):
    file = place / "logs" / "stages.parquet"
    pq.write_table(pq.read_table(file).drop_columns([column]), file)
    assert f"there is no column '{column}'" in refused(LogStream, place / "logs")


def test_a_type_that_is_nested_too_deeply_is_refused(place):
    file = place / "csv" / "columns.json"
    result = json.loads(file.read_text())
    result["tables"]["stages"]["x1"] = "list<" * 5000 + "double" + ">" * 5000
    file.write_text(json.dumps(result))
    assert "nested more than 64 levels" in refused(formats.read_csv, place / "csv")
    file.unlink()
    stages = pd.read_csv(place / "csv" / "stages.csv", float_precision="round_trip").assign(x1="[" * 3000 + "]" * 3000)
    stages.to_csv(place / "csv" / "stages.csv", index=False)
    formats.read_csv(place / "csv")
