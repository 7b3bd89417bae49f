"""A log in parts is the log: as a stream, as shards that are each read alone, and as what is written part by part."""

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from halfseen.errors import ArgumentError, LogError
from halfseen.logs import Logs, LogStream, read_logs, shards, write_stream
from halfseen.logs.shards import ShardReader, logs_of


def log_of(paths, has_objects=False, is_cut=True):
    """Paths of two stages; every third one is cut in its second."""
    rows = [(path, stage) for path in paths for stage in (1, 2)]
    cut = [is_cut and path % 3 == 0 and stage == 2 for path, stage in rows]
    stages = pd.DataFrame(rows, columns=["path", "stage"])
    stages["elapsed_s"] = np.where(cut, np.nan, stages["stage"] * 1.5)
    stages["action"], stages["x"] = "A", stages["path"] / 7.0
    stages["reward"] = np.where(cut, np.nan, stages["path"] * 1.0)
    ends = {
        "path": list(paths),
        "end_s": 3.0,
        "ending": ["cut" if is_cut and path % 3 == 0 else "finished" for path in paths],
    }
    objects = None
    if has_objects:
        objects = stages[["path", "stage"]].merge(pd.DataFrame({"object": ["cup", "mug"]}), how="cross")
    return Logs(stages, pd.DataFrame(ends), objects)


def named(logs):
    """The same with paths that have names."""
    tables = {name: table.assign(path=table["path"].map("p{:03d}".format)) for name, table in logs.tables.items()}
    return Logs(**tables)


@pytest.mark.parametrize("kind", [log_of, lambda paths: log_of(paths, has_objects=True), lambda p: named(log_of(p))])
@pytest.mark.parametrize(("paths_at_once", "rows_in_group"), [(1, 3), (4, 7), (10, 100), (100, 5)])
def test_parts_put_together_are_the_log(tmp_path, monkeypatch, kind, paths_at_once, rows_in_group):
    monkeypatch.setattr("halfseen.logs.folder.ROWS_IN_GROUP", rows_in_group)
    monkeypatch.setattr(shards, "ROWS_IN_GROUP", 3)
    monkeypatch.setattr(shards, "NUM_SHARDS", 3)
    logs = kind(range(23))
    logs.write(tmp_path / "logs")
    stream = LogStream(tmp_path / "logs", paths_at_once)
    dealt, reader = stream.shards(), ShardReader(stream.as_folder)
    parts = [part for shard in dealt for part in shard.parts]
    assert [part.number for part in parts] == list(range(-(-23 // paths_at_once)))
    assert len(dealt) >= min(3, len(parts))
    # The last comes first: nothing that was read before is needed; a stream can be read again.
    found = [reader.read(part) for part in reversed(parts)][::-1]
    for these in (found, list(stream), list(stream)):
        assert [part.num_paths for part in these[:-1]] == [paths_at_once] * (len(parts) - 1)
        for name, table in logs.tables.items():
            together = pd.concat([part.tables[name] for part in these], ignore_index=True)
            pd.testing.assert_frame_equal(together, table, check_dtype=False)
    assert (stream.num_paths, stream.num_stages, stream.has_objects) == (23, 46, logs.objects is not None)
    some = logs_of(stream.as_folder, [reader.tables(part, np.array([0])) for part in parts])
    assert some.path_ids.tolist() == [part.path_ids[0] for part in found]
    assert some.num_stages == 2 * len(parts)


def read_all(folder):
    stream = LogStream(folder, 5)
    reader = ShardReader(stream.as_folder)
    return [reader.read(part) for shard in stream.shards() for part in shard.parts]


@pytest.mark.parametrize(
    ("rows", "in_stream", "in_shards"),
    [
        ([*range(10, 20), *range(10)], r"stages\.parquet: no row of path 0 comes next", None),
        (
            [*range(18), 0, 1],
            r"path 9: it has no stage|rows of path 0 stand where|no row of path 9",
            r"logs: path 0, stage 1: paths has no such path",
        ),
        (
            [0, 2, 1, 3, *range(4, 20)],
            None,  # a stream sorts the rows of its parts
            r"stages\.parquet: the rows of its paths do not stand together",
        ),
    ],
)
def test_paths_that_stand_apart_are_told(tmp_path, rows, in_stream, in_shards):
    log_of(range(10)).write(tmp_path / "logs")
    file = tmp_path / "logs" / "stages.parquet"
    pq.write_table(pq.read_table(file).take(rows), file)
    for read, told in ((lambda folder: list(LogStream(folder, 5)), in_stream), (read_all, in_shards)):
        if told is not None:
            with pytest.raises(LogError, match=told):
                read(tmp_path / "logs")


def test_a_broken_part_is_told_with_its_folder_and_its_path(tmp_path):
    log_of(range(10)).write(tmp_path / "logs")
    file = tmp_path / "logs" / "stages.parquet"
    table = pq.read_table(file).to_pandas()
    table.loc[15, "reward"] = np.nan
    table.to_parquet(file, index=False)
    stream = LogStream(tmp_path / "logs", 5)
    reader = ShardReader(stream.as_folder)
    first, second = [part for shard in stream.shards() for part in shard.parts]
    assert reader.read(first).num_paths == 5
    for read in (lambda: reader.read(second), lambda: list(stream)):
        with pytest.raises(LogError, match=r"logs: path 7, stage 2: the stage is completed, yet its reward is nan"):
            read()


def test_a_table_of_paths_out_of_order_is_refused(tmp_path):
    log_of(range(10)).write(tmp_path / "logs")
    file = tmp_path / "logs" / "paths.parquet"
    table = pq.read_table(file)
    for rows in ([1, 0, *range(2, 10)], [*range(5), 4, *range(6, 10)]):
        pq.write_table(table.take(rows), file)
        with pytest.raises(LogError, match=r"paths\.parquet is not sorted|in paths twice"):
            LogStream(tmp_path / "logs", 5)


def test_what_is_written_in_parts_is_read_as_a_whole(tmp_path):
    parts = [log_of(range(5), is_cut=False), log_of(range(5, 9)), log_of(range(9, 20), is_cut=False)]
    write_stream(iter(parts), tmp_path / "logs")
    logs = read_logs(tmp_path / "logs")
    assert logs.path_ids.tolist() == list(range(20))
    assert logs.paths.loc[6, "cause"] == "unknown"
    assert logs.stages["reward"].isna().sum() == 1
    with pytest.raises(ArgumentError, match="it is there already"):
        write_stream(iter(parts), tmp_path / "logs")
    write_stream(iter(parts[:1]), tmp_path / "logs", overwrite=True)
    assert read_logs(tmp_path / "logs").num_paths == 5


def test_nothing_is_left_of_what_went_wrong(tmp_path):
    with pytest.raises(LogError, match="path 0: it comes after path 9; sort the parts"):
        write_stream(iter([log_of(range(5, 10)), log_of(range(5))]), tmp_path / "logs")
    with pytest.raises(ArgumentError, match="there is no part"):
        write_stream(iter([]), tmp_path / "logs")
    assert list(tmp_path.iterdir()) == []


def test_a_stream_of_no_folder_or_of_no_parts_is_refused(tmp_path):
    log_of(range(10)).write(tmp_path / "logs")
    with pytest.raises(ArgumentError, match="paths_at_once is 0"):
        LogStream(tmp_path / "logs", 0)
    for read in (read_logs, LogStream):
        with pytest.raises(LogError, match="nowhere: there is no such folder"):
            read(tmp_path / "nowhere")
