"""The fitted law of grasping against its formulas, and robots that have laws of their own."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate, stats
from scipy.special import expit

from fitted_laws import GRASPING
from halfseen.arrays import record
from halfseen.errors import ArgumentError
from halfseen.world import (
    Arrangement,
    AssumedGrasping,
    Attempt,
    FittedGrasping,
    GraspingByRobot,
    KnownGrasping,
    Robot,
    Scene,
    UniformPolicy,
    Verb,
    WorldConfig,
    random,
)
from halfseen.world.actions import WAIT
from halfseen.world.grasping import check_law
from halfseen.world.robots import check_robot
from halfseen.world.rollout import play
from halfseen.world.state import NO_ATTEMPT, occlusion, pad_scenes
from halfseen.world.transition import start
from own_laws import KEY, LOGISTIC, NUM_OBJECTS, WORLD, first_layout, met, world_of
from own_laws import played as played_in
from refusals import refused

OCCLUDED, OFFSET = np.linspace(0.0, 1.0, 5)[:, None], np.array([-2.0, 0.0, 0.7])


def test_its_probabilities_are_known_and_its_numbers_must_be_given():
    assert isinstance(GRASPING, KnownGrasping)
    with pytest.raises(TypeError, match="missing"):
        FittedGrasping()


def test_an_attempt_holds_by_a_logistic_law_and_its_mean_time_is_that_of_both_results_cut_at_the_limit():
    held, known = -np.expm1(GRASPING.log_failure(OCCLUDED, OFFSET)), expit(2.0 - 1.5 * OCCLUDED + OFFSET)
    np.testing.assert_allclose(held, known, rtol=1e-12)

    def mean_s(log_s):
        """∫ P(T > t) dt up to the limit."""
        return integrate.quad(stats.lognorm(s=0.4, scale=np.exp(log_s)).sf, 0.0, 8.0, epsabs=1e-12)[0]

    expected = known * mean_s(1.6) + (1.0 - known) * mean_s(1.1)
    np.testing.assert_allclose(GRASPING.expected_s(OCCLUDED, OFFSET), expected, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("occluded", "grip", "u"), [(0.0, 0.0, 0.0), (0.6, -1.5, 0.4)])
def test_drawn_attempts_hold_as_often_and_take_as_long(occluded, grip, u):
    num = 200_000
    one, first = np.ones((num, 1)), np.zeros(num, dtype=int)
    table = Arrangement(np.zeros((num, 1, 1)), one > 0.0, occluded * one, grip * one)
    drawn = GRASPING.attempt(table, u * one, first + int(Verb.WASH), first, random.keys_of(random.key_of(0), num))
    held = -np.expm1(GRASPING.log_failure(occluded, grip + u))
    assert drawn.is_held.mean() == pytest.approx(held, abs=0.005)
    assert drawn.duration_s.mean() == pytest.approx(GRASPING.expected_s(occluded, grip + u), abs=0.03)
    assert float(drawn.duration_s.max()) == GRASPING.limit_s


@pytest.mark.parametrize("law", [GRASPING, AssumedGrasping()], ids=["fitted", "assumed"])
def test_what_shows_of_a_grip_makes_attempts_hold(law):
    scene = Scene(np.zeros((3, 3)), grip=np.array([-2.0, 0.0, 2.0]))
    config = WorldConfig(grasping=law, horizon=2)
    states = play(config, pad_scenes([scene]), UniformPolicy(), random.key_of(0), 4_000).states
    tried, held = states.attempt_object[:, 1, 0], states.attempt_succeeded[:, 1, 0]
    node, weight = np.polynomial.hermite_e.hermegauss(31)
    for cup, grip in enumerate(scene.grip):
        expected = -np.expm1(law.log_failure(0.0, grip + law.offset_std * node)) @ weight / weight.sum()
        assert held[tried == cup].mean() == pytest.approx(expected, abs=2.0 / np.sqrt(np.sum(tried == cup)))


@record
class Always:
    """Every attempt works, at once."""

    limit_s: float = 2.0

    def draw_latent(self, num_objects, key):
        return None

    def attempt(self, table, latent, verb, target, key):
        every = np.ones(target.shape, dtype=np.float32)
        return Attempt(every > 0.0, 0.5 * every, table.hides, None)


@record
class Never:
    """None works, and its latent counts the attempts."""

    limit_s: float = 7.0

    def draw_latent(self, num_objects, key):
        return {"tried": np.zeros(key.shape[:-1], dtype=int)}

    def attempt(self, table, latent, verb, target, key):
        every = np.ones(target.shape, dtype=np.float32)
        return Attempt(every < 0.0, self.limit_s * every, table.hides, {"tried": latent["tried"] + 1})


def test_attempts_go_by_the_law_of_who_makes_them():
    states = met(played_in(world_of(Always(), Never()), UniformPolicy()))
    tried = states.attempt_object != NO_ATTEMPT
    by, held = states.attempt_robot[tried], states.attempt_succeeded[tried]
    assert set(by.tolist()) == {0, 1}
    np.testing.assert_array_equal(held, by == 0)
    # Transport takes a second; robot 1 is at it for 8 s, and robot 0 never for more than 1.5 s.
    longest_s = np.where(states.robots.is_busy & (states.robots.verb != WAIT), states.robots.since_s, 0.0).max(axis=0)
    assert longest_s[0] <= 1.5
    assert 4.0 < longest_s[1] <= 8.0


def test_a_trait_is_changed_by_the_attempts_of_its_own_robot():
    law, mixed = GraspingByRobot((Always(), Never())), world_of(Always(), Never())
    table = start(mixed.played_config, first_layout(mixed), KEY)[0]
    arrangement = Arrangement(table.hides, table.is_on_table, occlusion(table), table.grip)
    latent = law.draw_latent(NUM_OBJECTS, KEY)
    for robot, tried in ((0, 0), (1, 1)):
        # Its number may be a plain one, or an array.
        for of in (replace(law, robot=robot), replace(law, robot=np.asarray(robot))):
            went = of.attempt(arrangement, latent, np.asarray(1), np.asarray(0), KEY)
            assert (bool(went.is_held), int(went.latent[1]["tried"])) == (robot == 0, tried)
            assert float(of.limit_s) == (2.0, 7.0)[robot]


def test_an_object_that_is_hard_to_grip_is_so_for_all():
    one, other = GraspingByRobot((AssumedGrasping(), LOGISTIC)).draw_latent(50, KEY)
    np.testing.assert_allclose(other, 1.5 * one, rtol=1e-6)


BARE = {"base_m": (0.0, 0.0), "reach_m": 1.0, "name": "robot"}


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: check_law(3, "left: grasping"), r"left: grasping is 3, not a law of grasping of one robot; give one"),
        (
            lambda: check_robot({**BARE, "grasping": AssumedGrasping}),
            "robot: grasping is <class .*, not a law of grasping",
        ),
        (lambda: Robot((0.0, 0.0), 1.0, grasping=GraspingByRobot((LOGISTIC,))), "robot: grasping is GraspingByRobot"),
        (lambda: GraspingByRobot(()), r"laws is \(\): give the law"),
        (
            lambda: GraspingByRobot((LOGISTIC, GraspingByRobot((LOGISTIC,)))),
            r"laws\[1\] is GraspingByRobot.*, not a law of grasping of one robot",
        ),
        (
            lambda: replace(WORLD, grasping=GraspingByRobot((LOGISTIC,)), speed=(1.0, 1.0)),
            "grasping has laws for 1 robots, but the team has 2; give one law for each robot, or one for all",
        ),
    ],
)
def test_what_is_no_law_is_reported_in_one_line(wrong, message):
    with refused(message, ArgumentError):
        wrong()
