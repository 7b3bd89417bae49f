"""What a team reaches, and where two robots are in each other's way."""

import numpy as np
import pytest
from jaxtyping import TypeCheckError

from halfseen.errors import ArgumentError, HalfseenWarning
from halfseen.world import Robot, Team, WorldConfig
from halfseen.world.robots import workspace_of

PLACES = np.array([[-0.3, 0.0], [0.0, 0.0], [0.05, 0.0], [0.3, 0.0]])
TEAM = (Robot((-0.6, 0.0), 0.62, name="left"), Robot((0.6, 0.0), 0.62, name="right"))


def test_each_reaches_its_side_and_both_the_middle():
    space = workspace_of(TEAM, PLACES)
    assert space.is_in_reach.tolist() == [[True, True, False, False], [False, True, True, True]]


def test_what_is_nearer_than_the_clearance_is_near_and_each_object_to_itself():
    near = np.asarray(workspace_of(TEAM, PLACES, clearance_m=0.1).is_near)
    assert np.argwhere(np.triu(near, 1)).tolist() == [[1, 2]]
    assert near.diagonal().all()
    np.testing.assert_array_equal(near, near.T)


def test_what_nobody_reaches_is_told():
    with pytest.warns(HalfseenWarning, match=r"object 1 at \(0, 2\) m is in no robot's reach, so it counts as left"):
        workspace_of(TEAM, np.array([[0.0, 0.0], [0.0, 2.0]]))


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda: Robot((0.0, np.nan), 1.0), r"robot: base_m is \(0.0, nan\); give two finite numbers, x and y"),
        (lambda: Robot((0.0,), 1.0), r"robot: base_m is \(0.0,\); give two finite numbers"),
        (lambda: Robot((0.0, 0.0, 1.0), 1.0), r"base_m is \(0.0, 0.0, 1.0\)"),
        (lambda: Robot("ab", 1.0), "base_m is 'ab'"),
        (lambda: Robot((0.0, "1"), 1.0), r"base_m is \(0.0, '1'\)"),
        (lambda: Robot(0.0, 1.0), "base_m is 0.0"),
        (lambda: Robot((0.0, 0.0), 0.0), "reach_m is 0.0"),
        (lambda: Robot((0.0, 0.0), "1"), "robot: reach_m is '1'; give a finite number above 0"),
        (lambda: Robot((0.0, 0.0), True), "reach_m is True"),
        (lambda: Robot((0.0, 0.0), 1.0, name=3), r"the robot at \(0.0, 0.0\): name is 3; give a text"),
        (lambda: Robot((0.0, 0.0), 1.0, drop_out_rate=None), "drop_out_rate is None"),
        (lambda: Team((TEAM[0], "right")), r"robots\[1\] is 'right'; give a Robot"),
        (lambda: Team(TEAM, clearance_m="1"), "clearance_m is '1'; give a finite distance"),
        (lambda: Team(TEAM, reward_per_s="1"), "reward_per_s is '1'; give a finite price, 0 or below"),
        (lambda: Team(TEAM, reward_per_s=np.float32(1.0)), r"reward_per_s is np.float32\(1.0\)"),
        (lambda: WorldConfig(speed=(np.float32(-1.0),)), r"speed of robot 0 is np.float32\(-1.0\)"),
        (lambda: WorldConfig(speed=("1",)), "speed of robot 0 is '1'"),
        (lambda: WorldConfig(drop_out_rate=(np.float32(np.nan),)), r"drop_out_rate of robot 0 is np.float32\(nan\)"),
        (lambda: Robot((0.0, 0.0), 1.0, speed=-1.0), "speed is -1.0"),
        (lambda: workspace_of((), PLACES), "robots is empty"),
        (lambda: workspace_of(TEAM, np.array([[0.0, np.inf]])), "object 0 stands at"),
        (lambda: workspace_of(TEAM, PLACES, clearance_m=-0.1), "clearance_m is -0.1"),
    ],
)
def test_what_cannot_be_is_refused(make, told):
    with pytest.raises((ArgumentError, TypeCheckError), match=f"{told}|Type-check error"):
        make()


def test_a_base_is_a_pair_of_any_plain_numbers():
    base_m = [np.float64(0.5), 1]
    assert Robot(base_m, 1) == Robot((0.5, 1.0), 1.0)
