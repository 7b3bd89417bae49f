"""What a recorder keeps of tables, of one robot and of several: the log tells it, and from it the states come back."""

import numpy as np
import pandas as pd
import pytest

import played_teams
from fitted_laws import FITTED
from halfseen.arrays import softmax
from halfseen.censoring import stage_weights
from halfseen.logs import Logs, read_logs
from halfseen.planners.belief import grip_posterior
from halfseen.tables.features import table_features
from halfseen.world import ActionSpace, TableWorld, UniformPolicy, Verb, WorldConfig, cut_at_drop_outs
from halfseen.world.actions import TARGETED, others_of, possible_actions
from halfseen.world.cuts import cut, cut_rate
from halfseen.world.logs import states_of, to_logs
from other_laws import Nudging, Persisting
from own_laws import LOGISTIC, SCENE, world_of
from picked import assert_same, picked
from played_teams import NUM_OBJECTS, logged, team_of
from world.world_cases import FITTED_SCENES, THREE

OTHER = WorldConfig(grasping=Nudging(), seeing=Persisting(), horizon=6)
RATES = (0.03, 0.01, 0.0)


@pytest.fixture(scope="module")
def recorded(played, scenes):
    sample = picked(played, np.s_[:90])
    cuts = cut(sample, cut_rate(sample, 0.4, "occlusion"), "occlusion", np.random.default_rng(0))
    return cuts, to_logs(cuts, "occlusion", scenes)


def test_the_log_says_what_happened(recorded):
    cuts, logs = recorded
    assert logs.num_trajectories == 90
    assert np.array_equal(logs.is_finished, cuts.is_finished)
    assert np.array_equal(logs.end_s, cuts.end_s)
    assert set(logs.trajectories["cause"].dropna()) == {"sensor-lost"}
    assert logs.trajectories["scene"].tolist()[:4] == ["random-1", "random-3", "random-5", "random-1"]
    assert logs.num_stages == cuts.is_begun.sum()
    expected = np.where(cuts.is_completed, cuts.episodes.elapsed_s, np.nan)[:, : logs.horizon]
    np.testing.assert_allclose(logs.elapsed_s(), expected, rtol=1e-5)
    reward = np.where(cuts.is_completed, cuts.episodes.reward, np.nan)[:, : logs.horizon]
    np.testing.assert_array_equal(logs.stage_values("reward"), reward)


def test_the_log_holds_nothing_hidden(recorded):
    _, logs = recorded
    assert set(logs.objects.columns) == {
        *("trajectory", "stage", "object", "location", "occlusion", "log_odds"),
        *("successes", "failures", "lifts", "hidden_by", "attempt_occlusions", "attempt_succeeded"),
    }
    assert logs.stage_covariates == []
    assert logs.trajectory_columns == ["scene"]


def test_states_and_features_come_back_from_the_log_and_from_disk(recorded, tmp_path):
    cuts, logs = recorded
    states, truth, begun = states_of(logs, 10), cuts.episodes.states, cuts.is_begun
    for name in ("hides", "is_object", "is_on_table", "lifts", "steps_to_go"):
        assert np.array_equal(getattr(states, name)[begun], getattr(truth, name)[begun]), name
    is_object = truth.is_object[begun]
    assert np.array_equal(states.log_odds[begun][is_object], truth.log_odds[begun][is_object])
    is_possible, was_possible = possible_actions(states), possible_actions(truth)
    assert np.array_equal(is_possible[begun], was_possible[begun])
    seen = begun[..., None] & was_possible
    assert np.array_equal(table_features(states)[seen], table_features(truth)[seen])
    # What was not begun is an empty table.
    assert not states.is_object[~begun].any()
    assert not is_possible[~begun][:, 1:].any()
    logs.write(tmp_path / "logs")
    assert_same(states_of(read_logs(tmp_path / "logs"), 10), states)


@pytest.mark.parametrize(
    ("config", "scenes", "names"),
    [(OTHER, [THREE], ("hides", "log_odds")), (FITTED, FITTED_SCENES, ("grip", "seen"))],
    ids=["what attempts moved", "what shows"],
)
def test_what_laws_make_of_a_table_comes_back(config, scenes, names, tmp_path):
    cuts = TableWorld(config).record(scenes, UniformPolicy(), episodes=60, seed=1)
    logs = TableWorld(config).simulate(scenes, UniformPolicy(), episodes=60, seed=1)
    assert logs.trajectories["dirty_share"].tolist() == [config.dirty_share] * logs.num_trajectories
    logs.write(tmp_path / "logs")
    for result in (logs, read_logs(tmp_path / "logs")):
        states = states_of(result, config.horizon)
        for name in names:
            expected = getattr(cuts.episodes.states, name)[cuts.is_begun]
            assert np.array_equal(getattr(states, name)[cuts.is_begun], expected), name
            assert np.unique(expected).size > 3
            assert (expected != expected[0]).any()


