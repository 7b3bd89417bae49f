import numpy as np
import pandas as pd
import pytest

from halfseen.errors import ArgumentError, LogError
from halfseen.logs import Logs, LogStream, read_logs, write_stream


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


@pytest.mark.parametrize("has_objects", [False, True])
@pytest.mark.parametrize("paths_at_once", [1, 4, 10, 100])
def test_parts_put_together_are_the_log(tmp_path, has_objects, paths_at_once):
    logs = log_of(range(10), has_objects)
    logs.write(tmp_path / "logs")
    stream = LogStream(tmp_path / "logs", paths_at_once)
    parts = list(stream)
    assert [part.num_paths for part in parts[:-1]] == [paths_at_once] * (len(parts) - 1)
    for name in ("stages", "paths", "objects")[: 2 + has_objects]:
        together = pd.concat([getattr(part, name) for part in parts], ignore_index=True)
        pd.testing.assert_frame_equal(together, getattr(logs, name), check_dtype=False)
    assert (stream.num_paths, stream.num_stages, stream.has_objects) == (10, 20, has_objects)
    assert len(list(stream)) == len(parts), "it can be read again"


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
    with pytest.raises(LogError, match="there is no such folder"):
        LogStream(tmp_path / "nowhere")
