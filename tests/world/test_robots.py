"""What a team reaches, where two robots are in each other's way, what no robot or scene is, and teams from files."""

import json

import numpy as np
import pytest

from halfseen.errors import ArgumentError, HalfseenError
from halfseen.world import AssumedGrasping, GraspingByRobot, Robot, Scene, TableWorld, Team, WorldConfig, read_team
from halfseen.world.config import check_number
from halfseen.world.state import initial_state, pad_scenes
from refusals import refused, refused_type

TABLE = Scene(np.zeros((4, 4)), places_m=np.array([[-0.3, 0.0], [0.0, 0.0], [0.05, 0.0], [0.3, 0.0]]))
TEAM = (Robot((-0.6, 0.0), 0.62, name="left"), Robot((0.6, 0.0), 0.62, name="right"))
HIDES = np.array([[0.0, 0.5], [0.0, 0.0]])


def test_each_reaches_its_side_and_what_is_nearer_than_the_clearance_is_near():
    space = Team(TEAM, clearance_m=0.1).workspace(TABLE)
    assert space.is_in_reach.tolist() == [[True, True, False, False], [False, True, True, True]]
    assert np.argwhere(np.triu(space.is_near, 1)).tolist() == [[1, 2]]
    assert space.is_near.diagonal().all()
    np.testing.assert_array_equal(space.is_near, space.is_near.T)


def test_what_shows_of_grips_reaches_the_state_and_padding_holds_none():
    assert Scene(HIDES).grip.tolist() == [0.0, 0.0]
    layouts = pad_scenes([Scene(HIDES, grip=np.array([-1.5, 0.5])), Scene(np.zeros((1, 1)))])
    states = initial_state(WorldConfig(), layouts)
    assert np.isnan(layouts.grip[1, 1])
    assert states.grip.tolist() == [[-1.5, 0.5], [0.0, 0.0]]
    assert not states.seen.any()


def test_a_scene_keeps_its_own_copy():
    grip = np.ones(2)
    scene = Scene(HIDES, grip=grip)
    grip[0] = 9.0
    assert scene.grip.tolist() == [1.0, 1.0]
    with pytest.raises(ValueError, match="read-only"):
        scene.grip[0] = 2.0


def test_a_base_is_a_pair_of_any_plain_numbers():
    assert Robot([np.float64(0.5), 1], 1) == Robot((0.5, 1.0), 1.0)


