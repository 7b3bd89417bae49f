"""A log tells who dropped out, when and why; whoever wants it has it cut there."""

import numpy as np
import pandas as pd
import pytest

from halfseen.censoring.weights import stage_weights
from halfseen.errors import LogError
from halfseen.logs import Logs, read_logs
from halfseen.world.actions import Verb
from halfseen.world.cuts import cut_at_drop_outs
from halfseen.world.logs import states_of
from halfseen.world.others import others_of
from picked import picked
from played_teams import logged, played, team_of

RATES = (0.03, 0.01, 0.0)


@pytest.fixture(scope="module")
def paths():
    return played(team_of(3, drop_out_rate=RATES), 80)


@pytest.fixture(scope="module")
def logs(paths):
    return logged(paths, 0.3)


def test_paths_tell_when_and_why_each_robot_dropped_out(paths, logs, tmp_path):
    until_s = np.asarray(paths.hidden.until_out_s)
    for r in range(3):
        out_s = logs.paths[f"{r}_out_s"].to_numpy()
        seen = ~np.isnan(out_s)
        np.testing.assert_allclose(out_s[seen], until_s[seen, r], rtol=1e-5)
        assert (out_s[seen] <= logs.end_s[seen]).all()
        assert logs.paths[f"{r}_out_cause"].eq("battery").to_numpy(dtype=bool).tolist() == seen.tolist()
    share = [logs.paths[f"{r}_out_s"].notna().mean() for r in range(3)]
    assert share[0] > share[1] > share[2] == 0.0
    logs.write(tmp_path / "log")
    again = read_logs(tmp_path / "log")
    pd.testing.assert_frame_equal(again.paths, logs.paths)


def test_who_drew_a_drop_out_before_the_end_and_did_not_drop_out_had_come_to_its_end(paths, logs):
    until_s, states = np.asarray(paths.hidden.until_out_s), paths.states.robots
    last = logs.stages.groupby("path")["stage"].max().to_numpy() - 1
    for k, end_s in enumerate(logs.end_s):
        for r in range(3):
            if until_s[k, r] < end_s and np.isnan(logs.paths[f"{r}_out_s"][k]):
                is_going_home = states.is_busy[k, last[k], r] and states.verb[k, last[k], r] == 0
                is_spent = states.decisions_to_go[k, last[k], r] <= 1
                assert states.is_parked[k, last[k], r] or is_going_home or is_spent


def test_from_then_on_stages_say_out_and_the_robot_decides_no_more(logs):
    stages = logs.stages.merge(logs.paths, on="path")
    begin_s = stages["elapsed_s"].groupby(stages["path"]).shift(fill_value=0.0)
    for r in range(3):
        is_out = begin_s >= stages[f"{r}_out_s"]
        np.testing.assert_array_equal(stages[f"{r}_does"] == "OUT", is_out)
        assert not (is_out & (stages["robot"] == r)).any()


def test_states_come_back_and_who_is_out_does_not_go_on(paths, logs):
    horizon = paths.action.shape[1]
    states = states_of(logs, horizon)
    at = logs.stages["path"].to_numpy(), logs.stages["stage"].to_numpy() - 1
    np.testing.assert_array_equal(np.asarray(states.robots.is_out)[at], np.asarray(paths.states.robots.is_out)[at])
    assert np.asarray(states.robots.is_out)[at].any()
    goes_on = others_of(picked(states, at)).goes_on
    robots = picked(states.robots, at)
    others = np.arange(3) != np.asarray(states.decider)[at][:, None]
    is_at_it = robots.is_busy & (robots.verb != Verb.FINISH)
    truth = others & ~robots.is_parked & ~robots.is_out & (is_at_it | (~robots.is_busy & (robots.decisions_to_go > 0)))
    np.testing.assert_array_equal(goes_on, truth)


def test_without_a_hazard_nothing_of_it_is_in_the_log():
    logs = logged(played(team_of(2), 20), 0.0)
    assert not [name for name in logs.paths.columns if "out" in name]
    assert states_of(logs, 10).robots.is_out is None
    assert cut_at_drop_outs(logs) is logs


def test_a_log_cut_at_drop_outs_is_that_of_a_table_that_ended_there(logs):
    cut = cut_at_drop_outs(logs)
    out_s = np.fmin.reduce(logs.paths[[f"{r}_out_s" for r in range(3)]].to_numpy(), axis=1)
    is_out = ~np.isnan(out_s)
    assert 10 < is_out.sum() < 70
    np.testing.assert_array_equal(cut.end_s, np.where(is_out, out_s, logs.end_s))
    assert cut.paths["cause"][is_out].eq("battery").all()
    assert cut.paths["ending"][~is_out].tolist() == logs.paths["ending"][~is_out].tolist()
    assert not cut.stages.filter(like="_does").eq("OUT").any(axis=None)
    for path, stages in cut.stages.groupby("path"):
        whole = logs.stages[logs.stages["path"] == path]
        completed = stages[stages["elapsed_s"].notna()]
        if is_out[path]:
            assert completed["elapsed_s"].tolist() == whole["elapsed_s"][whole["elapsed_s"] < out_s[path]].tolist()
            assert len(stages) == len(completed) + 1
        else:
            pd.testing.assert_frame_equal(stages.reset_index(drop=True), whole.reset_index(drop=True))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"0_out_s": lambda paths: paths["end_s"] + 1.0}, r"path 0: 0_out_s [\d.]+ lies outside the path"),
        ({"0_out_s": -1.0}, r"path 0: 0_out_s -1.0 lies outside the path"),
        ({"0_out_s": np.inf}, r"path 0: 0_out_s inf lies outside the path"),
        ({"2_out_cause": "battery"}, r"path 0: 2_out_cause is given, yet 2_out_s is not"),
        ({"0_out_s": 1e-3}, r"robot 0 decides at [\d.]+ s, yet dropped out at 0.001 s"),
    ],
)
def test_a_drop_out_that_cannot_be_is_refused(logs, change, told):
    with pytest.raises(LogError, match=told):
        Logs(logs.stages, logs.paths.assign(**change), logs.objects)


def test_what_a_robot_brought_is_a_number_where_the_stage_was_completed(logs):
    with pytest.raises(LogError, match=r"path 0, stage 1: 1_reward is null; give a finite number for each completed"):
        Logs(logs.stages.assign(**{"1_reward": np.nan}), logs.paths, logs.objects)
    assert "1_reward" not in logs.stage_covariates
    assert "1_since_s" in logs.stage_covariates


@pytest.mark.slow
def test_weights_take_out_of_a_log_cut_at_drop_outs_what_the_drop_outs_did_to_it():
    num_paths = 6000
    truth = total(logged(played(team_of(2, horizon=6), num_paths, seed=3), 0.0))
    with_drop_outs = logged(played(team_of(2, horizon=6, drop_out_rate=(0.04, 0.04)), num_paths, seed=4), 0.0)
    cut = cut_at_drop_outs(with_drop_outs)
    assert cut.cut_share > 0.5
    weights = stage_weights(cut.elapsed_s(), cut.end_s, cut.is_finished)
    weighted = (weights * np.nan_to_num(cut.stage_values("reward"))).sum(axis=1)

    def apart(values):
        """Difference from the truth, in standard errors."""
        spread = np.hypot(np.std(values), np.std(truth)) / np.sqrt(num_paths)
        return abs(np.mean(values) - np.mean(truth)) / spread

    assert apart(weighted) < 4.0
    assert apart(total(with_drop_outs)) > 5.0
    assert apart(total(cut)) > 5.0


def total(logs):
    return logs.stages.groupby("path")["reward"].sum().to_numpy()
