"""Beliefs under the assumed laws and the fitted ones, and what planners and the optimum make of the latter."""

from dataclasses import replace

import numpy as np
import pytest
from naive_planner import CONFIG, Cup, attempt_s, chance, over_grips
from scipy.special import expit, logit

from fitted_laws import FITTED, GRASPING
from halfseen.arrays import record, softmax
from halfseen.errors import ArgumentError
from halfseen.planners import explain, information_relaxation_bound, plan, solve_table
from halfseen.planners.belief import (
    GripPosterior,
    expected_attempt_s,
    grasp_probability,
    grip_posterior,
    offset_nodes,
    prior_grip,
)
from halfseen.planners.one_step import one_step_q
from halfseen.planners.rollout import sampled_values
from halfseen.world import AssumedGrasping, AssumedSeeing, Scene, WorldConfig, random
from halfseen.world.seeing import label_evidence
from tables import THREE, TWO, drawn_successors, met_by_lot, state_of

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
    grip = GripPosterior(*(leaf[1] for leaf in grip_posterior(CONFIG, state_of(cups, np.zeros((2, 2))))))

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


@pytest.mark.parametrize(("config", "is_held"), [(CONFIG, False), (FITTED, False), (FITTED, True)])
def test_labels_leave_the_expected_chance_of_dirt_as_it_was(config, is_held):
    persists = config is FITTED
    dirty, seen = np.array([0.1, 0.5, 0.9, 0.5]), np.array([0.0, 0.3, 0.6, 1.0]) * persists
    occluded = np.zeros(4) if persists else np.array([0.0, 0.5, 1.0, 0.0])
    positive = config.seeing.positive(occluded, seen, is_held)
    says_dirty = dirty * positive[0] + (1 - dirty) * positive[1]
    if_dirty, if_clean = (expit(logit(dirty) + label_evidence(*positive, says)) for says in (True, False))

    np.testing.assert_allclose(says_dirty * if_dirty + (1 - says_dirty) * if_clean, dirty, rtol=1e-5)
    if persists:
        assert (says_dirty == 0.0).tolist() == [False, False, not is_held, True]
    else:
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


SCENE = Scene(THREE, grip=np.array([0.5, -1.5, 0.0]))


def test_grips_that_show_hold_under_the_assumed_laws_too():
    """A grip offset of every cup is another mean time to grasp."""
    config, faster = WorldConfig(), WorldConfig(grasping=AssumedGrasping(log_time=0.6 - 0.7))
    shown = Scene(TWO, grip=np.full(2, 0.7))

    assert solve_table(shown, config, 3).value == pytest.approx(solve_table(TWO, faster, 3).value, abs=1e-12)


@pytest.fixture(scope="module")
def played():
    """States along the way of somebody who acts by lot, on three cups over four steps."""
    return met_by_lot(replace(FITTED, horizon=4), SCENE, 40)


def test_beliefs_of_grips_are_those_of_bayes(played):
    node, weight = np.polynomial.hermite_e.hermegauss(7)
    for state in played[::5]:
        grip = grip_posterior(FITTED, state)
        tried = zip(state.attempt_object, state.attempt_occlusion, state.attempt_succeeded, strict=True)
        expected = np.tile(weight, (3, 1))
        for cup, occluded, is_grasped in tried:
            held = expit(2.0 - 1.5 * float(occluded) + SCENE.grip[cup] + 0.8 * node)
            expected[cup] *= (held if is_grasped else 1 - held) if cup >= 0 else 1.0
        got = softmax(grip.log_weights)
        np.testing.assert_allclose(got, expected / expected.sum(axis=1, keepdims=True), atol=1e-5)
        held = expit(2.0 - 1.5 * 0.3 + SCENE.grip[:, None] + 0.8 * node)
        chance = np.sum(got * held, axis=1)
        np.testing.assert_allclose(grasp_probability(FITTED, np.full(3, 0.3), grip), chance, atol=1e-5)


