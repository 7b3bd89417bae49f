import pytest

from halfseen.errors import LogError
from halfseen.logs import Logs, read_logs
from halfseen.logs.formats import write_csv


def test_a_folder_of_csv_files_is_read_as_what_it_is(tmp_path):
    stages = {"path": [1, 1], "stage": [1, 2], "elapsed_s": [2.0, None], "action": ["A", None], "reward": [1.0, None]}
    logs = Logs(stages, {"path": [1], "end_s": [3.0], "ending": ["cut"], "cause": ["battery"]})
    write_csv(logs, tmp_path / "csv")
    assert read_logs(tmp_path / "csv").stages.equals(logs.stages)
    (tmp_path / "csv" / "paths.csv").unlink()
    with pytest.raises(LogError, match=r"paths\.csv"):
        read_logs(tmp_path / "csv")
