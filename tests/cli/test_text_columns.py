"""Text and gaps among the covariates, from the log to the page, in each verb that reads logs."""

import json

import numpy as np
import pandas as pd
import pytest
import shell

from halfseen.errors import LogError, PolicyError
from halfseen.evaluation import QSpec
from halfseen.evaluation import evaluate as evaluated
from halfseen.learning import CensoredQLearner
from halfseen.learning.named_task import NamedActions
from halfseen.logs import Logs, read_logs
from halfseen.logs.missing import MEDIAN
from halfseen.policies import Rule, read_policy
from holes import holed_log
from refusals import refused
from text_logs import ACTIONS, BY_HAND, COVARIATES, by_hand, text_log, with_indicators


def stamped(seed, **columns):
    """With a column that names the trajectory, and one of remarks."""
    names = {
        "order": lambda trajectory, stage: f"order {trajectory}",
        "remark": lambda trajectory, stage: None if trajectory % 2 else "slow",
    }
    return text_log(num_trajectories=80, seed=seed, **names, **columns)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("text")
    stamped(0).write(folder / "logs")
    words = ("learn", folder / "logs", "--out", folder / "policy", *QUICK, "--stages", "separate", "--json")
    (folder / "learned.json").write_text(run(*words))
    return folder


QUICK = ("--reg", 0.01, "--q-function", "linear", "--censoring", "kaplan-meier", "--pessimism", 0)


def run(*words):
    return shell.run(*words).stdout


def refusal(kind, *words):
    with refused(kind=kind) as error:
        run(*words)
    return str(error.value)


def state(folder, name, text):
    (folder / name).write_text(text)
    return folder / name


@pytest.mark.slow
def test_learn_looks_at_text_and_says_what_it_leaves_out(folder):
    report = json.loads((folder / "learned.json").read_text())
    assert report["schema"]["covariates"] == ["x", "colour", "is_heavy"]
    assert report["schema"]["categories"] == {"colour": ["blue", "green", "red"]}
    assert report["notes"] == [
        "it does not look at order, which has more than 20 categories; group them into fewer, or leave it out",
        "it does not look at remark, which is null at trajectory 1, stage 1; fill it in by --missing "
        "remark=median+flag (Python: missing={'remark': 'median+flag'}), or with the rule last, or leave column "
        "'remark' of stages out",
    ]
    logs = by_hand(stamped(0))
    theirs = CensoredQLearner.of_paper(2, ACTIONS, BY_HAND, reg=0.01).fit(logs)
    ours = read_policy(folder / "policy").policy
    for stage in (1, 2):
        rows = stamped(0).stages.query("stage == @stage")
        q = theirs.q_values(with_indicators(rows), stage)
        np.testing.assert_allclose(ours.q_values(rows, stage), q, atol=1e-9)
        taken = theirs.decide(with_indicators(rows), stage)
        assert report["actions"][stage - 1]["shares"]["B"] == pytest.approx(np.mean(taken == "B"))
        assert report["actions"][stage - 1]["as_logged"] == pytest.approx(np.mean(taken == rows["action"]))


@pytest.mark.slow
def test_a_column_that_is_asked_for_and_cannot_be_looked_at_is_refused(folder, tmp_path):
    arguments = ("learn", folder / "logs", "--out", tmp_path / "p", "--covariates")
    assert refusal(LogError, *arguments, "x,remark").startswith(
        "covariate 'remark' is null at trajectory 1, stage 1; fill"
    )
    assert refusal(LogError, *arguments, "order").startswith("covariate 'order' has more than 20 categories; group")
    assert not (tmp_path / "p").exists()


