"""A server fills in what a state lacks: as act does, within an episode as a log, and records what the policy saw."""

import json
from shutil import copytree

import numpy as np
import pandas as pd
import pytest
from asking import OF_ACT, client_of, ended, refused, rewarded, written
from click.testing import CliRunner

from halfseen.cli.act import act
from halfseen.logs import read_logs
from halfseen.logs.missing import LAST, MEDIAN
from halfseen.policies.folder import read_policy
from holes import holed_log
from text_logs import ACTIONS

RULES = {"x": LAST, "colour": LAST, "is_heavy": MEDIAN}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    log = holed_log(0.3, missing=RULES)
    return written(tmp_path_factory.mktemp("serving") / "policy", log, log.stage_covariates, ACTIONS)


def acted(folder, state, tmp_path):
    (tmp_path / "state.json").write_text(json.dumps(state))
    done = CliRunner().invoke(act, [str(folder), str(tmp_path / "state.json"), "--json"], catch_exceptions=False)
    return json.loads(done.output)


@pytest.mark.parametrize("state", [{}, {"x": None, "colour": "red"}, {"x": 0.5, "colour": None, "is_heavy": 0}])
def test_without_a_history_it_says_what_act_says(state, folder, tmp_path):
    said = acted(folder, {**state, "stage": 2}, tmp_path)
    with client_of(folder) as client:
        told = client.post("/decide", json={**state, "stage": 2}).json()
    assert {name: told[name] for name in said.keys() - OF_ACT} == {
        name: value for name, value in said.items() if name not in OF_ACT
    }
    assert told["filled"] == [name for name in ("x", "colour", "is_heavy") if state.get(name) is None]


def test_within_an_episode_the_last_value_stands_and_is_recorded_as_the_policy_saw_it(folder, tmp_path):
    raw = holed_log(0.3, seed=5, num_trajectories=12)
    names = raw.stage_covariates
    expected = read_policy(folder).policy.filling.of_log(raw.stages)
    with client_of(folder, tmp_path / "logs") as client:
        for _, stages in raw.stages.groupby("trajectory"):
            for row in stages.to_dict("records"):
                state = {name: None if pd.isna(row[name]) else row[name] for name in names}
                state["is_heavy"] = None if state["is_heavy"] is None else int(state["is_heavy"])
                told = client.post("/decide", json=state).json()
                assert told["filled"] == [name for name, value in state.items() if value is None]
                rewarded(client)
            client.post("/end", json={"ending": "finished"}).raise_for_status()
    found = read_logs(tmp_path / "logs").stages
    for name in (*names, "is_heavy_missing"):
        np.testing.assert_array_equal(found[name], expected[name])
    again = read_logs(tmp_path / "logs", missing=RULES).filling
    assert again is not None
    assert again.fills["is_heavy"].num_missing == expected["is_heavy_missing"].sum()


def test_what_has_no_rule_is_refused_in_one_line(tmp_path):
    log = holed_log(0.3, missing=RULES)
    plain = type(log)(log.stages, log.trajectories)
    with client_of(written(tmp_path / "policy", plain, ["x", "colour"], ACTIONS)) as client:
        for name in ("x", "colour"):
            line = refused(client.post("/decide", json={"x": 1.0, "colour": "red", name: None}), 422)
            assert f"covariate {name!r} is null" in line
            assert f"leave the state out, or learn the policy with --missing {name}=median+flag" in line
        assert "'x' is missing (given: colour)" in refused(client.post("/decide", json={"colour": "red"}), 422)


def test_a_policy_with_a_flag_records_on_after_one_without_and_the_other_way_round(folder, tmp_path):
    log, plain, serving, logs = holed_log(0.0), tmp_path / "plain", tmp_path / "policy", tmp_path / "logs"
    written(plain, log, ["x", "colour", "is_heavy"], ACTIONS)
    copytree(plain, serving)
    with client_of(serving, logs) as client:
        client.event_hooks = {}  # what may be asked changes
        for policy, seen in ((plain, {"is_heavy": 1}), (folder, {}), (plain, {"is_heavy": 0})):
            copytree(policy, serving, dirs_exist_ok=True)
            client.post("/reload").raise_for_status()
            client.post("/decide", json={"x": 0.5, "colour": "red", **seen}).raise_for_status()
            ended(client)
    assert read_logs(logs).stages["is_heavy_missing"].tolist() == [0, 1, 0]
