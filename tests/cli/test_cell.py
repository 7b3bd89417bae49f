"""`halfseen cell`: bad input is reported in one line before anything moves."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner

from halfseen.cell.calibration.law import ATTEMPTS, read_law, shipped_law, write_law
from halfseen.cell.campaign import WHAT_FILE
from halfseen.cli.cell_run import run
from halfseen.cli.inputs import stations_for
from halfseen.cli.options import ArmOption
from halfseen.logs import read_logs
from text_arms import SIX

EXAMPLES = Path(__file__).parents[2] / "examples"

RUN = ["run", "--policy", "greedy", "--tables", "2"]


@pytest.mark.slow
def test_attempts_of_a_law_are_fitted_again_as_they_were_made(typed, tmp_path, monkeypatch):
    fitted = []

    def fit_law(logs, horizon, limit_s):
        """What it is, to the last bit, as is tested beside it."""
        fitted.append(logs)
        return read_law(shipped_law()).law

    monkeypatch.setattr("halfseen.cell.calibration.law.fit_law", fit_law)
    assert typed("cell", "calibrate", "--from", shipped_law(), "--seed", 7, "--out", tmp_path / "law").status == 0
    again, shipped = (read_law(folder).record for folder in (tmp_path / "law", shipped_law()))
    assert again == shipped
    assert {path.name for path in (tmp_path / "law").iterdir()} == {path.name for path in shipped_law().iterdir()}
    assert fitted[0].stages.equals(read_logs(shipped_law() / ATTEMPTS).stages)


def test_a_run_is_not_gone_on_with_under_another_law_of_the_same_name(refused, tmp_path):
    law, words = tmp_path / "law", [*RUN, "--law", tmp_path / "law", "--out", tmp_path / "logs"]
    write_law(read_law(shipped_law()).law, law, {})
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
    result = alone(gl, "-m", "halfseen.cli", "cell", "film", "--policy", "greedy", "--out", tmp_path / "film.gif")
    if not result.returncode:
        pytest.skip("there is a screen")
    (line,) = result.stderr.strip().splitlines()
    assert f"no picture can be drawn here: OpenGL does not start with MUJOCO_GL={gl}" in line
    assert result.returncode == 2
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def six(tmp_path):
    (tmp_path / "six.xml").write_text(SIX)
    return tmp_path / "six.xml"


@pytest.mark.slow
def test_an_arm_is_known_by_what_it_is_not_by_where_its_file_lies(six, tmp_path):
    (tmp_path / "else").mkdir()
    (tmp_path / "else" / "six.xml").write_text(SIX)
    (tmp_path / "longer.xml").write_text(SIX.replace('pos="0 -0.13 0.42"', 'pos="0 -0.13 0.44"'))
    ((robot, *_),), name = stations_for(ArmOption(six, None, None))
    assert robot.arm.num_joints == 6
    assert name.startswith("six.xml (")
    assert stations_for(ArmOption(tmp_path / "else" / "six.xml", "attachment_site", None))[1] == name
    assert stations_for(ArmOption(tmp_path / "longer.xml", None, None))[1].split("(")[1] != name.split("(")[1]


@pytest.mark.slow
def test_another_arm_clears_tables(six, tmp_path):
    words = ["--policy", "greedy", "--tables", "2", "--workers", "1", "--no-stops", "--out", str(tmp_path / "logs")]
    report = json.loads(CliRunner().invoke(run, [*words, "--arm", str(six), "--json"], catch_exceptions=False).stdout)
    assert report["arm"].startswith("six.xml (")
    assert report["counts"]["num_racked"] > 0
    assert read_logs(tmp_path / "logs").num_trajectories == 2