def test_a_parameter_is_looked_at_where_it_is_no_array():
    for value in (1, 0.5, np.float32(2.0), np.int64(3), np.zeros(())):
        check_number("speed", value)
    for value in (0, -0.5, np.float32(-2.0), np.int64(0), np.inf, 10**400, "1", True, None):
        with pytest.raises(ArgumentError, match=r"speed is .*; give a finite number above 0"):
            check_number("speed", value)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Robot((0.0, np.nan), 1.0), r"robot: base_m is \(0.0, nan\); give two finite numbers, x and y"),
        (lambda: Robot((0.0,), 1.0), r"robot: base_m is \(0.0,\); give two finite numbers"),
        (lambda: Robot((0.0, 0.0, 1.0), 1.0), r"base_m is \(0.0, 0.0, 1.0\)"),
        (lambda: Robot("ab", 1.0), "base_m is 'ab'"),
        (lambda: Robot((0.0, "1"), 1.0), r"base_m is \(0.0, '1'\)"),
        (lambda: Robot(0.0, 1.0), "base_m is 0.0"),
        (lambda: Robot((0.0, 0.0), 0.0), "reach_m is 0.0"),
        (lambda: Robot((0.0, 0.0), np.inf), "robot: reach_m is inf"),
        (lambda: Robot((0.0, 0.0), "1"), "robot: reach_m is '1'; give a finite number above 0"),
        (lambda: Robot((0.0, 0.0), True), "reach_m is True"),
        (lambda: Robot((0.0, 0.0), 1.0, speed=-1.0), "speed is -1.0"),
        (lambda: Robot((0.0, 0.0), 1.0, name=3), r"the robot at \(0.0, 0.0\): name is 3; give a string"),
        (lambda: Robot((0.0, 0.0), 1.0, drop_out_rate=None), "drop_out_rate is None"),
        (lambda: Robot((0.0, 0.0), 1.0, drop_out_rate=-1.0), "robot: drop_out_rate is -1.0"),
        (lambda: Team((TEAM[0], "right")), r"robots\[1\] is 'right'; give a Robot"),
        (lambda: Team(TEAM, clearance_m="1"), "clearance_m is '1'; give a finite distance"),
        (lambda: Team(TEAM, reward_per_s="1"), "reward_per_s is '1'; give a finite price, 0 or below"),
        (lambda: Team(TEAM, reward_per_s=np.float32(1.0)), r"reward_per_s is np.float32\(1.0\)"),
        (lambda: TableWorld(robots=TEAM, clearance_m=np.nan), "clearance_m is nan"),
        (lambda: TableWorld(robots=TEAM, reward_per_s=0.1), "reward_per_s is 0.1"),
        (lambda: Team(()), "robots is empty"),
        (lambda: Team(TEAM, clearance_m=-0.1), "clearance_m is -0.1"),
        (lambda: WorldConfig(speed=()), r"speed is \(\)"),
        (lambda: WorldConfig(speed=(1.0, np.nan)), "speed of robot 1 is nan; give a finite number above 0"),
        (lambda: WorldConfig(speed=(0.0,)), "speed of robot 0 is 0.0"),
        (lambda: WorldConfig(speed=(np.float32(-1.0),)), r"speed of robot 0 is np.float32\(-1.0\)"),
        (lambda: WorldConfig(speed=("1",)), "speed of robot 0 is '1'"),
        (lambda: WorldConfig(reward_per_s=1.0), "reward_per_s is 1.0; give a finite price, 0 or below"),
        (lambda: WorldConfig(reward_per_s=-np.inf), "reward_per_s is -inf"),
        (lambda: WorldConfig(drop_out_rate=(0.1, 0.1)), "drop_out_rate has 2 entries for 1 robots"),
        (lambda: WorldConfig(drop_out_rate=(-0.1,)), "drop_out_rate of robot 0 is -0.1; give a finite hazard"),
        (lambda: WorldConfig(drop_out_rate=(np.inf,)), "drop_out_rate of robot 0 is inf"),
        (lambda: WorldConfig(drop_out_rate=(np.float32(np.nan),)), r"drop_out_rate of robot 0 is np.float32\(nan\)"),
        (lambda: Scene(np.zeros((1, 2))), r"scene: hides has shape \(1, 2\); it must be square, \(1, 1\)"),
        (lambda: Scene(np.array([[0.0, 1.5], [0.0, 0.0]])), r"hides\[0, 1\] is 1.5; give hidden shares in \[0, 1\]"),
        (lambda: Scene(np.eye(2)), r"hides\[0, 0\] is 1.0; an object does not hide itself; set it to 0"),
        (lambda: Scene(HIDES, grip=np.array([0.0, np.nan])), r"scene: grip\[1\] is nan; give a finite offset"),
        (lambda: Scene(HIDES, grip=np.zeros(1)), r"grip has shape \(1,\); give one number for each object"),
        (lambda: Scene(HIDES, places_m=np.zeros((1, 2))), r"places_m has shape \(1, 2\); give x and y of each object"),
        (lambda: Scene(np.zeros((1, 1)), places_m=np.array([[0.0, np.nan]])), r"places_m\[0, 1\] is nan; give a"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(make, message):
    with refused_type(message, HalfseenError):
        make()


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
SOFT = AssumedGrasping(limit_s=9.0)


def read(folder, text, **options):
    (folder / "robots.toml").write_text(text)
    return read_team(folder / "robots.toml", **options)


def test_a_team_comes_from_toml_or_json(tmp_path):
    team = read(tmp_path, TOML)
    assert team.robots == (Robot((-0.5, 0.0), 0.7, name="left"), Robot((0.5, 0.0), 0.8, 1.5, "robot 1", 0.001))
    assert (team.clearance_m, team.reward_per_s) == (0.1, -0.05)
    assert TableWorld.of(team).played_config.speed == (1.0, 1.5)
    (tmp_path / "robots.json").write_text(json.dumps({"robot": [{"base_m": [0, 0], "reach_m": 1}]}))
    assert read_team(tmp_path / "robots.json").robots == (Robot((0.0, 0.0), 1.0, name="robot 0"),)


def test_a_robot_may_name_a_law_of_its_own(tmp_path):
    team = read(tmp_path, ROBOT + "law = 'soft'\n" + ROBOT, law_of={"soft": SOFT}.__getitem__)
    assert [robot.grasping for robot in team.robots] == [SOFT, None]
    assert TableWorld.of(team).played_config.grasping == GraspingByRobot((SOFT, AssumedGrasping()))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"robots.toml: no robots; give each robot a \[\[robot\]\] table"),
        ("robot = 3", "no robots"),
        ("[[robot]", "is not TOML or JSON"),
        ("[[robot]]\nreach_m = 1.0", "robot 0: base_m is missing"),
        (f"[[robot]]\nbase_m = [1{'0' * 400}, 0]\nreach_m = 1.0", "base_m is .*; give two finite numbers"),
        (f"[[robot]]\nbase_m = [0, 0]\nreach_m = 1{'0' * 400}", "reach_m is .*; give"),
        ("[[robot]]\nbase_m = [0, 0]", "robot 0: reach_m is missing"),
        ("[[robot]]\nbase_m = [0]\nreach_m = 1", r"robot 0: base_m is \[0\]; give two finite numbers"),
        ("[[robot]]\nbase_m = [0, true]\nreach_m = 1", r"robot 0: base_m is \[0, True\]"),
        (ROBOT + "speed = 'fast'", "robot 0: speed is 'fast'; give a finite number above 0"),
        (ROBOT + "speed = nan", "robot 0: speed is nan; give a finite number above 0"),
        (ROBOT + "speeed = 1.0", r"robot 0: unknown key 'speeed'; give one of .*; did you mean 'speed'\?"),
        (ROBOT + "name = 3", r"the robot at \[0.0, 0.0\]: name is 3; give a string"),
        (ROBOT + "drop_out_rate = -1", "drop_out_rate is -1; give a finite hazard"),
        ("clearence_m = 0.1\n" + ROBOT, r"unknown key 'clearence_m'; give one of .*; did you mean 'clearance_m'\?"),
        ("clearance_m = -0.1\n" + ROBOT, "clearance_m is -0.1"),
        ("reward_per_s = 1\n" + ROBOT, "reward_per_s is 1; give a finite price"),
        ("reward_per_s = '1'\n" + ROBOT, "reward_per_s is '1'; give a finite price"),
        (ROBOT + "name = 'a'\n" + ROBOT + "name = 'a'", "two robots are called 'a'"),
        (ROBOT + "law = 'soft'", r"robots\.toml: robot 0: law is 'soft', but there is no law_of"),
        (ROBOT + "law = 3", r"robots\.toml: robot 0: law is 3; give the name of a law of grasping"),
        (ROBOT + "grasping = 'soft'", "unknown key 'grasping'"),
    ],
)
def test_what_no_team_has_is_reported_in_one_line(tmp_path, text, message):
    with refused(message, ArgumentError) as caught:
        read(tmp_path, text)
    assert str(tmp_path / "robots.toml") in str(caught.value)


def test_a_file_that_is_not_there_is_reported(tmp_path):
    with pytest.raises(ArgumentError, match=r"no\.toml: cannot be read"):
        read_team(tmp_path / "no.toml")
