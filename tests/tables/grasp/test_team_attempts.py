"""Attempts of a team: those of one robot where it is one, and of several what the dynamics drew."""

import numpy as np
import pandas as pd
import pytest

from halfseen.tables.grasp.attempts import attempts, team_attempts
from halfseen.world import ExploringPolicy, TableWorld, WorldConfig
from halfseen.world.actions import ActionSpace
from halfseen.world.logs import states_of
from played_teams import NUM_OBJECTS, SCENE, SureGrasping, WashWhatIsDirty, logged, played, team_of

SPACE = ActionSpace(NUM_OBJECTS)


def tried(logs, paths):
    states = states_of(logs, paths.action.shape[1])
    return team_attempts(logs, states, SPACE.verb(paths.action), SPACE.target(paths.action))


@pytest.mark.parametrize("cut_share", [0.0, 0.5])
def test_of_one_robot_they_are_those_of_one_robot(cut_share):
    team = team_of(1)
    paths = played(team, 120, seed=3)
    logs = logged(paths, cut_share)
    ours, theirs = tried(logs, paths), attempts(logs, 5)
    assert len(theirs) > 100
    assert ours["is_finished"].tolist() == theirs["is_finished"].tolist()
    for name in ("path", "stage", "successes", "failures", "succeeded"):
        pd.testing.assert_series_equal(ours[name], theirs[name], check_dtype=False)
    for name in ("occlusion", "grip", "time_s"):
        np.testing.assert_allclose(ours[name], theirs[name], rtol=1e-5, atol=1e-5)
    pairs = pd.DataFrame({"ours": ours["object"], "theirs": theirs["object"]}).drop_duplicates()
    assert pairs["ours"].is_unique
    assert pairs["theirs"].is_unique


def test_the_log_of_one_robot_is_one_of_a_team_of_one():
    logs = TableWorld().simulate(SCENE, ExploringPolicy(WashWhatIsDirty(), 0.5), 30, seed=0)
    assert len(attempts(logs, 10)) > 30


def test_each_lasts_until_its_robot_is_free():
    world = WorldConfig(horizon=5, grasping=SureGrasping(), transport_s=1.0, speed=(1.0, 2.0))
    paths = played(world, 60, seed=4)
    logs = logged(paths, 0.0)
    found = tried(logs, paths)
    at = pd.Index(logs.path_ids).get_indexer(found["path"]), found["stage"].to_numpy() - 1
    speed = np.array([1.0, 2.0])[paths.states.decider[at]]
    target = SPACE.target(paths.action)[at]
    assert found["is_finished"].all()
    assert found["succeeded"].all()
    np.testing.assert_allclose(found["time_s"], (1.0 + 1.0 + 2.0 * target) / speed, rtol=1e-4)


def test_a_robot_that_drops_out_cuts_its_own_attempt():
    paths = played(team_of(2, drop_out_rate=(0.05, 0.0)), 80, seed=6)
    logs = logged(paths, 0.0)
    found = tried(logs, paths)
    out_s = logs.paths.set_index("path")["0_out_s"]
    is_cut = ~found["is_finished"].to_numpy()
    assert 5 < is_cut.sum() < len(found)
    begun = logs.stages.set_index(["path", "stage"])
    for path, stage, time_s in found[is_cut][["path", "stage", "time_s"]].itertuples(index=False, name=None):
        assert begun.loc[(path, stage), "robot"] == 0
        begun_s = 0.0 if stage == 1 else begun.loc[(path, stage - 1), "elapsed_s"]
        assert time_s == pytest.approx(out_s[path] - begun_s, abs=1e-4)
