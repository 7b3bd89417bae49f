import numpy as np
import pytest
from scipy import integrate, stats
from scipy.special import expit

from fitted_laws import GRASPING
from halfseen.world import Arrangement, AssumedGrasping, FittedGrasping, KnownGrasping, Scene, Verb, WorldConfig, random
from halfseen.world.policy import UniformPolicy
from halfseen.world.rollout import play
from halfseen.world.state import pad_scenes

OCCLUDED, OFFSET = np.linspace(0.0, 1.0, 5)[:, None], np.array([-2.0, 0.0, 0.7])


def mean_s(log_s):
    """∫ P(T > t) dt up to the limit."""
    time_s = stats.lognorm(s=0.4, scale=np.exp(log_s))
    return integrate.quad(time_s.sf, 0.0, 8.0, epsabs=1e-12)[0]


def test_its_probabilities_are_known_and_its_numbers_must_be_given():
    assert isinstance(GRASPING, KnownGrasping)
    with pytest.raises(TypeError, match="missing"):
        FittedGrasping()


def test_an_attempt_holds_by_a_logistic_law():
    held = -np.expm1(GRASPING.log_failure(OCCLUDED, OFFSET))
    np.testing.assert_allclose(held, expit(2.0 - 1.5 * OCCLUDED + OFFSET), rtol=1e-12)
    assert (np.diff(held, axis=0) < 0.0).all()
    assert (np.diff(held, axis=1) > 0.0).all()


def test_its_mean_time_is_that_of_both_results_cut_at_the_limit():
    held = expit(2.0 - 1.5 * OCCLUDED + OFFSET)
    expected = held * mean_s(1.6) + (1.0 - held) * mean_s(1.1)
    np.testing.assert_allclose(GRASPING.expected_s(OCCLUDED, OFFSET), expected, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("occluded", "grip", "u"), [(0.0, 0.0, 0.0), (0.6, -1.5, 0.4)])
def test_drawn_attempts_hold_as_often_and_take_as_long(occluded, grip, u):
    num = 200_000
    one, first = np.ones((num, 1)), np.zeros(num, dtype=int)
    table = Arrangement(np.zeros((num, 1, 1)), one > 0.0, occluded * one, grip * one)
    keys = random.keys_of(random.key_of(0), num)
    drawn = GRASPING.attempt(table, u * one, first + int(Verb.WASH), first, keys)
    held = -np.expm1(GRASPING.log_failure(occluded, grip + u))
    assert drawn.is_held.mean() == pytest.approx(held, abs=0.005)
    assert drawn.duration_s.mean() == pytest.approx(GRASPING.expected_s(occluded, grip + u), abs=0.03)
    assert float(drawn.duration_s.max()) == GRASPING.limit_s


@pytest.mark.parametrize("law", [GRASPING, AssumedGrasping()], ids=["fitted", "assumed"])
def test_what_shows_of_a_grip_makes_attempts_hold(law):
    scene = Scene(np.zeros((3, 3)), grip=np.array([-2.0, 0.0, 2.0]))
    config = WorldConfig(grasping=law, horizon=2)
    played = play(config, pad_scenes([scene]), UniformPolicy(), random.key_of(0), 4_000)
    tried, held = (
        np.asarray(leaf)[:, 1, 0] for leaf in (played.states.attempt_object, played.states.attempt_succeeded)
    )
    node, weight = np.polynomial.hermite_e.hermegauss(31)
    for cup, grip in enumerate(scene.grip):
        expected = -np.expm1(law.log_failure(0.0, grip + law.offset_std * node)) @ weight / weight.sum()
        assert held[tried == cup].mean() == pytest.approx(expected, abs=2.0 / np.sqrt(np.sum(tried == cup)))
