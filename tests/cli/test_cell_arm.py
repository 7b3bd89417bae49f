"""`halfseen cell … --arm`: another arm from a file works at the table, and what does not fit is told in one line."""

import json

import pytest
from click.testing import CliRunner

from halfseen.cli.arms import robot_for
from halfseen.cli.cell_run import run
from halfseen.logs import read_logs
from text_arms import HULL, SIX, seven

RUN = ("run", "--policy", "greedy", "--tables", "2", "--workers", "1")


@pytest.fixture
def six(tmp_path):
    (tmp_path / "six.xml").write_text(SIX)
    return tmp_path / "six.xml"


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["--arm", "{0}/none.xml"], "{0}/none.xml: no such file; give the path of an arm's MJCF file"),
        (["--arm", "{0}/six.xml", "--flange", "tip"], "no site or body 'tip' for a flange; there are attachment_site"),
        (["--arm", "{0}/six.xml", "--joints", "pan,lift"], "{0}/six.xml: the arm has 2 joints"),
        (["--arm", "{0}/six.xml", "--joints", "pan,bend"], "no joint 'bend'; there are pan, lift, elbow"),
        (["--arm", "{0}/tiny.xml"], "'{0}/tiny.xml': its hand reaches 0."),
        (["--flange", "tip"], "--flange is of an arm from a file; give the file by --arm"),
        (["--joints", "pan"], "--joints is of an arm from a file; give the file by --arm"),
    ],
)
def test_an_arm_that_does_not_fit_is_refused(refused, six, tmp_path, given, message):
    tiny = [("0 0 0.05", axis, "-170 170") for axis in ("0 0 1", "0 1 0", "0 0 1", "0 1 0", "0 0 1", "0 1 0")]
    (tmp_path / "tiny.xml").write_text(seven(tiny))
    (tmp_path / "shapes").mkdir()
    (tmp_path / "shapes" / "hull.obj").write_text(HULL)
    words = [word.format(tmp_path) for word in given]
    for verb in (RUN, ("calibrate", "--attempts", "50")):
        line = refused("cell", *verb, "--out", tmp_path / "out", *words)
        assert message.format(tmp_path) in line
    assert sorted(path.name for path in tmp_path.iterdir()) == ["shapes", "six.xml", "tiny.xml"]


def test_an_arm_is_known_by_what_it_is_not_by_where_its_file_lies(six, tmp_path):
    (tmp_path / "else").mkdir()
    (tmp_path / "else" / "six.xml").write_text(SIX)
    (tmp_path / "longer.xml").write_text(SIX.replace('pos="0 -0.13 0.42"', 'pos="0 -0.13 0.44"'))
    robot, name = robot_for(six, None, None)
    assert robot.arm.num_joints == 6
    assert name.startswith("six.xml (")
    assert robot_for(tmp_path / "else" / "six.xml", "attachment_site", None)[1] == name
    assert robot_for(tmp_path / "longer.xml", None, None)[1].split("(")[1] != name.split("(")[1]


@pytest.mark.slow
def test_another_arm_clears_tables(six, tmp_path):
    words = ["--policy", "greedy", "--tables", "2", "--workers", "1", "--no-stops", "--out", str(tmp_path / "logs")]
    report = json.loads(CliRunner().invoke(run, [*words, "--arm", str(six), "--json"], catch_exceptions=False).stdout)
    assert report["arm"].startswith("six.xml (")
    assert report["counts"]["num_racked"] > 0
    assert read_logs(tmp_path / "logs").num_paths == 2
