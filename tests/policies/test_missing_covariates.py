"""A policy fills in what a state lacks as its log was: in Python, from its folder, by act, by serve and by evaluate."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

from halfseen.cli.act import act
from halfseen.errors import LogError, PolicyError
from halfseen.learning import CensoredQLearner
from halfseen.logs import Logs, LogStream, read_logs
from halfseen.logs.missing import LAST, MEDIAN
from halfseen.policies import NamedObservation, decider_of, read_policy
from halfseen.policies.folder import write_policy
from halfseen.policies.learner_choice import learner_for
from holes import holed_log
from refusals import refused
from text_logs import ACTIONS

RULES = {"*": MEDIAN, "is_heavy": LAST}


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("missing") / "logs"
    holed_log(0.2).write(folder)
    return folder


@pytest.fixture(scope="module")
def folder(logs):
    log = read_logs(logs, missing=RULES)
    learner = CensoredQLearner.of_paper(2, ACTIONS, log.stage_covariates, reg=0.1).fit(log)
    write_policy(learner, log, logs.parent / "policy")
    return logs.parent / "policy"


def states_of(logs):
    """Each stage of the log as a state, with the covariates of the stage before, and as it is filled in."""
    raw, full = read_logs(logs, missing="keep"), read_logs(logs, missing=RULES)
    before, trajectory = None, None
    for one, filled in zip(raw.stages.to_dict("records"), full.stages.to_dict("records"), strict=True):
        before = before if one["trajectory"] == trajectory else None
        state = {name: None if pd.isna(one[name]) else one[name] for name in raw.stage_covariates}
        yield state, before, {name: filled[name] for name in full.stage_covariates}, one["stage"]
        before, trajectory = {name: filled[name] for name in full.stage_covariates}, one["trajectory"]


def test_the_folder_keeps_what_the_log_taught(folder, logs):
    policy = read_policy(folder).policy
    assert policy.filling == read_logs(logs, missing=RULES).filling
    assert policy.covariates == ("x", "colour", "is_heavy", "x_missing")
    assert policy.categories["colour"] == ("blue", "green", "missing", "red")


def test_a_decision_is_that_of_the_filled_row(folder, logs):
    stored = read_policy(folder)
    decider = decider_of(stored)
    for state, before, full, stage in list(states_of(logs))[:40]:
        expected = decider.decide(NamedObservation(pd.DataFrame([full]), stage))
        lacking = tuple(name for name, value in state.items() if value is None)
        without = {name: value for name, value in state.items() if value is not None}
        for row in (state, without, pd.DataFrame([state])):
            found = decider.decide(NamedObservation(row, stage, last=before))
            assert (found.action, found.q_values, found.filled) == (expected.action, expected.q_values, lacking)
            assert len(found.warnings) == len(expected.warnings) + len(lacking)


def test_a_policy_in_memory_fills_in_states_without_a_history(folder, logs):
    policy, log = read_policy(folder).policy, read_logs(logs, missing=MEDIAN)
    raw = read_logs(logs, missing="keep").stages
    first = (raw["stage"] == 1).to_numpy()
    full = policy.q_values(log.stages[first], 1)
    np.testing.assert_array_equal(policy.q_values(raw[first], 1), full)
    all_lack = raw[first].drop(columns=["x", "is_heavy"])
    nothing = raw[first].assign(x=None, is_heavy=None)
    np.testing.assert_array_equal(policy.q_values(all_lack, 1), policy.q_values(nothing, 1))
    assert policy.decide(nothing, 1).tolist() == policy.decide(all_lack, 1).tolist()


def test_a_covariate_without_a_rule_is_refused(logs, tmp_path):
    log = read_logs(logs, missing={"x": LAST, "is_heavy": LAST})
    learner = CensoredQLearner.of_paper(2, ACTIONS, ["x", "is_heavy"], reg=0.1).fit(log)
    write_policy(learner, log, tmp_path / "policy")
    whole = Logs(log.stages[["trajectory", "stage", "elapsed_s", "action", "reward", "is_heavy"]].assign(x=0.0, y=1.0),
                 log.trajectories, missing={"x": LAST})  # fmt: skip
    other = CensoredQLearner.of_paper(2, ACTIONS, ["x", "y"], reg=0.1).fit(whole)
    decider = decider_of(other.policy_)
    with refused("covariate 'y' is nan|'y'", (LogError, PolicyError)):
        decider.decide(NamedObservation({"x": None, "y": None}, 1))
    with refused("'y' is missing", PolicyError):
        decider.decide(NamedObservation({"x": None}, 1))


@pytest.mark.parametrize(
    ("break_it", "message"),
    [
        (lambda missing: missing["fills"]["x"].update(rule="mean"), "rule"),
        (lambda missing: missing["fills"]["x"].update(value=None, has_flag=True), "only numbers have a flag"),
        (lambda missing: missing["fills"]["x"].update(num_missing=-1), "num_missing"),
        (lambda missing: missing.update(num_stages=0), "num_stages"),
        (lambda missing: missing.pop("fills"), "fills"),
    ],
)
def test_a_broken_rule_of_a_folder_is_refused(break_it, message, folder):
    from halfseen.policies.folder.record import as_json, from_json
    from halfseen.policies.folder.stored import policy_of

    stored = read_policy(folder)
    record = json.loads(as_json(stored.record))
    break_it(record["schema"]["missing"])
    with refused(message, PolicyError):
        policy_of(from_json(as_json(record)), {"coefficients": stored.policy.coefficients})


def acted(folder, state, *words):
    done = CliRunner().invoke(act, [str(folder), str(state), "--json", *words], catch_exceptions=False)
    return json.loads(done.output)


@pytest.mark.parametrize("form", ["json", "csv"])
def test_act_fills_in_a_file(form, folder, tmp_path):
    files = {
        "json": '{"x": null, "is_heavy": true, "stage": 2}',
        "csv": "x,colour,is_heavy,stage\n,,True,2\n",
    }
    (tmp_path / f"state.{form}").write_text(files[form])
    result = acted(folder, tmp_path / f"state.{form}")
    assert result["filled"] == ["x", "colour"]
    filling = read_policy(folder).policy.filling
    full = {"x": filling.fills["x"].value, "x_missing": 1, "colour": "missing", "is_heavy": 1, "stage": 2}
    (tmp_path / "full.json").write_text(json.dumps(full))
    expected = acted(folder, tmp_path / "full.json")
    assert {**result, "warnings": [], "filled": [], "input": ""} == {**expected, "warnings": [], "input": ""}
    assert result["warnings"][:2] == [
        f"x is missing and is replaced by {full['x']:.6g}, the median of the logs",
        "colour is missing and is replaced by 'missing', a category of its own",
    ]


@pytest.mark.slow
def test_what_is_learned_in_passes_is_what_the_whole_teaches(logs, tmp_path):
    found = []
    for number, log in enumerate((read_logs(logs, missing=RULES), LogStream(logs, 9, missing=RULES))):
        learner = learner_for(log, reg=0.01, q_function="linear", censoring="kaplan-meier", random_state=1).learner
        write_policy(learner.fit(log), log, tmp_path / str(number))
        found.append(read_policy(tmp_path / str(number)))
    whole, stream = found
    assert whole.record["schema"] == stream.record["schema"]
    assert whole.record["log"]["sha256"] == stream.record["log"]["sha256"]
    np.testing.assert_allclose(stream.policy.coefficients, whole.policy.coefficients, rtol=1e-7, atol=1e-9)


def test_a_model_for_controllers_says_what_stands_for_what_is_missing(folder):
    onnx = pytest.importorskip("onnx")
    from halfseen.policies.onnx_model import onnx_model

    model = onnx.load_from_string(onnx_model(read_policy(folder)))
    said = json.loads({each.key: each.value for each in model.metadata_props}["missing"])
    assert said["fills"]["x"]["value"] == read_policy(folder).policy.filling.fills["x"].value


def test_the_folder_of_a_policy_without_rules_says_nothing_of_them(logs, tmp_path):
    log = read_logs(logs, missing=RULES)
    plain = Logs(log.stages, log.trajectories)
    write_policy(CensoredQLearner.of_paper(2, ACTIONS, ["x"], reg=0.1).fit(plain), plain, tmp_path / "policy")
    assert "missing" not in json.loads(Path(tmp_path / "policy" / "policy.json").read_text())["schema"]
