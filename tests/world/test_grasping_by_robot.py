"""Each robot of a team may have a law of grasping of its own: the world and its logs go by it."""

from dataclasses import replace

import numpy as np
import pytest

from halfseen.arrays import record
from halfseen.errors import ArgumentError
from halfseen.world import AssumedGrasping, GraspingByRobot, Robot, UniformPolicy
from halfseen.world.actions import WAIT
from halfseen.world.grasping import Arrangement, Attempt, check_law
from halfseen.world.robots import check_robot
from halfseen.world.state import NO_ATTEMPT, occlusion
from halfseen.world.transition import start
from own_laws import KEY, LOGISTIC, NUM_OBJECTS, WORLD, first_layout, met, played, world_of


@record
class Always:
    """Every attempt works, at once."""

    limit_s: float = 2.0

    def draw_trait(self, num_objects, key):
        return None

    def attempt(self, table, trait, verb, target, key):
        every = np.ones(target.shape, dtype=np.float32)
        return Attempt(every > 0.0, 0.5 * every, table.hides, None)


@record
class Never:
    """None works, and its trait counts the attempts."""

    limit_s: float = 7.0

    def draw_trait(self, num_objects, key):
        return {"tried": np.zeros(key.shape[:-1], dtype=int)}

    def attempt(self, table, trait, verb, target, key):
        every = np.ones(target.shape, dtype=np.float32)
        return Attempt(every < 0.0, self.limit_s * every, table.hides, {"tried": trait["tried"] + 1})


def test_attempts_go_by_the_law_of_who_makes_them():
    world = world_of(Always(), Never())
    paths = played(world, UniformPolicy())
    states = met(paths)
    tried = np.asarray(states.attempt_object) != NO_ATTEMPT
    by, held = np.asarray(states.attempt_robot)[tried], np.asarray(states.attempt_succeeded)[tried]
    assert set(by.tolist()) == {0, 1}
    np.testing.assert_array_equal(held, by == 0)
    # Transport takes a second; robot 1 is at it for 8 s, and robot 0 never for more than 1.5 s.
    longest_s = np.where(states.robots.is_busy & (states.robots.verb != WAIT), states.robots.since_s, 0.0).max(axis=0)
    assert longest_s[0] <= 1.5
    assert 4.0 < longest_s[1] <= 8.0


def test_a_trait_is_changed_by_the_attempts_of_its_own_robot():
    law, mixed = GraspingByRobot((Always(), Never())), world_of(Always(), Never())
    table = start(mixed.played_config, first_layout(mixed), KEY)[0]
    arrangement = (table.hides, table.is_on_table, occlusion(table), table.grip)
    trait = law.draw_trait(NUM_OBJECTS, KEY)
    for robot, tried in ((0, 0), (1, 1)):
        # Its number may be a plain one, or an array.
        for of in (replace(law, robot=robot), replace(law, robot=np.asarray(robot))):
            went = of.attempt(Arrangement(*arrangement), trait, np.asarray(1), np.asarray(0), KEY)
            assert (bool(went.is_held), int(went.trait[1]["tried"])) == (robot == 0, tried)
            assert float(of.limit_s) == (2.0, 7.0)[robot]


def test_an_object_that_is_hard_to_grip_is_so_for_all():
    law = GraspingByRobot((AssumedGrasping(), LOGISTIC))
    one, other = law.draw_trait(50, KEY)
    np.testing.assert_allclose(other, 1.5 * one, rtol=1e-6)


BARE = {"base_m": (0.0, 0.0), "reach_m": 1.0, "name": "robot"}


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        (lambda: check_law(3, "left: grasping"), r"left: grasping is 3, no law of grasping of one robot; give one"),
        (
            lambda: check_robot({**BARE, "grasping": AssumedGrasping}),
            "robot: grasping is <class .*, no law of grasping",
        ),
        (lambda: Robot((0.0, 0.0), 1.0, grasping=GraspingByRobot((LOGISTIC,))), "robot: grasping is GraspingByRobot"),
        (lambda: GraspingByRobot(()), r"laws is \(\): give the law"),
        (
            lambda: GraspingByRobot((LOGISTIC, GraspingByRobot((LOGISTIC,)))),
            r"laws\[1\] is GraspingByRobot.*, no law of grasping of one robot",
        ),
        (
            lambda: replace(WORLD, grasping=GraspingByRobot((LOGISTIC,)), speed=(1.0, 1.0)),
            "grasping of the world has laws for 1 robots, and the team has 2; give each its own, or all one",
        ),
    ],
)
def test_what_is_no_law_is_told_in_one_line(wrong, told):
    with pytest.raises(ArgumentError, match=told) as caught:
        wrong()
    assert "\n" not in str(caught.value)
