"""Beliefs, planners and the exact optimum where grips show and errors of labels persist."""

from dataclasses import replace

import numpy as np
import pytest
from naive_fitted import FittedBruteForce
from naive_planner import Cup
from scipy.special import expit

from fitted_laws import FITTED, GRASPING, SEEING
from halfseen.arrays import record, softmax
from halfseen.errors import ArgumentError
from halfseen.planners import GreedyPolicy, POMDPPolicy, explain, information_relaxation_bound, plan, solve_table
from halfseen.planners.belief import (
    Grip,
    belief_of,
    dirty_after_label,
    grasp_probability,
    grip_posterior,
    offset_nodes,
    prior_grip,
)
from halfseen.planners.one_step import one_step_q
from halfseen.planners.rollout import sampled_values
from halfseen.world import AssumedGrasping, AssumedSeeing, Scene, UniformPolicy, WorldConfig, random
from halfseen.world.rollout import evaluate, play
from halfseen.world.state import pad_scenes
from picked import picked
from tables import drawn_successors, state_of

TWO = Scene(np.array([[0.0, 0.6], [0.1, 0.0]]), grip=np.array([-1.0, 0.5]))
THREE = Scene(np.array([[0.0, 0.6, 0.3], [0.1, 0.0, 0.2], [0.4, 0.05, 0.0]]), grip=np.array([0.5, -1.5, 0.0]))
GREEDY = [GreedyPolicy(FITTED, uses_history=h, counts_penalty=p) for h in (False, True) for p in (False, True)]
# Looks are cheap and clean cups dear, so that it pays to lift.
CAREFUL = replace(FITTED, reward_wash_clean=-20.0, reward_lift_per_s=-0.02)


@pytest.mark.parametrize("config", [FITTED, CAREFUL], ids=["fitted", "careful"])
@pytest.mark.parametrize(("scene", "horizon", "num_nodes"), [(TWO, 1, 3), (TWO, 2, 3), (TWO, 3, 2), (THREE, 1, 2)])
def test_the_optimum_is_what_brute_force_finds(config, scene, horizon, num_nodes):
    expected = FittedBruteForce(config, scene.hides, scene.grip, num_nodes).value(horizon)
    optimum = solve_table(scene, config, horizon, num_nodes)

    assert optimum.value == pytest.approx(expected, abs=1e-12)


@pytest.mark.slow
def test_the_optimum_of_three_cups_is_what_brute_force_finds():
    expected = FittedBruteForce(CAREFUL, THREE.hides, THREE.grip, 2).value(2)

    assert solve_table(THREE, CAREFUL, 2, 2).value == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("policy", GREEDY, ids=lambda policy: f"history {policy.uses_history}")
def test_the_value_of_a_rule_is_what_brute_force_finds(policy):
    def choose(is_dirty, seen, there, attempts, steps):
        tried = [tuple(one[1:] for one in attempts if one[0] == i) for i in range(2)]
        cups = [Cup(is_dirty[i], tried[i], i in there, TWO.grip[i], seen[i]) for i in range(2)]
        return int(policy.decide(state_of(cups, TWO.hides, steps), random.key_of(0)).action)

    expected = FittedBruteForce(FITTED, TWO.hides, TWO.grip, 3, choose).value(3)

    assert solve_table(TWO, FITTED, 3, 3).policy_value(policy) == pytest.approx(expected, abs=1e-9)


def test_grips_that_show_hold_under_the_assumed_laws_too():
    """A grip offset of every cup is another mean time to grasp."""
    config, faster = WorldConfig(), WorldConfig(grasping=AssumedGrasping(log_time=0.6 - 0.7))
    shown = replace(TWO, grip=np.full(2, 0.7))

    assert solve_table(shown, config, 3).value == pytest.approx(solve_table(TWO.hides, faster, 3).value, abs=1e-12)


@pytest.fixture(scope="module")
def played():
    """States along the way of somebody who acts by lot, on three cups over four steps."""
    episodes = play(replace(FITTED, horizon=4), pad_scenes([THREE]), UniformPolicy(), random.key_of(0), 40)
    states = picked(episodes.states, episodes.is_taken)
    return [picked(states, k) for k in range(len(states.steps_to_go))]


def test_beliefs_of_grips_are_those_of_bayes(played):
    node, weight = np.polynomial.hermite_e.hermegauss(7)
    for state in played[::5]:
        grip = grip_posterior(FITTED, state)
        tried = zip(state.attempt_object, state.attempt_occlusion, state.attempt_succeeded, strict=True)
        expected = np.tile(weight, (3, 1))
        for cup, occluded, is_grasped in tried:
            held = expit(2.0 - 1.5 * float(occluded) + THREE.grip[cup] + 0.8 * node)
            expected[cup] *= (held if is_grasped else 1 - held) if cup >= 0 else 1.0
        got = softmax(grip.log_weights)
        np.testing.assert_allclose(got, expected / expected.sum(axis=1, keepdims=True), atol=1e-5)
        held = expit(2.0 - 1.5 * 0.3 + THREE.grip[:, None] + 0.8 * node)
        chance = np.sum(got * held, axis=1)
        np.testing.assert_allclose(grasp_probability(FITTED, np.full(3, 0.3), grip), chance, atol=1e-5)


def test_an_object_that_seems_easier_to_grip_is_expected_to_hold():
    chance = grasp_probability(FITTED, np.zeros(3), prior_grip(np.array([-2.0, 0.0, 2.0])))
    assert (np.diff(chance) > 0.05).all()
    assert offset_nodes(FITTED).shape == (7,)


