"""Robots come from a file; what is wrong in it is told in one line."""

import json

import pytest

from halfseen.errors import ArgumentError
from halfseen.world import AssumedGrasping, GraspingByRobot, Robot, TableWorld, read_team

TOML = """
clearance_m = 0.1
reward_per_s = -0.05

[[robot]]
name = "left"
base_m = [-0.5, 0]
reach_m = 0.7

[[robot]]
base_m = [0.5, 0.0]
reach_m = 0.8
speed = 1.5
drop_out_rate = 0.001
"""
ROBOT = "[[robot]]\nbase_m = [0.0, 0.0]\nreach_m = 0.5\n"


def test_a_team_comes_from_toml_or_json(tmp_path):
    (tmp_path / "robots.toml").write_text(TOML)
    team = read_team(tmp_path / "robots.toml")
    left, right = Robot((-0.5, 0.0), 0.7, name="left"), Robot((0.5, 0.0), 0.8, 1.5, "robot 1", 0.001)
    assert team.robots == (left, right)
    assert (team.clearance_m, team.reward_per_s) == (0.1, -0.05)
    assert TableWorld.of(team).played_config.speed == (1.0, 1.5)
    same = {"robot": [{"base_m": [0, 0], "reach_m": 1}]}
    (tmp_path / "robots.json").write_text(json.dumps(same))
    assert read_team(tmp_path / "robots.json").robots == (Robot((0.0, 0.0), 1.0, name="robot 0"),)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", r"robots.toml: there is no robot; give each a table of its own"),
        ("robot = 3", "there is no robot"),
        ("[[robot]", "is no TOML or JSON"),
        ("[[robot]]\nreach_m = 1.0", "robot 0: base_m is missing"),
        (f"[[robot]]\nbase_m = [1{'0' * 400}, 0]\nreach_m = 1.0", "base_m is .*; give two finite numbers"),
        (f"[[robot]]\nbase_m = [0, 0]\nreach_m = 1{'0' * 400}", "reach_m is .*; give"),
        ("[[robot]]\nbase_m = [0, 0]", "robot 0: reach_m is missing"),
        ("[[robot]]\nbase_m = [0]\nreach_m = 1", r"robot 0: base_m is \[0\]; give two finite numbers"),
        ("[[robot]]\nbase_m = [0, true]\nreach_m = 1", r"robot 0: base_m is \[0, True\]"),
        (ROBOT + "speed = 'fast'", "robot 0: speed is 'fast'; give a finite number above 0"),
        (ROBOT + "speed = nan", "robot 0: speed is nan; give a finite number above 0"),
        (ROBOT + "speeed = 1.0", r"robot 0: there is no key 'speeed' among .*; did you mean 'speed'\?"),
        (ROBOT + "name = 3", r"the robot at \[0.0, 0.0\]: name is 3; give a text"),
        (ROBOT + "drop_out_rate = -1", "drop_out_rate is -1; give a finite hazard"),
        ("clearence_m = 0.1\n" + ROBOT, r"there is no key 'clearence_m' .* did you mean 'clearance_m'\?"),
        ("clearance_m = -0.1\n" + ROBOT, "clearance_m is -0.1"),
        ("reward_per_s = 1\n" + ROBOT, "reward_per_s is 1; give a finite price"),
        ("reward_per_s = '1'\n" + ROBOT, "reward_per_s is '1'; give a finite price"),
        (ROBOT + "name = 'a'\n" + ROBOT + "name = 'a'", "two robots are called 'a'"),
    ],
)
def test_what_no_team_has_is_told_in_one_line(tmp_path, text, told):
    (tmp_path / "robots.toml").write_text(text)
    with pytest.raises(ArgumentError, match=told) as caught:
        read_team(tmp_path / "robots.toml")
    assert "\n" not in str(caught.value)
    assert str(tmp_path / "robots.toml") in str(caught.value)


def test_a_file_that_is_not_there_is_told(tmp_path):
    with pytest.raises(ArgumentError, match=r"no\.toml: cannot be read"):
        read_team(tmp_path / "no.toml")


def test_a_robot_may_name_a_law_of_its_own(tmp_path):
    (tmp_path / "robots.toml").write_text(ROBOT + "law = 'soft'\n" + ROBOT)
    soft = AssumedGrasping(limit_s=9.0)
    team = read_team(tmp_path / "robots.toml", law_of={"soft": soft}.__getitem__)
    assert [robot.grasping for robot in team.robots] == [soft, None]
    assert TableWorld.of(team).played_config.grasping == GraspingByRobot((soft, AssumedGrasping()))
    with pytest.raises(ArgumentError, match=r"robots\.toml: robot 0: law is 'soft', and nobody says which that is"):
        read_team(tmp_path / "robots.toml")
    (tmp_path / "robots.toml").write_text(ROBOT + "law = 3\n")
    with pytest.raises(ArgumentError, match=r"robots\.toml: robot 0: law is 3; give the name of a law of grasping"):
        read_team(tmp_path / "robots.toml", law_of={"soft": soft}.__getitem__)
    (tmp_path / "robots.toml").write_text(ROBOT + "grasping = 'soft'\n")
    with pytest.raises(ArgumentError, match="there is no key 'grasping' among"):
        read_team(tmp_path / "robots.toml")
