"""What a recorder keeps of a team: who decided, what the others were at, and one clock that never falls."""

import numpy as np
import pytest

import played_teams
from halfseen.errors import LogError
from halfseen.logs import Logs, read_logs
from halfseen.world.actions import TARGETED, ActionSpace, possible_actions
from halfseen.world.cuts import cut, cut_rate
from halfseen.world.logs import states_of, to_logs
from played_teams import NUM_OBJECTS, SCENE

NUM_PATHS = 60


@pytest.fixture(scope="module", params=[1, 2, 3])
def played(request):
    return played_teams.played(played_teams.team_of(request.param), NUM_PATHS)


@pytest.fixture(scope="module")
def logs(played):
    rate = cut_rate(played, 0.5, "independent")
    return to_logs(cut(played, rate, "independent", np.random.default_rng(0)), "independent", [SCENE], 0.6)


def test_a_log_of_a_team_is_a_log(logs, tmp_path):
    assert logs.num_paths == NUM_PATHS
    assert 0.2 < (logs.paths["ending"] == "cut").mean() < 0.8
    logs.write(tmp_path / "log")
    assert read_logs(tmp_path / "log").stages["robot"].tolist() == logs.stages["robot"].tolist()


def test_the_clock_never_falls_and_adds_up(played, logs):
    elapsed_s = np.asarray(played.elapsed_s)
    assert (np.diff(elapsed_s, axis=1) >= 0).all()
    first = logs.stages[logs.stages["path"] == 0].dropna(subset=["elapsed_s"])
    np.testing.assert_allclose(first["elapsed_s"], elapsed_s[0, : len(first)], rtol=1e-5)


def test_who_decides_is_free_and_the_others_are_as_they_are_said_to_be(logs):
    stages = logs.stages
    for row in stages.itertuples(index=False):
        assert getattr(row, f"_{stages.columns.get_loc(f'{row.robot}_does')}") == "FREE"
    num_robots = stages["robot"].max() + 1
    for r in range(num_robots):
        spent = stages[f"{r}_decisions_to_go"].groupby(stages["path"]).diff().dropna()
        made = (stages["robot"] == r).groupby(stages["path"]).shift(fill_value=False)[spent.index]
        np.testing.assert_array_equal(-spent, made)


def test_nobody_is_at_what_another_is_at(logs):
    stages = logs.stages.dropna(subset=["object"])
    for r in range(stages["robot"].max() + 1):
        others = stages[stages["robot"] != r]
        at = others[f"{r}_does"].str.extract(r"(\d+)$")[0].astype("Int64")
        assert not (at == others["object"]).fillna(False).any()


def test_no_probability_is_that_of_something_impossible(logs):
    assert ((logs.stages["probability"] > 0) & (logs.stages["probability"] <= 1)).all()


def test_the_log_tells_who_made_each_attempt(played, logs):
    """By plain loops: who is at an object as its number of attempts grows has tried it."""
    found = logs.objects.set_index(["path", "stage", "object"])["attempt_by"]
    actions, num_robots = ActionSpace(NUM_OBJECTS), played.states.robots.num_robots
    robots, tried = played.states.robots, np.asarray(played.states.attempt_object)
    is_busy, verbs, targets = (np.asarray(each) for each in (robots.is_busy, robots.verb, robots.target))
    action, decider = np.asarray(played.action), np.asarray(played.states.decider)
    for path, rows in logs.stages.groupby("path"):
        by = {target: [] for target in range(NUM_OBJECTS)}
        for t, target in np.ndindex(len(rows), NUM_OBJECTS):
            if (tried[path, t] == target).sum() > len(by[target]):
                was = path, t - 1
                verb, at = np.where(is_busy[was], verbs[was], 0), targets[was].copy()
                verb[decider[was]], at[decider[was]] = actions.verb(action[was]), actions.target(action[was])
                by[target] += [r for r in range(num_robots) if verb[r] in TARGETED and at[r] == target]
            assert list(found[path, t + 1, target]) == by[target]
    assert {robot for each in found for robot in each} == set(range(num_robots))


def test_from_a_log_come_the_states_that_the_team_saw(played, logs):
    horizon = played.action.shape[1]
    states = states_of(logs, horizon)
    at = logs.stages["path"].to_numpy(), logs.stages["stage"].to_numpy() - 1
    seen = played.states
    for name in ("is_busy", "is_parked", "decisions_to_go"):
        np.testing.assert_array_equal(np.asarray(getattr(states.robots, name))[at], getattr(seen.robots, name)[at])
    is_busy = np.asarray(seen.robots.is_busy)[at]
    for name in ("verb", "target", "since_s"):
        found, truth = (np.asarray(getattr(each.robots, name))[at] for each in (states, seen))
        np.testing.assert_allclose(np.where(is_busy, found, 0), np.where(is_busy, truth, 0), rtol=1e-6)
    np.testing.assert_array_equal(np.asarray(states.decider)[at], np.asarray(seen.decider)[at])
    np.testing.assert_array_equal(possible_actions(states)[at], possible_actions(seen)[at])


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"robot": lambda stages: stages["robot"] + 7}, r"path 0, stage 1: robot is 7, but its columns tell of robots"),
        ({"0_does": "WASH"}, r"stage 1: 0_does is 'WASH'; it is FREE, PARKED"),
        ({"0_does": "DANCE 1"}, r"0_does is 'DANCE 1'"),
    ],
)
def test_what_no_team_does_is_refused(logs, change, told):
    wrong = Logs(logs.stages.assign(**change), logs.paths, logs.objects)
    with pytest.raises(LogError, match=told):
        states_of(wrong, 15)