@pytest.mark.parametrize("is_held", [False, True])
def test_labels_leave_the_expected_chance_of_dirt_as_it_was(is_held):
    dirty, seen = np.array([0.1, 0.5, 0.9, 0.5]), np.array([0.0, 0.3, 0.6, 1.0])
    occluded = np.zeros(4)
    says_dirty, if_dirty, if_clean = dirty_after_label(FITTED, dirty, seen, occluded, is_held)

    np.testing.assert_allclose(says_dirty * if_dirty + (1 - says_dirty) * if_clean, dirty, rtol=1e-5)
    assert (says_dirty == 0.0).tolist() == [False, False, not is_held, True]
    assert np.isfinite(if_dirty).all()


@pytest.mark.slow
def test_sampled_futures_keep_what_is_believed_of_dirt_on_average(played):
    state = next(state for state in played if state.is_on_table.all() and (state.seen < 1.0).all())
    belief = belief_of(FITTED, state)
    futures = drawn_successors(FITTED, state, 3 + 1, 20_000)

    np.testing.assert_allclose(futures.is_dirty.mean(axis=-1), expit(belief.log_odds), atol=0.01)
    chance = float(grasp_probability(FITTED, np.asarray(THREE.occlusion[1]), Grip(*(leaf[1] for leaf in belief.grip))))
    assert float((futures.seen[1] == 1.0).mean()) == pytest.approx(chance, abs=0.015)
    assert bool((futures.seen >= belief.seen[:, None]).all())


def test_at_the_last_step_the_look_ahead_is_exact(played):
    optimum = solve_table(THREE, FITTED, 4)
    states = [state for state in played if int(state.steps_to_go) == 1]

    assert len(states) > 5
    for state in states:
        np.testing.assert_allclose(one_step_q(FITTED, belief_of(FITTED, state)), optimum.q_values(state), atol=2e-4)


@pytest.mark.slow
def test_two_steps_before_the_end_rollouts_are_right_on_average(played):
    """The look-ahead that follows is exact there."""
    optimum = solve_table(THREE, FITTED, 4)
    states = [state for state in played if int(state.steps_to_go) == 2][:6]
    for state in states:
        worths = np.asarray(sampled_values(FITTED, state, random.key_of(0), 4_000), dtype=np.float64)
        is_possible = np.isfinite(worths[0])
        error = worths[:, is_possible].std(axis=0) / np.sqrt(len(worths))
        distance = np.abs(worths.mean(axis=0)[is_possible] - optimum.q_values(state)[is_possible])
        assert (distance < 5.0 * error + 1e-3).all()


def test_every_state_of_the_world_has_its_place(played):
    """Of q in it, the best is the value that is played for."""
    optimum = solve_table(THREE, FITTED, 4)
    for state in played:
        q = optimum.q_values(state)
        assert np.isfinite(q[0])
        assert q.max() >= 5.0 * -3.0
    with pytest.raises(ArgumentError, match="of it seen; the nearest"):
        optimum.q_values(replace(played[0], seen=np.full(3, 0.05, dtype=np.float32)))


@pytest.mark.parametrize("config", [FITTED, CAREFUL], ids=["fitted", "careful"])
def test_rules_and_planners_are_below_the_optimum_and_that_below_every_bound(config):
    rules = [replace(rule, config=config) for rule in GREEDY]
    optimum = solve_table(TWO, config, 4)
    *by_rule, by_plan = optimum.policy_values([*rules, POMDPPolicy(config, 1)])
    bounds = [
        information_relaxation_bound(TWO, config, 4, num_grip_nodes=3, reveals=reveals).value
        for reveals in ("looks", "hidden")
    ]

    assert max(by_rule) <= by_plan + 1e-9 <= optimum.value + 2e-9
    assert optimum.value < bounds[0] < bounds[1]


def test_more_is_found_out_the_more_is_left_to_see():
    """Who holds up a cup in doubt sees what the table hides; once all is seen, nobody lifts it."""
    doubt = state_of([Cup(0.55, seen=0.6), Cup(0.55, seen=1.0)], np.zeros((2, 2)), steps_to_go=3)
    for q in (
        plan(CAREFUL, doubt, random.key_of(0), num_simulations=256).values,
        explain(CAREFUL, doubt, random.key_of(0), num_rollouts=128).values,
    ):
        assert q[3] > q[4] + 0.5


def test_a_bound_by_looks_needs_labels_that_are_as_good_for_clean_as_for_dirty():
    @record
    class Skewed(AssumedSeeing):
        def positive(self, occluded, seen, is_held=False):
            accuracy = self.accuracy(occluded)
            return accuracy, (1.0 - accuracy) / 2.0

    config = WorldConfig(grasping=GRASPING, seeing=Skewed())
    with pytest.raises(ArgumentError, match="reveals is 'looks', and labels are not right as often"):
        information_relaxation_bound(TWO, config, 2)
    assert solve_table(TWO, config, 2).value < information_relaxation_bound(TWO, config, 2, reveals="hidden").value


@pytest.mark.slow
@pytest.mark.parametrize("policy", [GREEDY[1], GREEDY[3], POMDPPolicy(FITTED, 1)], ids=["greedy", "history", "pomdp"])
def test_a_policy_earns_in_the_world_what_it_is_worth(policy):
    config = replace(FITTED, horizon=4)
    rewards = np.asarray(
        evaluate(config, pad_scenes([THREE]), policy, random.key_of(0), 200_000).reward, dtype=np.float64
    )
    worth = solve_table(THREE, FITTED, 4, num_grip_nodes=31).policy_value(policy)

    error = rewards.std() / np.sqrt(len(rewards))
    assert rewards.mean() == pytest.approx(worth, abs=4 * error)
    assert SEEING.facing < 1.0
    assert error < 0.04
