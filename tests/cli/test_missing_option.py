"""``--missing``, in each verb that reads logs to learn from or to judge by."""

import json

import pytest
import shell

from halfseen.logs import read_logs
from halfseen.logs.missing import MEDIAN
from holes import holed_log
from refusals import refused

QUICK = ("--reg", 0.01, "--q-function", "linear", "--censoring", "kaplan-meier", "--no-verdict")


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("missing") / "logs"
    holed_log(0.2).write(folder)
    return folder


def test_learn_and_evaluate_read_a_log_by_the_rules(logs, tmp_path):
    rules = ("--missing", "median+flag,is_heavy=last")
    learned = json.loads(shell.run("learn", logs, "--out", tmp_path / "p", *rules, *QUICK, "--json").stdout)
    assert learned["schema"]["covariates"] == ["x", "colour", "is_heavy", "x_missing"]
    assert learned["notes"][0].startswith("x is missing in ")
    one = json.loads(shell.run("evaluate", tmp_path / "p", "--logs", logs, "--json").stdout)
    assert one["is_learned_from_these_logs"]
    named = json.loads(
        shell.run("learn", logs, "--out", tmp_path / "q", *rules, *QUICK, "--covariates", "x", "--json").stdout
    )
    assert named["schema"]["covariates"] == ["x", "x_missing"]
    seen = json.loads(shell.run("inspect", logs, "--missing", "last", "--json").stdout)
    assert [line.partition(" ")[0] for line in seen["missing"]] == ["x", "colour", "is_heavy"]
    with refused("--missing x=median.flag"):
        shell.run("inspect", logs)


def test_evaluate_fills_in_what_the_policy_has_no_rule_for(logs, tmp_path):
    shell.run("learn", logs, "--out", tmp_path / "p", "--missing", "x=last", "--covariates", "x", *QUICK)
    evaluated = ("evaluate", tmp_path / "p", "--logs", logs, "--json")
    assert json.loads(shell.run(*evaluated).stdout)["sentence"]
    holed_log(0.2, num_trajectories=30, seed=1).write(tmp_path / "other")
    told = json.loads(
        shell.run("evaluate", tmp_path / "p", "--logs", tmp_path / "other", "--missing", "last", "--json").stdout
    )
    assert not told["is_learned_from_these_logs"]


def test_convert_keeps_null_and_says_so(logs, tmp_path):
    told = json.loads(shell.run("convert", logs, "--out", f"csv:{tmp_path / 'csv'}", "--json").stdout)
    raw = read_logs(logs, missing="keep").stages
    assert told["missing"] == {name: int(raw[name].isna().sum()) for name in ("x", "colour", "is_heavy")}
    shell.run("convert", tmp_path / "csv", "--out", tmp_path / "again")
    assert read_logs(tmp_path / "again", missing=MEDIAN).filling == read_logs(logs, missing=MEDIAN).filling
    with refused("column 'x' is null in"):
        shell.run("convert", logs, "--out", "minari:holes-v0")


@pytest.mark.parametrize(
    ("rule", "told"),
    [
        ("mean", ": missing is 'mean'"),
        ("x=mean", ": missing of 'x' is 'mean'"),
        ("y=last", ": missing names 'y'; the stages have x, colour, is_heavy"),
        ("colour=last", "covariate x is null"),
    ],
)
def test_a_rule_that_is_none_is_refused(rule, told, logs, tmp_path):
    with refused(told):
        shell.run("learn", logs, "--out", tmp_path / "p", "--missing", rule)
