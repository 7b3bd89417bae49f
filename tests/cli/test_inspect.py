"""``halfseen inspect``: what logs hold; ``halfseen report``: a page of them and of a policy."""

import html
import json
import re
import shlex
import subprocess
import sys
from functools import partial

import numpy as np
import pytest
import shell

from halfseen.learning import CensoredQLearner
from halfseen.logs import LogRecorder
from small_logs import kept, log_of
from small_report import ACTIONS, COVARIATES, hostile_log


@pytest.fixture
def folder(tmp_path):
    stages = {"trajectory": [1, 1, 2, 2, 3], "stage": [1, 2, 1, 2, 1], "elapsed_s": [2.0, 5.0, 2.0, None, 2.0]}
    done = {"action": ["LIFT", "WASH", "WASH", None, "FINISH"], "reward": [-0.1, 5.0, -1.0, None, 0.0]}
    log_of({"end_s": [5.0, 3.0, 2.0]}, **stages, **done).write(tmp_path / "logs")
    return tmp_path / "logs"


def run(*words):
    return shell.run("inspect", *words).output


def test_says_one_plain_sentence_first_then_what_looks_wrong_then_aligned_numbers(folder):
    lines = run(folder).splitlines()
    assert lines[0] == "3 trajectories of up to 2 stages and 5 s: 2 finished, 1 cut (33%)."
    assert lines[1] == "Nothing looks wrong."
    assert "stages            5, of which 4 completed" in lines
    for table in (
        """
cause of cut  trajectories  share  first [s]  median [s]  last [s]  in stages
unknown                  1   100%          3           3         3     2 to 2
""",
        """
action  stages  share  cut  median [s]  mean reward
WASH         2    50%    0         2.5            2
FINISH       1    25%    0           2            0
LIFT         1    25%    0           2         -0.1
""",
        """
stage  begun  completed  cut  5 % [s]  median [s]  95 % [s]  effective sample size  largest weight
1          3          3    0        2           2         2                    3.0            1.00
2          2          1    1        3           3         3                    1.0            2.00
""",
    ):
        first = lines.index(table.splitlines()[1])
        assert lines[first : first + len(table.splitlines()) - 1] == table.splitlines()[1:]


def test_the_cuts_of_each_action_are_counted(tmp_path):
    stages = {"trajectory": [1, 2, 3], "elapsed_s": [2.0, None, None], "action": ["WASH"] * 3}
    log_of({"end_s": [2.0, 3.0, 2.0]}, **stages, stage=1, reward=[5.0, None, None]).write(tmp_path / "logs")
    assert shell.report("inspect", tmp_path / "logs")["choices"][0]["num_cut"] == 2


def test_a_log_of_several_robots_says_so(folder, tmp_path):
    log_of(stage=range(1, 5), elapsed_s=[1.0, 2.0, 3.0, 4.0], robot=[0, 1, 0, 0]).write(tmp_path / "team")
    assert "robots            2, of whose decisions 0 made 75%, 1 made 25%" in run(tmp_path / "team").splitlines()
    assert shell.report("inspect", tmp_path / "team")["robots"] == [
        {"robot": "0", "num_decisions": 3, "share": 0.75},
        {"robot": "1", "num_decisions": 1, "share": 0.25},
    ]
    assert not [line for line in run(folder).splitlines() if line.startswith("robots")]


def test_what_looks_wrong_is_reported_near_the_top_and_in_json(tmp_path):
    done = {"trajectory": range(20), "elapsed_s": np.linspace(1.1, 3.3, 20), "action": ["A", "B"] * 10, "reward": 2.0}
    log_of(**done, probability=1.0, lamp="on").write(tmp_path / "logs")
    assert run(tmp_path / "logs").splitlines()[1:5] == [
        "What looks wrong:",
        "- All probabilities are 1: the policy never explored, so nothing can be learned of other actions.",
        "- All 20 rewards are 2: no action is better than another.",
        "- Covariate lamp is 'on' in all 20 rows: a dead sensor, or a column to leave out.",
    ]
    report = shell.report("inspect", tmp_path / "logs")
    kinds = [doubt["kind"] for doubt in report["data_warnings"]]
    assert kinds == ["no-exploration", "equal-rewards", "constant-covariate"]
    assert report["covariates"] == ["lamp"]


def test_a_unit_that_changes_within_the_log_is_reported_first(tmp_path):
    share = np.random.default_rng(0).uniform(0.1, 0.9, 120)
    share = np.where(np.arange(120) < 70, share, 100.0 * share)
    log_of(trajectory=range(120), action=["A", "B"] * 60, share=share).write(tmp_path / "logs")
    first = shell.report("inspect", tmp_path / "logs")["data_warnings"][0]
    assert first["kind"] == "changed-within"
    assert "share in stage 1 is larger than before (mean 59, before 0.491)" in first["sentence"]
    assert "since about trajectory 70 (70 to 70), in the last 50: convert a column" in first["sentence"]
    assert first["sentence"].endswith("learn with --since 70")


