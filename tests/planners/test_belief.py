import numpy as np
import pytest
from naive_planner import CONFIG, Cup, attempt_s, chance, over_grips

from halfseen.arrays import softmax
from halfseen.planners.belief import (
    Grip,
    belief_of,
    dirty_after_label,
    expected_attempt_s,
    grasp_probability,
    grip_posterior,
    occlusion_without,
    offset_nodes,
    prior_grip,
)
from tables import drawn_successors, state_of

GRID = np.linspace(-6.0, 6.0, 1201)
NORMAL = np.exp(-(GRID**2) / 2)
HISTORIES = [
    (),
    ((0.0, True),),
    ((0.3, False),),
    ((0.6, False), (0.2, True)),
    ((0.0, False), (0.0, False), (0.0, False)),
]


def exact_chance(cup, occluded):
    """By the rectangle rule on a fine grid of grip offsets."""
    scale = np.exp(0.6 + 2.2 * occluded - GRID)
    return over_grips(cup, lambda u: float(np.interp(u, GRID, -np.expm1(-6.0 / scale))), GRID, NORMAL)


@pytest.mark.parametrize("occluded", [0.0, 0.25, 0.5, 1.0])
def test_the_chance_of_a_first_grasp_integrates_the_prior_of_the_grip(occluded):
    drawn = np.random.default_rng(0).normal(size=200_000)
    sampled = np.mean(-np.expm1(-6.0 / np.exp(0.6 + 2.2 * occluded - drawn)))

    planned = float(grasp_probability(CONFIG, np.float32(occluded), prior_grip(np.zeros((), dtype=np.float32))))

    assert planned == pytest.approx(sampled, abs=0.005)
    assert planned == pytest.approx(exact_chance(Cup(0.5), occluded), abs=0.002)


@pytest.mark.parametrize("attempts", HISTORIES)
def test_the_chance_after_attempts_agrees_with_integration_on_a_fine_grid(attempts):
    cups = [Cup(0.5, ((0.1, True),)), Cup(0.5, attempts)]
    grip = Grip(*(leaf[1] for leaf in grip_posterior(CONFIG, state_of(cups, np.zeros((2, 2))))))

    for occluded in (0.0, 0.4, 0.8):
        planned = float(grasp_probability(CONFIG, np.float32(occluded), grip))
        assert planned == pytest.approx(exact_chance(cups[1], occluded), abs=0.02)


@pytest.mark.parametrize("attempts", HISTORIES)
def test_the_expected_grip_agrees_with_integration_on_a_fine_grid(attempts):
    cup = Cup(0.5, attempts)
    weights = softmax(grip_posterior(CONFIG, state_of([cup], np.zeros((1, 1)))).log_weights[0])

    assert float(weights @ offset_nodes(CONFIG)) == pytest.approx(over_grips(cup, float, GRID, NORMAL), abs=0.06)


def test_the_time_of_an_attempt_agrees_with_simulated_attempts():
    rng = np.random.default_rng(1)
    drawn_s = np.exp(0.6 + 2.2 * 0.3 - rng.normal(size=200_000)) * rng.exponential(size=200_000)

    planned_s = float(expected_attempt_s(CONFIG, np.float32(0.3), prior_grip(np.zeros((), dtype=np.float32))))

    assert planned_s == pytest.approx(1.0 + np.minimum(drawn_s, 6.0).mean(), abs=0.02)
    assert planned_s == pytest.approx(attempt_s(Cup(0.5), 0.3), abs=1e-4)


def test_a_cup_that_was_taken_hides_nothing():
    cups = [Cup(0.5), Cup(0.5), Cup(0.5, is_on_table=False)]
    hides = np.array([[0.0, 0.5, 0.9], [0.2, 0.0, 0.9], [0.0, 0.0, 0.0]])
    belief = belief_of(CONFIG, state_of(cups, hides))

    without = occlusion_without(belief, np.array([False, True, False]))

    np.testing.assert_allclose(without[:2], [0.0, 0.2], atol=1e-6)


def test_labels_leave_the_expected_chance_of_dirt_as_it_was():
    dirty = np.array([0.1, 0.5, 0.9])

    says_dirty, if_dirty, if_clean = dirty_after_label(CONFIG, dirty, np.zeros(3), np.array([0.0, 0.5, 1.0]))

    np.testing.assert_allclose(says_dirty * if_dirty + (1 - says_dirty) * if_clean, dirty, rtol=1e-5)
    np.testing.assert_allclose(if_dirty[0], 0.1 * 0.8 / (0.1 * 0.8 + 0.9 * 0.2), rtol=1e-5)
    np.testing.assert_allclose([if_dirty[2], if_clean[2]], 0.9, rtol=1e-5)


@pytest.mark.slow
def test_sampled_futures_of_a_wash_take_the_cup_away_as_often_as_it_is_grasped():
    cups, hides = [Cup(0.7, ((0.2, False),)), Cup(0.4)], [[0.0, 0.6], [0.0, 0.0]]
    futures = drawn_successors(CONFIG, state_of(cups, hides), 0, 20_000)

    assert 1 - futures.is_there[0].mean() == pytest.approx(chance(cups[0], 0.6), abs=0.015)
    assert bool(futures.is_there[1].all())
    assert set(futures.steps_to_go) == {9}
    # What is believed of dirt is a martingale: labels on average change nothing. So it is of the grip.
    assert futures.is_dirty[1].mean() == pytest.approx(0.4, abs=0.01)
    weights = softmax(belief_of(CONFIG, state_of(cups, hides)).grip.log_weights)
    np.testing.assert_allclose(futures.weights.mean(axis=-1).T, weights, atol=0.01)
