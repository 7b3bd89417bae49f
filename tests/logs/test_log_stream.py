"""A log in parts is the log: as a stream, as shards that are each read alone, and as what is written part by part."""

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from halfseen.errors import ArgumentError, LogError
from halfseen.logs import LogStream, read_logs, write_stream
from halfseen.logs.stream import ShardReader, logs_of
from refusals import refused, refused_type
from small_logs import log_of


def two_stages(trajectories, *, has_objects=False, is_cut=True, name_of=int, **covariates):
    """Trajectories of two stages; every third one is cut in its second."""
    trajectory, stage = np.repeat(trajectories, 2), np.tile([1, 2], len(trajectories))
    cut = (trajectory % 3 == 0) & (stage == 2) & is_cut
    at = {"trajectory": [name_of(each) for each in trajectory], "stage": stage}
    seen = {"elapsed_s": np.where(cut, np.nan, stage * 1.5), "reward": trajectory * 1.0, "x": trajectory / 7.0}
    objects = pd.DataFrame(at).merge(pd.DataFrame({"object": ["cup", "mug"]}), how="cross") if has_objects else None
    return log_of({"end_s": 3.0}, objects, **at, **seen, **covariates)


PLAIN, OF_OBJECTS, NAMED = {}, {"has_objects": True}, {"name_of": "p{:03d}".format}


@pytest.mark.parametrize(
    ("kind", "trajectories_at_once", "rows_in_group"),
    [(PLAIN, 4, 7), (OF_OBJECTS, 4, 3), (NAMED, 2, 3), (PLAIN, 10, 100), (OF_OBJECTS, 100, 5), (NAMED, 10, 5)],
)
def test_parts_put_together_are_the_log(tmp_path, monkeypatch, kind, trajectories_at_once, rows_in_group):
    monkeypatch.setattr("halfseen.logs.parquet.ROWS_IN_GROUP", rows_in_group)
    monkeypatch.setattr("halfseen.logs.folder.NUM_SHARDS", 3)
    logs = two_stages(range(13), **kind)
    logs.write(tmp_path / "logs")
    monkeypatch.setattr("halfseen.logs.folder.ROWS_IN_GROUP", 3)
    stream = LogStream(tmp_path / "logs", trajectories_at_once)
    dealt, reader = stream.shards(), ShardReader(stream.as_folder)
    parts = [part for shard in dealt for part in shard.parts]
    assert [part.number for part in parts] == list(range(-(-13 // trajectories_at_once)))
    assert len(dealt) >= min(3, len(parts))
    # The last comes first: nothing that was read before is needed; a stream can be read again.
    found = [reader.read(part) for part in reversed(parts)][::-1]
    for these in (found, list(stream), list(stream)):
        assert [part.num_trajectories for part in these[:-1]] == [trajectories_at_once] * (len(parts) - 1)
        for name, table in logs.tables.items():
            together = pd.concat([part.tables[name] for part in these], ignore_index=True)
            pd.testing.assert_frame_equal(together, table, check_dtype=False)
    assert (stream.num_trajectories, stream.num_stages, stream.has_objects) == (13, 26, logs.objects is not None)
    some = logs_of(stream.as_folder, [reader.tables(part, np.array([0])) for part in parts])
    assert some.trajectory_ids.tolist() == [part.trajectory_ids[0] for part in found]
    assert some.num_stages == 2 * len(parts)


def read_all(folder):
    stream = LogStream(folder, 5)
    reader = ShardReader(stream.as_folder)
    return [reader.read(part) for shard in stream.shards() for part in shard.parts]


@pytest.fixture
def folder(tmp_path):
    two_stages(range(10)).write(tmp_path / "logs")
    return tmp_path / "logs"


def test_rows_that_are_out_of_place_are_reported(folder):
    def streamed(folder):
        return list(LogStream(folder, 5))

    broken = r"logs: trajectory 7, stage 2: the stage is completed, yet its reward is nan"
    for name, rows, result in (
        ("stages", [*range(10, 20), *range(10)], {streamed: r"rows of trajectory 5 are where .* trajectory 0;"}),
        ("stages", [*range(18), 0, 1], {
            streamed: "rows of trajectory 0 are where .* has trajectory 9",
            read_all: "rows of trajectory 0 are where .* has trajectory 9",
        }),
        ("stages", [0, 2, 1, 3, *range(4, 20)], {read_all: r"stages\.parquet: the rows of a trajectory are not"}),
        ("stages", None, {streamed: broken, read_all: broken}),
        *(("trajectories", rows, {streamed: r"trajectories\.parquet is not sorted|in trajectories twice"})
          for rows in ([1, 0, *range(2, 10)], [*range(5), 4, *range(6, 10)])),
    ):  # fmt: skip
        file = folder / f"{name}.parquet"
        content, table = file.read_bytes(), pq.read_table(file)
        if rows is None:
            frame = table.to_pandas()
            frame.loc[15, "reward"] = np.nan
            frame.to_parquet(file, index=False)
            first, _ = [part for shard in LogStream(folder, 5).shards() for part in shard.parts]
            assert ShardReader(LogStream(folder, 5).as_folder).read(first).num_trajectories == 5
        else:
            pq.write_table(table.take(rows), file)
        for read, words in result.items():
            with refused(words, LogError):
                read(folder)
        file.write_bytes(content)


def test_what_is_written_in_parts_is_read_as_a_whole(tmp_path):
    parts = [two_stages(range(5), is_cut=False), two_stages(range(5, 9)), two_stages(range(9, 20), is_cut=False)]
    write_stream(iter(parts), tmp_path / "logs")
    logs = read_logs(tmp_path / "logs")
    assert logs.trajectory_ids.tolist() == list(range(20))
    assert logs.trajectories.loc[6, "cause"] == "unknown"
    assert logs.stages["reward"].isna().sum() == 1
    with refused("it already exists", ArgumentError):
        write_stream(iter(parts), tmp_path / "logs")
    write_stream(iter(parts[:1]), tmp_path / "logs", overwrite=True)
    assert read_logs(tmp_path / "logs").num_trajectories == 5


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ([two_stages(range(5, 10)), two_stages(range(5))], "trajectory 0: it comes after trajectory 9; sort the parts"),
        (
            [two_stages(range(5)), two_stages(range(5, 9), y=1.0)],
            "stages: column 'y' comes with trajectory 5, and parts before",
        ),
        ([], "there are no parts"),
    ],
)
def test_nothing_is_left_of_what_went_wrong(tmp_path, parts, message):
    with refused(message):
        write_stream(iter(parts), tmp_path / "logs")
    assert list(tmp_path.iterdir()) == []


def test_a_stream_of_no_folder_or_of_no_parts_is_refused(folder, tmp_path):
    with refused_type("parts is a Logs; give a list of Logs"):
        write_stream(two_stages(range(10)), tmp_path / "whole")
    with refused_type("trajectories_at_once is 2.5; read at least 1"):
        LogStream(folder, 2.5)
    with refused("trajectories_at_once is 0", ArgumentError):
        LogStream(folder, 0)
    for read in (read_logs, LogStream):
        with refused("nowhere: no such folder", LogError):
            read(tmp_path / "nowhere")
