import json

import pytest
from click.testing import CliRunner

from halfseen.cli.simulate import simulate
from halfseen.logs import read_logs
from halfseen.scene import table_paths

TABLES = [str(path) for path in table_paths()[5:8:2]]
FEW = ["--episodes", "12", "--policy", "uniform", "--cut-share", "0.4", "--seed", "3"]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("simulate") / "logs"
    result = CliRunner().invoke(simulate, ["--out", str(folder), *TABLES, *FEW], catch_exceptions=False)
    return folder, result


def test_the_logs_are_there_and_whole(recorded):
    logs = read_logs(recorded[0])
    assert logs.num_trajectories == 12
    assert set(logs.trajectories["scene"]) == {"table_05.pcd", "table_07.pcd"}
    assert logs.objects is not None
    assert 0.0 < logs.cut_share < 1.0


def test_one_seed_same_logs_and_json_for_programs(recorded, tmp_path):
    arguments = ["--out", str(tmp_path / "again"), *TABLES, *FEW, "--json"]
    result = CliRunner().invoke(simulate, arguments, catch_exceptions=False)
    report = json.loads(result.stdout)
    assert (report["num_trajectories"], report["policy"], report["seed"]) == (12, "uniform", 3)
    assert report["scenes"] == {"table_05.pcd": 5, "table_07.pcd": 5}
    assert read_logs(tmp_path / "again").stages.equals(read_logs(recorded[0]).stages)
    CliRunner().invoke(simulate, [*arguments, "--overwrite"], catch_exceptions=False)
    assert read_logs(tmp_path / "again").stages.equals(read_logs(recorded[0]).stages)