def test_a_long_table_is_cut_short_and_json_is_not(tmp_path):
    actions = [f"go {k:02d}" for k in range(30)]
    log_of(stage=range(1, 31), elapsed_s=np.arange(1.0, 31.0), action=actions).write(tmp_path / "logs")
    output = run(tmp_path / "logs")
    assert "go 19" in output
    assert "go 20" not in output
    assert output.count("and 10 more (--json has all)") == 2
    report = shell.report("inspect", tmp_path / "logs")
    assert (len(report["choices"]), len(report["clock"])) == (30, 30)


def test_reads_what_a_recorder_is_writing(tmp_path):
    with LogRecorder(tmp_path) as recorder:
        trajectory = recorder.begin_trajectory()
        trajectory.begin_stage({"x": 0.5}, action="PICK", probability=0.5)
        trajectory.complete_stage(1.0)
        trajectory.begin_stage({"x": 0.7})
        report = shell.report("inspect", tmp_path)
        assert report["cuts"][0]["cause"] == "still-running"
        assert report["choices"][0]["smallest_probability"] == 0.5
        assert report["clock"][1]["median_s"] is None
        assert re.search(r"still-running +1 +100%", run(tmp_path))


def test_says_what_the_weights_rest_on_and_whose_the_largest_are(folder):
    output = run(folder)
    assert "Too little: 2 finishes have an effective sample size of 1.8." in output
    assert "Largest weights: 2 (trajectory 1, 5 s), 1 (trajectory 3, 2 s)." in output
    positivity = shell.report("inspect", folder)["positivity"]
    assert not positivity["is_sound"]
    assert positivity["heaviest"][0] == {"trajectory": "1", "time_s": 5.0, "weight": 2.0}


def test_from_the_shell(folder, refused):
    command = [sys.executable, "-m", "halfseen.cli", "inspect"]
    good = subprocess.run([*command, str(folder)], capture_output=True, text=True, check=True)
    assert good.stdout.startswith("3 trajectories")
    assert good.stderr == ""
    (folder / "stages.parquet").write_bytes(b"PAR1 and no more")
    assert "stages.parquet: it is not a complete Parquet file" in refused("inspect", folder)


reported = partial(shell.run, "report")


@pytest.fixture(scope="module")
def judged(tmp_path_factory):
    judged = tmp_path_factory.mktemp("report-verb")
    logs = hostile_log(num_trajectories=24)
    logs.write(judged / "logs")
    kept(CensoredQLearner.of_paper(2, ACTIONS, COVARIATES, reg=0.1), logs, judged / "policy")
    return judged


@pytest.mark.slow
def test_says_the_answer_and_where_the_page_is_and_the_same_again(judged, tmp_path):
    arguments = [judged / "logs", judged / "policy", "--replicates", 4, "--seed", 2]
    first = reported(*arguments, "--out", tmp_path / "a.html")
    answer, place = first.stdout.splitlines()
    assert answer.split(":")[0] in ("Better", "Not better", "Inconclusive")
    assert place == f"The page: {tmp_path / 'a.html'}"
    assert first.stderr == ""
    second = reported(*arguments, "--out", tmp_path / "b.html", "--json")
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()
    page = (tmp_path / "a.html").read_text()
    assert f"halfseen report {judged / 'logs'} {judged / 'policy'} --replicates 4 --seed 2" in page

    def refuse(name):
        raise AssertionError(f"{name} is not a JSON number")

    numbers = json.loads(second.stdout, parse_constant=refuse)
    assert numbers["value"]["sentence"] == answer
    assert set(numbers["value"]["difference"]) >= {"value", "low", "high", "effective_sample_size"}
    assert numbers["log"]["num_trajectories"] == 24
    assert numbers["policy"]["is_learned_from_these_logs"] is True
    assert len(numbers["policy"]["curves"]) == 4
    assert numbers["log"]["watched"]["num_watched"][0] == 24
    assert numbers["seed"] == 2


@pytest.mark.slow
def test_the_page_is_against_whom_it_is_reported(judged, tmp_path):
    sequence = "sequence:" + ",".join([ACTIONS[0]] * 2)
    arguments = [judged / "logs", judged / "policy", "--replicates", 4, "--against", sequence, "--against", "logging"]
    numbers = shell.report("report", *arguments, "--out", tmp_path / "a.html")
    baselines = [each["baseline"] for each in numbers["value"]["comparisons"]]
    assert len(baselines) == 2
    assert baselines[1] == "the logging policy"
    page = html.unescape((tmp_path / "a.html").read_text())
    assert f"--against {shlex.quote(sequence)} --against logging --replicates 4" in page


@pytest.mark.slow
def test_without_a_policy_the_page_is_of_the_log(judged, tmp_path):
    result = reported(judged / "logs", "--out", tmp_path / "a.html", "--unit", "parts")
    answer, place = result.stdout.splitlines()
    assert answer.startswith("24 trajectories: ")
    assert place == f"The page: {tmp_path / 'a.html'}"
    page = (tmp_path / "a.html").read_text()
    assert f"halfseen report {judged / 'logs'} --unit parts --seed 0" in page
    assert "Rewards are in parts." in page
    numbers = shell.report("report", judged / "logs", "--out", tmp_path / "b.html", "--unit", "parts")
    assert "policy_folder" not in numbers
    assert numbers["log"]["reward_unit"] == "parts"
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()
