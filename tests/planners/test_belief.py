import numpy as np
import pytest
from naive_planner import CONFIG, Cup, attempt_s, chance, over_grips

from halfseen.arrays import softmax
from halfseen.planners.belief import (
    Grip,
    dirty_after_label,
    expected_attempt_s,
    grasp_probability,
    grip_posterior,
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


@pytest.mark.parametrize("attempts", HISTORIES)
def test_a_grip_and_the_chance_of_a_grasp_agree_with_integration_on_a_fine_grid(attempts):
    cups = [Cup(0.5, ((0.1, True),)), Cup(0.5, attempts)]
    grip = Grip(*(leaf[1] for leaf in grip_posterior(CONFIG, state_of(cups, np.zeros((2, 2))))))

    expected = over_grips(cups[1], float, GRID, NORMAL)
    assert float(softmax(grip.log_weights) @ offset_nodes(CONFIG)) == pytest.approx(expected, abs=0.06)
    for occluded in (0.0, 0.25, 0.4, 0.5, 0.8, 1.0):
        planned = float(grasp_probability(CONFIG, np.float32(occluded), grip))
        assert planned == pytest.approx(exact_chance(cups[1], occluded), abs=0.02 if attempts else 0.002)


def test_a_first_attempt_goes_as_simulated_ones():
    rng, unknown = np.random.default_rng(1), prior_grip(np.zeros((), dtype=np.float32))
    drawn_s = np.exp(0.6 + 2.2 * 0.3 - rng.normal(size=200_000)) * rng.exponential(size=200_000)

    assert float(grasp_probability(CONFIG, np.float32(0.3), unknown)) == pytest.approx(np.mean(drawn_s <= 6), abs=0.005)
    planned_s = float(expected_attempt_s(CONFIG, np.float32(0.3), unknown))
    assert planned_s == pytest.approx(1.0 + np.minimum(drawn_s, 6.0).mean(), abs=0.02)
    assert planned_s == pytest.approx(attempt_s(Cup(0.5), 0.3), abs=1e-4)


def test_labels_leave_the_expected_chance_of_dirt_as_it_was():
    dirty = np.array([0.1, 0.5, 0.9])

    says_dirty, if_dirty, if_clean = dirty_after_label(CONFIG, dirty, np.zeros(3), np.array([0.0, 0.5, 1.0]))

    np.testing.assert_allclose(says_dirty * if_dirty + (1 - says_dirty) * if_clean, dirty, rtol=1e-5)
    np.testing.assert_allclose(if_dirty[0], 0.1 * 0.8 / (0.1 * 0.8 + 0.9 * 0.2), rtol=1e-5)
    np.testing.assert_allclose([if_dirty[2], if_clean[2]], 0.9, rtol=1e-5)


@pytest.mark.parametrize("choice", [0, 2], ids=["WASH", "LIFT"])
def test_what_is_believed_stays_so_on_average_over_sampled_futures(choice):
    cups, hides = [Cup(0.7, ((0.2, False),)), Cup(0.4)], [[0.0, 0.6], [0.0, 0.0]]
    state = state_of(cups, hides)
    futures = drawn_successors(CONFIG, state, choice, 20_000)

    is_gone = 1 - futures.is_there[0].mean()
    assert is_gone == pytest.approx(chance(cups[0], 0.6) if choice == 0 else 0.0, abs=0.015)
    assert bool(futures.is_there[1].all())
    assert set(futures.steps_to_go) == {9}
    # Of what is looked at after every result.
    looked_at = [0.4] if choice == 0 else [0.7, 0.4]
    np.testing.assert_allclose(futures.is_dirty.mean(axis=-1)[-len(looked_at) :], looked_at, atol=0.01)
    weights = softmax(grip_posterior(CONFIG, state).log_weights)
    np.testing.assert_allclose(futures.weights.mean(axis=-1).T, weights, atol=0.01)
    np.testing.assert_allclose(futures.weights.sum(axis=0), 1.0, atol=1e-5)