def test_act_takes_text_as_csv_or_json_and_tells_what_speaks_for_the_action(folder, tmp_path):
    as_json = state(tmp_path, "a.json", '{"x": 0.1, "colour": "blue", "is_heavy": true, "stage": 1}')
    as_csv = state(tmp_path, "a.csv", "colour,is_heavy,x,stage\nblue,True,0.1,1\n")
    report = shell.report("act", folder / "policy", as_json)
    assert run("act", folder / "policy", as_csv) == run("act", folder / "policy", as_json)
    row = pd.DataFrame({"x": [0.1], "colour": ["blue"], "is_heavy": [True]})
    policy = read_policy(folder / "policy").policy
    assert report["q_values"] == dict(zip(ACTIONS, policy.q_values(row, 1)[0].tolist(), strict=True))
    commonest = stamped(0).stages.query("stage == 1")["colour"].mode()[0]
    q = policy.q_values(row.assign(colour=commonest), 1)[0]
    assert (report["action"], commonest, report["warnings"]) == ("A", "red", [])
    assert report["reason"].endswith(
        "mainly because colour is blue: at red (most frequent in the logs), it would be worth "
        f"{q[1] - q[0]:.2f} less than B."
    )


@pytest.mark.slow
def test_act_warns_of_a_category_that_this_stage_never_showed(folder, tmp_path):
    log = stamped(0)
    late = log.stages.assign(colour=log.stages["colour"].where(log.stages["stage"] == 2, "red"))
    Logs(late, log.trajectories).write(tmp_path / "logs")
    run("learn", tmp_path / "logs", "--out", tmp_path / "policy", *QUICK, "--stages", "separate")
    blue = state(tmp_path, "a.json", '{"x": 0.1, "colour": "blue", "is_heavy": true}')
    message = "colour is blue, which no state of the logs showed at this stage; Q is extrapolated"
    assert shell.report("act", tmp_path / "policy", blue)["warnings"] == [message]
    assert shell.report("act", tmp_path / "policy", blue, "--stage", 2)["warnings"] == []


def test_act_says_of_another_spelling_that_it_is_one(folder, tmp_path):
    file = state(tmp_path, "a.json", '{"x": 0.1, "colour": "Blue", "is_heavy": true}')
    message = refusal(PolicyError, "act", folder / "policy", file)
    assert "covariate 'colour': 'Blue' and 'blue' differ only in spelling, and the training log" in message


@pytest.mark.parametrize("text", ['"mauve"', "null", "7"])
def test_act_refuses_what_it_does_not_know(folder, tmp_path, text):
    file = state(tmp_path, "a.json", f'{{"x": 0.1, "colour": {text}, "is_heavy": true}}')
    message = refusal(PolicyError, "act", folder / "policy", file)
    value = text.replace('"', "'") if text != "7" else "'7'"
    known = f"row 0: covariate 'colour' is {value}, which the training log lacks"
    what = "covariate 'colour' is null; fill it in" if text == "null" else known
    assert message.startswith(f"{file}: {what}")
    file = state(tmp_path, "a.csv", f"x,colour,is_heavy\n0.1,{text},True\n")
    assert "give one of 'blue', 'green', 'red'" in refusal(PolicyError, "act", folder / "policy", file)


def test_codes_that_are_text_are_read_as_text(tmp_path):
    log = text_log(colours=("01", "02", "NA"))
    log.write(tmp_path / "logs")
    run("learn", tmp_path / "logs", "--out", tmp_path / "policy", *QUICK)
    for code in ("01", "NA"):
        as_json = state(tmp_path, "a.json", f'{{"x": 0.1, "colour": "{code}", "is_heavy": true}}')
        as_csv = state(tmp_path, "a.csv", f"x,colour,is_heavy\n0.1,{code},true\n")
        assert run("act", tmp_path / "policy", as_csv) == run("act", tmp_path / "policy", as_json)


@pytest.mark.slow
@pytest.mark.parametrize("propensity", ["logged", "estimated"])
def test_evaluation_is_that_of_indicators(propensity):
    def red(frame, stage):
        return np.where(frame["colour"] == "red", "B", "A")

    def red_by_hand(frame, stage):
        return np.where(frame["colour=red"] == 1.0, "B", "A")

    logs, spec = text_log(), {"propensity": propensity, "censoring": "cox"}
    ours = evaluated(Rule(red, tuple(ACTIONS), 2), logs, q=QSpec(NamedActions(ACTIONS, COVARIATES)), **spec)
    q = QSpec(NamedActions(ACTIONS, BY_HAND))
    theirs = evaluated(Rule(red_by_hand, tuple(ACTIONS), 2), by_hand(logs), q=q, **spec)
    for name in ("doubly_robust", "fitted_q", "importance_sampling", "logging", "difference"):
        assert getattr(ours, name).value == pytest.approx(getattr(theirs, name).value, abs=1e-9)
    assert [one.difference.value for one in ours.comparisons if one.difference] == pytest.approx(
        [one.difference.value for one in theirs.comparisons if one.difference], abs=1e-9
    )


