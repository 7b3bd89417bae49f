"""`halfseen cell`: bad input is told in one line before anything moves."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from halfseen.cell.calibration.law_folder import read_law, write_law
from halfseen.cell.calibration.shipped import shipped_law
from halfseen.cell.campaign import WHAT_FILE
from halfseen.learning import CensoredQLearner
from halfseen.logs import Logs
from halfseen.policies import write_policy

EXAMPLES = Path(__file__).parents[2] / "examples"

RUN = ["run", "--policy", "greedy", "--tables", "2"]


def test_a_policy_or_a_law_that_is_not_there(refused, tmp_path):
    out = ["--out", tmp_path / "logs"]
    assert "halfseen learn" in refused("cell", "run", "--policy", tmp_path / "none", *out)
    assert "cell calibrate" in refused("cell", *RUN, "--law", tmp_path / "none", *out)
    assert list(tmp_path.iterdir()) == []


def test_two_arms_are_of_the_usual_kind(refused, tmp_path):
    out = ["--out", tmp_path / "logs"]
    line = refused("cell", "run", "--policy", "planer", "--arms", 2, *out)
    assert "--policy planer: there is no such folder" in line
    assert "did you mean 'planner'?" in line
    arm = tmp_path / "arm.xml"
    arm.write_text("<mujoco/>")
    assert "--arm" in refused("cell", *RUN, "--arms", 2, "--arm", arm, *out)
    assert "--arms" in refused("cell", *RUN, "--arms", 3, *out)
    assert list(tmp_path.iterdir()) == [arm]


def test_what_is_there_is_replaced_only_if_it_is_of_the_kind(refused, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").touch()
    for words in (RUN, ["calibrate"]):
        assert "--overwrite" in refused("cell", *words, "--out", tmp_path / "mine")
        assert "not replaced" in refused("cell", *words, "--out", tmp_path / "mine", "--overwrite")
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["thesis.txt"]


def test_logs_that_are_of_no_cell(refused, tmp_path):
    line = refused("cell", "calibrate", "--from", EXAMPLES / "pick_cell" / "logs", "--out", tmp_path / "law")
    assert "no objects" in line or "has none" in line
    refused("cell", "calibrate", "--from", tmp_path, "--out", tmp_path / "law")
    assert list(tmp_path.iterdir()) == []


def test_attempts_of_a_law_are_fitted_again_as_they_were_made(typed, tmp_path):
    assert typed("cell", "calibrate", "--from", shipped_law(), "--seed", 7, "--out", tmp_path / "law").status == 0
    again, shipped = (read_law(folder).record for folder in (tmp_path / "law", shipped_law()))
    assert again == shipped
    assert {path.name for path in (tmp_path / "law").iterdir()} == {path.name for path in shipped_law().iterdir()}


def test_a_run_is_not_gone_on_with_under_another_law_of_the_same_name(refused, typed, tmp_path):
    law, words = tmp_path / "law", [*RUN, "--law", tmp_path / "law", "--out", tmp_path / "logs"]
    typed("cell", "calibrate", "--from", shipped_law(), "--out", law)
    (tmp_path / "logs.running").mkdir()
    (tmp_path / "logs.running" / WHAT_FILE).write_text("run")
    first = refused("cell", *words)
    write_law(replace(read_law(law).law, limit_s=9.0), law, {}, overwrite=True)
    second = refused("cell", *words)
    assert f"law {law} (" in first
    assert first != second


def alone(gl, *words):
    """What a fresh process says, with this way to draw."""
    environment = {**os.environ, "MUJOCO_GL": gl}
    return subprocess.run([sys.executable, *map(str, words)], env=environment, capture_output=True, text=True)


@pytest.mark.parametrize("gl", ["glfw", "none"])
def test_a_film_without_opengl(tmp_path, gl):
    told = alone(gl, "-m", "halfseen.cli", "cell", "film", "--policy", "greedy", "--out", tmp_path / "film.gif")
    if not told.returncode:
        pytest.skip("there is a screen")
    (line,) = told.stderr.strip().splitlines()
    assert f"no picture can be drawn here: OpenGL does not start with MUJOCO_GL={gl}" in line
    assert told.returncode == 2
    assert list(tmp_path.iterdir()) == []


def test_a_policy_of_other_things_than_tables(refused, tmp_path):
    number = list(range(20))
    stages = {"path": number, "stage": [1] * 20, "elapsed_s": [1.0] * 20, "action": ["A", "B"] * 10}
    stages |= {"reward": [float(k % 5) for k in number], "x": [float(k % 3) for k in number]}
    logs = Logs(stages, {"path": number, "end_s": [1.0] * 20, "ending": ["finished"] * 20})
    fixed = {"q_function": "linear", "censoring": "kaplan-meier", "stages": "separate", "reg": 0.1, "pessimism": 0.0}
    learner = CensoredQLearner(horizon=1, actions=["A", "B"], covariates=["x"], **fixed).fit(logs)
    write_policy(learner, logs, tmp_path / "policy")
    words = ["cell", "run", "--policy", tmp_path / "policy", "--out", tmp_path / "logs"]
    assert "no policy of tables" in refused(*words)
    assert "it decides for no table, and 2 arms clear the table; learn one from" in refused(*words, "--arms", 2)
