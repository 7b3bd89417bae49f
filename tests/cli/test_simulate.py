import json
from functools import partial

import pytest
import shell

from halfseen.logs import read_logs
from halfseen.scene import table_paths

FEW = ["--episodes", 12, "--policy", "uniform", "--cut-share", 0.4, "--seed", 3]
run = partial(shell.run, "simulate", *table_paths()[5:8:2], *FEW)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("simulate") / "logs"
    run("--out", folder)
    return read_logs(folder)


def test_the_logs_are_there_and_whole(recorded):
    assert recorded.num_trajectories == 12
    assert set(recorded.trajectories["scene"]) == {"table_05.pcd", "table_07.pcd"}
    assert recorded.objects is not None
    assert 0.0 < recorded.cut_share < 1.0


def test_one_seed_same_logs_and_json_for_programs(recorded, tmp_path):
    report = json.loads(run("--out", tmp_path / "again", "--json").stdout)
    assert (report["num_trajectories"], report["policy"], report["seed"]) == (12, "uniform", 3)
    assert report["scenes"] == {"table_05.pcd": 5, "table_07.pcd": 5}
    assert read_logs(tmp_path / "again").stages.equals(recorded.stages)
    run("--out", tmp_path / "again", "--overwrite")
    assert read_logs(tmp_path / "again").stages.equals(recorded.stages)
