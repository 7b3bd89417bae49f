import html
import json
import shlex
from functools import partial

import pytest
import shell

from halfseen.learning import CensoredQLearner
from halfseen.policies.folder import write_policy
from small_report import ACTIONS, COVARIATES, hostile_log

run = partial(shell.run, "report")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report-verb")
    logs = hostile_log(num_trajectories=24)
    logs.write(folder / "logs")
    learner = CensoredQLearner.of_paper(2, ACTIONS, COVARIATES, reg=0.1).fit(logs)
    write_policy(learner, logs, folder / "policy")
    return folder


def test_says_the_answer_and_where_the_page_is_and_the_same_again(folder, tmp_path):
    arguments = [folder / "logs", folder / "policy", "--replicates", 4, "--seed", 2]
    first = run(*arguments, "--out", tmp_path / "a.html")
    answer, place = first.stdout.splitlines()
    assert answer.split(":")[0] in ("Better", "Not better", "Inconclusive")
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
    assert numbers["log"]["num_trajectories"] == 24
    assert numbers["policy"]["is_learned_from_these_logs"] is True
    assert len(numbers["policy"]["curves"]) == 4
    assert numbers["log"]["watched"]["num_watched"][0] == 24
    assert numbers["seed"] == 2


def test_the_page_is_against_whom_it_is_told(folder, tmp_path):
    sequence = "sequence:" + ",".join([ACTIONS[0]] * 2)
    arguments = [folder / "logs", folder / "policy", "--replicates", 4, "--against", sequence, "--against", "logging"]
    numbers = json.loads(run(*arguments, "--out", tmp_path / "a.html", "--json").stdout)
    baselines = [each["baseline"] for each in numbers["value"]["comparisons"]]
    assert len(baselines) == 2
    assert baselines[1] == "the logging policy"
    page = html.unescape((tmp_path / "a.html").read_text())
    assert f"--against {shlex.quote(sequence)} --against logging --replicates 4" in page


def test_without_a_policy_the_page_is_of_the_log(folder, tmp_path):
    told = run(folder / "logs", "--out", tmp_path / "a.html", "--unit", "parts")
    answer, place = told.stdout.splitlines()
    assert answer.startswith("24 trajectories: ")
    assert place == f"The page: {tmp_path / 'a.html'}"
    page = (tmp_path / "a.html").read_text()
    assert f"halfseen report {folder / 'logs'} --unit parts --seed 0" in page
    assert "Rewards are in parts." in page
    numbers = json.loads(run(folder / "logs", "--out", tmp_path / "b.html", "--unit", "parts", "--json").stdout)
    assert "policy_folder" not in numbers
    assert numbers["log"]["reward_unit"] == "parts"
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()
