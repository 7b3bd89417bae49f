import html
import json
import shlex
import sys
from pathlib import Path

import pytest

from halfseen.errors import ArgumentError, HalfseenError, LogError, PolicyError
from halfseen.learning import CensoredQLearner
from halfseen.policies.folder import write_policy

sys.path.insert(0, str(Path(__file__).parents[1] / "report"))
from functools import partial

import shell
from small_report import ACTIONS, COVARIATES, hostile_log

from small_logs import flat_log, table_log

run, refused = partial(shell.run, "report"), partial(shell.refusal, "report")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report-verb")
    logs = hostile_log(num_paths=24)
    logs.write(folder / "logs")
    flat_log().write(folder / "other")
    table_log().write(folder / "tables")
    learner = CensoredQLearner.of_paper(2, ACTIONS, COVARIATES, reg=0.1).fit(logs)
    write_policy(learner, logs, folder / "policy")
    return folder


def test_says_the_answer_and_where_the_page_is_and_the_same_again(folder, tmp_path):
    arguments = [folder / "logs", folder / "policy", "--replicates", 4, "--seed", 2]
    first = run(*arguments, "--out", tmp_path / "a.html")
    answer, place = first.stdout.splitlines()
    assert answer.split(":")[0] in ("Better", "Not better", "Cannot be said")
    assert place == f"The page: {tmp_path / 'a.html'}"
    assert first.stderr == ""
    second = run(*arguments, "--out", tmp_path / "b.html", "--json")
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()
    page = (tmp_path / "a.html").read_text()
    assert f"halfseen report {folder / 'logs'} {folder / 'policy'} --replicates 4 --seed 2" in page

    def refuse(name):
        raise AssertionError(f"{name} is no number of JSON")

    numbers = json.loads(second.stdout, parse_constant=refuse)
    assert numbers["value"]["sentence"] == answer
    assert set(numbers["value"]["difference"]) >= {"value", "low", "high", "effective_sample_size"}
    assert numbers["log"]["num_paths"] == 24
    assert numbers["policy"]["is_learned_from_these_logs"] is True
    assert len(numbers["policy"]["curves"]) == 4
    assert numbers["log"]["watched"]["num_watched"][0] == 24
    assert numbers["seed"] == 2


def test_the_page_is_against_whom_it_is_told(folder, tmp_path):
    sequence = "sequence:" + ",".join([ACTIONS[0]] * 2)
    arguments = [folder / "logs", folder / "policy", "--replicates", 4, "--against", sequence, "--against", "logging"]
    numbers = json.loads(run(*arguments, "--out", tmp_path / "a.html", "--json").stdout)
    opponents = [each["opponent"] for each in numbers["value"]["comparisons"]]
    assert len(opponents) == 2
    assert opponents[1] == "the logging policy"
    page = html.unescape((tmp_path / "a.html").read_text())
    assert f"--against {shlex.quote(sequence)} --against logging --replicates 4" in page


def test_without_a_policy_the_page_is_of_the_log(folder, tmp_path):
    told = run(folder / "logs", "--out", tmp_path / "a.html", "--unit", "parts")
    answer, place = told.stdout.splitlines()
    assert answer.startswith("24 paths: ")
    assert place == f"The page: {tmp_path / 'a.html'}"
    page = (tmp_path / "a.html").read_text()
    assert f"halfseen report {folder / 'logs'} --unit parts --seed 0" in page
    assert "Rewards are in parts." in page
    numbers = json.loads(run(folder / "logs", "--out", tmp_path / "b.html", "--unit", "parts", "--json").stdout)
    assert "policy_folder" not in numbers
    assert numbers["log"]["reward_unit"] == "parts"
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()


def test_what_is_said_of_a_policy_needs_one(folder, tmp_path):
    for option in (
        ("--against", "logging"),
        ("--censoring", "cox"),
        ("--replicates", 7),
        ("--propensity", "estimated"),
    ):
        error = refused(folder / "logs", "--out", tmp_path / "a.html", *option)
        assert isinstance(error, ArgumentError)
        assert f"{option[0]} is said of a policy, and none is given" in str(error)
    assert list(tmp_path.iterdir()) == []


def test_bad_input_is_one_line_and_nothing_is_written(folder, tmp_path):
    out, there = tmp_path / "out.html", tmp_path / "there.html"
    there.write_text("mine")
    cases = [
        ((tmp_path / "none", folder / "policy", "--out", out), LogError, "there is no such folder"),
        ((folder / "logs", tmp_path / "none", "--out", out), PolicyError, "there is no such folder"),
        ((folder / "logs", folder / "logs", "--out", out), PolicyError, "it is missing"),
        ((folder / "other", folder / "policy", "--out", out), LogError, "is missing"),
        ((folder / "tables", folder / "policy", "--out", out), HalfseenError, "covariate 'x<1>' is missing"),
        ((folder / "logs", folder / "policy", "--out", out, "--truncate-at", 0.5), ArgumentError, "truncate_at is 0.5"),
        ((folder / "logs", folder / "policy", "--out", out, "--unit", "x" * 30), LogError, "reward_unit is 'xxx"),
        ((folder / "logs", folder / "policy", "--out", there), ArgumentError, "it is there already"),
        ((folder / "logs", folder / "policy", "--out", there, "--overwrite"), ArgumentError, "it is no page"),
    ]
    for arguments, kind, message in cases:
        error = refused(*arguments)
        assert isinstance(error, kind), arguments
        assert message in str(error)
    assert there.read_text() == "mine"
    assert [path.name for path in tmp_path.iterdir()] == ["there.html"]