def test_an_object_that_seems_easier_to_grip_is_expected_to_hold():
    chance = grasp_probability(FITTED, np.zeros(3), prior_grip(np.array([-2.0, 0.0, 2.0])))
    assert (np.diff(chance) > 0.05).all()
    assert offset_nodes(FITTED).shape == (7,)


@pytest.mark.slow
def test_sampled_futures_keep_what_is_believed_of_dirt_on_average(played):
    state = next(state for state in played if state.is_on_table.all() and (state.seen < 1.0).all())
    futures = drawn_successors(FITTED, state, 3 + 1, 20_000)

    np.testing.assert_allclose(futures.is_dirty.mean(axis=-1), expit(state.log_odds), atol=0.01)
    grip = GripPosterior(*(leaf[1] for leaf in grip_posterior(FITTED, state)))
    chance = float(grasp_probability(FITTED, np.asarray(SCENE.occlusion[1]), grip))
    assert float((futures.seen[1] == 1.0).mean()) == pytest.approx(chance, abs=0.015)
    assert bool((futures.seen >= state.seen[:, None]).all())


def test_at_the_last_step_the_look_ahead_is_exact(played):
    optimum = solve_table(SCENE, FITTED, 4)
    states = [state for state in played if int(state.steps_to_go) == 1]

    assert len(states) > 5
    for state in states:
        np.testing.assert_allclose(one_step_q(FITTED, state), optimum.q_values(state), atol=2e-4)


@pytest.mark.slow
def test_two_steps_before_the_end_rollouts_are_right_on_average(played):
    """The look-ahead that follows is exact there."""
    optimum = solve_table(SCENE, FITTED, 4)
    states = [state for state in played if int(state.steps_to_go) == 2][:6]
    for state in states:
        worths = np.asarray(sampled_values(FITTED, state, random.key_of(0), 4_000), dtype=np.float64)
        is_possible = np.isfinite(worths[0])
        error = worths[:, is_possible].std(axis=0) / np.sqrt(len(worths))
        distance = np.abs(worths.mean(axis=0)[is_possible] - optimum.q_values(state)[is_possible])
        assert (distance < 5.0 * error + 1e-3).all()


def test_every_state_of_the_world_has_its_place(played):
    """Of q in it, the best is the value that is played for."""
    optimum = solve_table(SCENE, FITTED, 4)
    for state in played:
        q = optimum.q_values(state)
        assert np.isfinite(q[0])
        assert q.max() >= 5.0 * -3.0
    with pytest.raises(ArgumentError, match="of it seen; the nearest"):
        optimum.q_values(replace(played[0], seen=np.full(3, 0.05, dtype=np.float32)))


def test_more_is_found_out_the_more_is_left_to_see():
    """Holding up a cup in doubt shows what the table hides; what was all seen is not lifted, though lifts are cheap."""
    careful = replace(FITTED, reward_wash_clean=-20.0, reward_lift_per_s=-0.02)
    doubt = state_of([Cup(0.55, seen=0.6), Cup(0.55, seen=1.0)], np.zeros((2, 2)), steps_to_go=3)
    for q in (
        plan(careful, doubt, random.key_of(0), num_simulations=256).values,
        explain(careful, doubt, random.key_of(0), num_rollouts=128).values,
    ):
        assert q[3] > q[4] + 0.5


def test_a_bound_by_looks_needs_labels_that_are_as_good_for_clean_as_for_dirty():
    @record
    class Skewed(AssumedSeeing):
        def positive(self, occluded, seen, is_held=False):
            accuracy = self.accuracy(occluded)
            return accuracy, (1.0 - accuracy) / 2.0

    config = WorldConfig(grasping=GRASPING, seeing=Skewed())
    with pytest.raises(ArgumentError, match="reveals is 'looks', but labels are not equally accurate"):
        information_relaxation_bound(TWO, config, 2)
    assert solve_table(TWO, config, 2).value < information_relaxation_bound(TWO, config, 2, reveals="hidden").value