def test_a_log_without_what_shows_is_read_as_if_it_were_0():
    logs = TableWorld(FITTED).simulate(FITTED_SCENES, UniformPolicy(), episodes=20, seed=1)
    plain = states_of(Logs(logs.stages, logs.trajectories, logs.objects.drop(columns=["grip", "seen"])), 10)
    zeros = states_of(Logs(logs.stages, logs.trajectories, logs.objects.assign(grip=0.0, seen=0.0)), 10)
    assert not plain.grip.any()
    assert_same(plain, zeros)


@pytest.fixture(scope="module", params=[1, 2, 3])
def team(request):
    """What a team played, and its log."""
    trajectories = played_teams.played(team_of(request.param), 60)
    return trajectories, logged(trajectories, 0.5)


@pytest.mark.slow
def test_a_log_of_a_team_tells_who_decided_by_one_clock_that_never_falls(team, tmp_path):
    trajectories, logs = team
    assert 0.2 < (logs.trajectories["ending"] == "cut").mean() < 0.8
    logs.write(tmp_path / "log")
    assert read_logs(tmp_path / "log").stages["robot"].tolist() == logs.stages["robot"].tolist()
    assert (np.diff(trajectories.elapsed_s, axis=1) >= 0).all()
    first = logs.stages[logs.stages["trajectory"] == 0].dropna(subset=["elapsed_s"])
    np.testing.assert_allclose(first["elapsed_s"], trajectories.elapsed_s[0, : len(first)], rtol=1e-5)
    assert ((logs.stages["probability"] > 0) & (logs.stages["probability"] <= 1)).all()


def test_the_log_tells_who_made_each_attempt(team):
    """By plain loops: who is at an object as its number of attempts grows has tried it."""
    trajectories, logs = team
    found = logs.objects.set_index(["trajectory", "stage", "object"])["attempt_by"]
    actions, robots, tried = ActionSpace(NUM_OBJECTS), trajectories.states.robots, trajectories.states.attempt_object
    for trajectory, rows in logs.stages.groupby("trajectory"):
        by = {target: [] for target in range(NUM_OBJECTS)}
        for t, target in np.ndindex(len(rows), NUM_OBJECTS):
            if (tried[trajectory, t] == target).sum() > len(by[target]):
                was = trajectory, t - 1
                verb, at = np.where(robots.is_busy[was], robots.verb[was], 0), robots.target[was].copy()
                decider, action = trajectories.states.decider[was], trajectories.action[was]
                verb[decider], at[decider] = actions.verb(action), actions.target(action)
                by[target] += [r for r in range(robots.num_robots) if verb[r] in TARGETED and at[r] == target]
            assert list(found[trajectory, t + 1, target]) == by[target]
    assert {robot for each in found for robot in each} == set(range(robots.num_robots))


def test_from_a_log_come_the_states_that_the_team_saw(team):
    trajectories, logs = team
    states, seen = states_of(logs, trajectories.action.shape[1]), trajectories.states
    at = logs.stages["trajectory"].to_numpy(), logs.stages["stage"].to_numpy() - 1
    for name in ("is_busy", "is_parked", "decisions_to_go"):
        np.testing.assert_array_equal(getattr(states.robots, name)[at], getattr(seen.robots, name)[at])
    is_busy = seen.robots.is_busy[at]
    for name in ("verb", "target", "since_s"):
        found, truth = (np.where(is_busy, getattr(each.robots, name)[at], 0) for each in (states, seen))
        np.testing.assert_allclose(found, truth, rtol=1e-6)
    np.testing.assert_array_equal(states.decider[at], seen.decider[at])
    np.testing.assert_array_equal(possible_actions(states)[at], possible_actions(seen)[at])


def test_by_who_tried_the_grips_are_believed_as_where_they_were_seen():
    world = world_of(None, LOGISTIC)
    cuts = world.record([SCENE], UniformPolicy(), 60, seed=0)
    trajectories, logs = cuts.episodes, to_logs(cuts, "independent", [SCENE])
    at = logs.stages["trajectory"].to_numpy(), logs.stages["stage"].to_numpy() - 1
    found, known = (
        softmax(grip_posterior(world.played_config, picked(each, at)).log_weights)
        for each in (states_of(logs, trajectories.action.shape[1]), trajectories.states)
    )
    np.testing.assert_allclose(found, known, rtol=1e-3, atol=1e-6)


@pytest.fixture(scope="module")
def frail():
    """What a team played whose robots drop out, and its log."""
    trajectories = played_teams.played(team_of(3, drop_out_rate=RATES), 80)
    return trajectories, logged(trajectories, 0.3)


