"""A trajectory of a log with its clouds."""

import numpy as np
import pytest

from halfseen.errors import ArgumentError, CloudError
from halfseen.learning import CensoredQLearner
from halfseen.logs import Logs
from halfseen.perception import perceive, read_cloud, write_pcd
from halfseen.policies import read_policy, write_policy
from halfseen.scene import table_paths
from halfseen.view.stages import watched_logs
from small_logs import table_log

TABLE = read_cloud(table_paths()[7])


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """Logs of a table, each of whose stages names its cloud."""
    folder = tmp_path_factory.mktemp("clouds")
    view = perceive(TABLE)
    logs = table_log(num_trajectories=4, num_objects=len(view.objects), hides=view.hides, seed=1)
    stages = logs.stages.assign(cloud="look.pcd")
    write_pcd(TABLE, folder / "look.pcd")
    return Logs(stages, logs.trajectories, logs.objects), folder, view


def test_each_stage_shows_its_cloud_and_what_the_log_knew(kept):
    logs, folder, view = kept
    watched = watched_logs(logs, folder, 2)
    trajectory = logs.select(logs.trajectory_ids[1:2])
    assert len(watched.stages) == trajectory.horizon
    for t, stage in enumerate(watched.stages):
        rows = trajectory.objects[trajectory.objects["stage"] == t + 1]
        chances = 1 / (1 + np.exp(-rows["log_odds"].to_numpy(float)))
        assert [shown.is_dirty for shown in stage.objects] == pytest.approx(chances)
        done = trajectory.stages.iloc[t]
        assert stage.action.startswith(str(done["action"]))
        assert len(stage.events) >= t
    assert len(view.objects) == len(watched.stages[0].objects)
    assert watched.stages[-1].events[-1].startswith("the trajectory ")


def test_a_policy_is_asked_at_each_stage(kept, tmp_path):
    logs, folder, _ = kept
    write_policy(CensoredQLearner.for_table(3, reg=0.1).fit(logs), logs, tmp_path / "policy")
    watched = watched_logs(logs, folder, 1, read_policy(tmp_path / "policy"))
    for stage in watched.stages:
        assert stage.options
        assert all(option.low < option.high and 0 <= option.chance_best <= 1 for option in stage.options)
        assert stage.action in stage.reason


def test_what_is_not_there_is_told(kept):
    logs, folder, _ = kept
    with pytest.raises(ArgumentError, match="--trajectory is 9, and the log has 4 trajectories"):
        watched_logs(logs, folder, 9)
    with pytest.raises(ArgumentError, match="no column 'cloud'"):
        watched_logs(Logs(logs.stages.drop(columns="cloud"), logs.trajectories, logs.objects), folder, 1)
    with pytest.raises(CloudError, match="no such file"):
        watched_logs(logs, folder / "elsewhere", 1)
    for outside in ("../look.pcd", str(folder.parent / "look.pcd")):
        with pytest.raises(ArgumentError, match="is not in"):
            watched_logs(Logs(logs.stages.assign(cloud=outside), logs.trajectories, logs.objects), folder, 1)
    with pytest.raises(ArgumentError, match="no cloud was kept"):
        watched_logs(Logs(logs.stages.assign(cloud=None), logs.trajectories, logs.objects), folder, 1)