PLAIN = ("--reg", 0.01, "--q-function", "linear", "--censoring", "kaplan-meier", "--no-verdict")


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("missing") / "logs"
    holed_log(0.2).write(folder)
    return folder


@pytest.mark.slow
def test_learn_and_evaluate_read_a_log_by_the_rules(logs, tmp_path):
    rules = ("--missing", "median+flag,is_heavy=last")
    learned = shell.report("learn", logs, "--out", tmp_path / "p", *rules, *PLAIN)
    assert learned["schema"]["covariates"] == ["x", "colour", "is_heavy", "x_missing"]
    assert learned["notes"][0].startswith("x is missing in ")
    one = shell.report("evaluate", tmp_path / "p", "--logs", logs)
    assert one["is_learned_from_these_logs"]
    named = shell.report("learn", logs, "--out", tmp_path / "q", *rules, *PLAIN, "--covariates", "x")
    assert named["schema"]["covariates"] == ["x", "x_missing"]
    seen = shell.report("inspect", logs, "--missing", "last")
    assert [line.partition(" ")[0] for line in seen["missing"]] == ["x", "colour", "is_heavy"]
    with refused("--missing x=median.flag"):
        shell.run("inspect", logs)


@pytest.mark.slow
def test_evaluate_fills_in_what_the_policy_has_no_rule_for(logs, tmp_path):
    shell.run("learn", logs, "--out", tmp_path / "p", "--missing", "x=last", "--covariates", "x", *PLAIN)
    evaluated = ("evaluate", tmp_path / "p", "--logs", logs, "--json")
    assert json.loads(shell.run(*evaluated).stdout)["sentence"]
    holed_log(0.2, num_trajectories=30, seed=1).write(tmp_path / "other")
    result = shell.report("evaluate", tmp_path / "p", "--logs", tmp_path / "other", "--missing", "last")
    assert not result["is_learned_from_these_logs"]


def test_convert_keeps_null_and_says_so(logs, tmp_path):
    result = shell.report("convert", logs, "--out", f"csv:{tmp_path / 'csv'}")
    raw = read_logs(logs, missing="keep").stages
    assert result["missing"] == {name: int(raw[name].isna().sum()) for name in ("x", "colour", "is_heavy")}
    shell.run("convert", tmp_path / "csv", "--out", tmp_path / "again")
    assert read_logs(tmp_path / "again", missing=MEDIAN).filling == read_logs(logs, missing=MEDIAN).filling
    with refused("column 'x' is null in"):
        shell.run("convert", logs, "--out", "minari:holes-v0")


@pytest.mark.parametrize(
    ("rule", "message"),
    [
        ("mean", ": missing is 'mean'"),
        ("x=mean", ": missing of 'x' is 'mean'"),
        ("y=last", ": missing names 'y'; the stages have x, colour, is_heavy"),
        ("colour=last", "covariate x is null"),
    ],
)
def test_a_rule_that_is_none_is_refused(rule, message, logs, tmp_path):
    with refused(message):
        shell.run("learn", logs, "--out", tmp_path / "p", "--missing", rule)


def test_evaluate_refuses_text_where_the_policy_was_learned_from_numbers(folder, tmp_path):
    log = stamped(1)
    Logs(log.stages.assign(x=[f"bin {row}" for row in range(len(log.stages))]), log.trajectories).write(
        tmp_path / "logs"
    )
    message = refusal(LogError, "evaluate", folder / "policy", "--logs", tmp_path / "logs")
    assert "stage 1: covariate 'x' is not numeric, but 'bin 0'; give numbers" in message