def test_trajectories_tell_when_and_why_each_robot_dropped_out(frail, tmp_path):
    trajectories, logs = frail
    until_s = trajectories.hidden.until_out_s
    for r in range(3):
        out_s = logs.trajectories[f"{r}_out_s"].to_numpy()
        seen = ~np.isnan(out_s)
        np.testing.assert_allclose(out_s[seen], until_s[seen, r], rtol=1e-5)
        assert (out_s[seen] <= logs.end_s[seen]).all()
        assert logs.trajectories[f"{r}_out_cause"].eq("battery").to_numpy(dtype=bool).tolist() == seen.tolist()
    share = [logs.trajectories[f"{r}_out_s"].notna().mean() for r in range(3)]
    assert share[0] > share[1] > share[2] == 0.0
    logs.write(tmp_path / "log")
    pd.testing.assert_frame_equal(read_logs(tmp_path / "log").trajectories, logs.trajectories)


def test_states_come_back_and_who_is_out_does_not_go_on(frail):
    trajectories, logs = frail
    states = states_of(logs, trajectories.action.shape[1])
    at = logs.stages["trajectory"].to_numpy(), logs.stages["stage"].to_numpy() - 1
    robots, others = picked(states.robots, at), np.arange(3) != states.decider[at][:, None]
    np.testing.assert_array_equal(robots.is_out, trajectories.states.robots.is_out[at])
    assert robots.is_out.any()
    is_at_it = robots.is_busy & (robots.verb != Verb.FINISH)
    truth = others & ~robots.is_parked & ~robots.is_out & (is_at_it | (~robots.is_busy & (robots.decisions_to_go > 0)))
    np.testing.assert_array_equal(others_of(picked(states, at)).goes_on, truth)


def test_without_a_hazard_nothing_of_it_is_in_the_log():
    logs = logged(played_teams.played(team_of(2), 20), 0.0)
    assert not [name for name in logs.trajectories.columns if "out" in name]
    assert states_of(logs, 10).robots.is_out is None
    assert cut_at_drop_outs(logs) is logs


def test_a_log_cut_at_drop_outs_is_that_of_a_table_that_ended_there(frail):
    _, logs = frail
    ended = cut_at_drop_outs(logs)
    out_s = np.fmin.reduce(logs.trajectories[[f"{r}_out_s" for r in range(3)]].to_numpy(), axis=1)
    is_out = ~np.isnan(out_s)
    assert 10 < is_out.sum() < 70
    np.testing.assert_array_equal(ended.end_s, np.where(is_out, out_s, logs.end_s))
    assert ended.trajectories["cause"][is_out].eq("battery").all()
    assert ended.trajectories["ending"][~is_out].tolist() == logs.trajectories["ending"][~is_out].tolist()
    assert not ended.stages.filter(like="_does").eq("OUT").any(axis=None)
    for trajectory, stages in ended.stages.groupby("trajectory"):
        whole = logs.stages[logs.stages["trajectory"] == trajectory]
        completed = stages[stages["elapsed_s"].notna()]
        if is_out[trajectory]:
            assert (
                completed["elapsed_s"].tolist() == whole["elapsed_s"][whole["elapsed_s"] < out_s[trajectory]].tolist()
            )
            assert len(stages) == len(completed) + 1
        else:
            pd.testing.assert_frame_equal(stages.reset_index(drop=True), whole.reset_index(drop=True))


@pytest.mark.slow
def test_weights_take_out_of_a_log_cut_at_drop_outs_what_the_drop_outs_did_to_it():
    def total(logs):
        return logs.stages.groupby("trajectory")["reward"].sum().to_numpy()

    num_trajectories = 6000
    truth = total(logged(played_teams.played(team_of(2, horizon=6), num_trajectories, seed=3), 0.0))
    frail_team = team_of(2, horizon=6, drop_out_rate=(0.04, 0.04))
    with_drop_outs = logged(played_teams.played(frail_team, num_trajectories, seed=4), 0.0)
    ended = cut_at_drop_outs(with_drop_outs)
    assert ended.cut_share > 0.5
    weights = stage_weights(ended.elapsed_s(), ended.end_s, ended.is_finished)
    weighted = (weights * np.nan_to_num(ended.stage_values("reward"))).sum(axis=1)

    def apart(values):
        """Difference from the truth, in standard errors."""
        return abs(np.mean(values) - np.mean(truth)) / (
            np.hypot(np.std(values), np.std(truth)) / np.sqrt(num_trajectories)
        )

    assert apart(weighted) < 4.0
    assert apart(total(with_drop_outs)) > 5.0
    assert apart(total(ended)) > 5.0
