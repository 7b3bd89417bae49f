from dataclasses import replace

import naive_planner
import numpy as np
import pytest
from naive_planner import CONFIG, Cup

from halfseen.errors import ArgumentError
from halfseen.planners import GreedyPolicy, POMDPPolicy
from halfseen.planners.belief import Belief, Grip, belief_of
from halfseen.planners.one_step import one_step_q
from halfseen.world import Scene, random
from halfseen.world.actions import FINISH, possible_actions
from halfseen.world.rollout import evaluate
from halfseen.world.state import pad_scenes
from tables import state_of

HIDES = np.array([[0.0, 0.6], [0.1, 0.0]])
TWO_CUPS = {
    "nothing was tried": [Cup(0.6), Cup(0.75)],
    "both were tried": [Cup(0.85, ((0.6, False), (0.6, True))), Cup(0.4, ((0.1, False),))],
    "one is washed": [Cup(0.9, ((0.6, False),)), Cup(0.6, ((0.1, True),), is_on_table=False)],
    "all are clean": [Cup(0.02), Cup(0.01)],
}
by_table = pytest.mark.parametrize("cups", TWO_CUPS.values(), ids=TWO_CUPS.keys())


def decide(policy, state, key):
    return int(policy.decide(state, key).action)


def random_belief(num_objects, seed, steps_to_go=9):
    rng = np.random.default_rng(seed)
    hides = rng.uniform(0.0, 0.6, (num_objects, num_objects)) * ~np.eye(num_objects, dtype=bool)
    is_on_table = np.arange(num_objects) != 1
    log_odds, weights = rng.normal(1.0, 1.0, num_objects), rng.normal(size=(num_objects, 7))
    leaves = log_odds, rng.uniform(size=num_objects), rng.normal(size=num_objects), weights
    log_odds, seen, *grip = (leaf.astype(np.float32) for leaf in leaves)
    return Belief(hides.astype(np.float32), is_on_table, log_odds, seen, Grip(*grip), np.int32(steps_to_go))


@by_table
@pytest.mark.parametrize("steps_to_go", [1, 3, 10])
def test_one_step_ahead_every_outcome_counts_as_often_as_it_happens(cups, steps_to_go):
    q = one_step_q(CONFIG, belief_of(CONFIG, state_of(cups, HIDES, steps_to_go)))

    np.testing.assert_allclose(q, naive_planner.q_values(cups, HIDES, steps_to_go, depth=1), atol=2e-4)


@pytest.mark.parametrize("cups", [TWO_CUPS["nothing was tried"], TWO_CUPS["both were tried"]])
@pytest.mark.slow
def test_two_steps_ahead_rollouts_agree_with_all_that_may_follow(cups):
    state, policy = state_of(cups, HIDES, 4), POMDPPolicy(CONFIG, 2, num_simulations=20_000)

    q = policy.q_values(state, random.key_of(0))

    expected = np.array(naive_planner.q_values(cups, HIDES, 4, depth=2))
    np.testing.assert_allclose(q, expected, atol=0.06)
    assert np.max(np.abs(expected - one_step_q(CONFIG, belief_of(CONFIG, state)))) > 0.25


def test_q_does_not_depend_on_the_order_of_the_cups():
    belief, order = random_belief(4, 0), np.array([2, 0, 3, 1])
    shuffled = Belief(
        belief.hides[order][:, order],
        belief.is_on_table[order],
        belief.log_odds[order],
        belief.seen[order],
        Grip(*(leaf[order] for leaf in belief.grip)),
        belief.steps_to_go,
    )
    of_action = np.concatenate([[0], 1 + order, 5 + order])

    np.testing.assert_allclose(one_step_q(CONFIG, shuffled), one_step_q(CONFIG, belief)[of_action], rtol=1e-5)


def test_padding_changes_nothing():
    belief = random_belief(3, 1, steps_to_go=2)
    pad = ((0, 2),)
    nan = {"constant_values": np.nan}
    padded = Belief(
        np.pad(belief.hides, pad * 2, **nan),
        np.pad(belief.is_on_table, pad),
        np.pad(belief.log_odds, pad, **nan),
        np.pad(belief.seen, pad, **nan),
        Grip(np.pad(belief.grip.mean, pad, **nan), np.pad(belief.grip.log_weights, (*pad, (0, 0)), **nan)),
        belief.steps_to_go,
    )
    is_real = np.array([True] + 2 * ([True] * 3 + [False] * 2))
    q = one_step_q(CONFIG, padded)

    np.testing.assert_allclose(q[is_real], one_step_q(CONFIG, belief), rtol=1e-5)
    assert np.all(q[~is_real] == -np.inf)


@pytest.mark.parametrize("planning_horizon", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_padding_changes_no_decision(planning_horizon):
    policy, key = POMDPPolicy(CONFIG, planning_horizon), random.key_of(0)
    for cups in TWO_CUPS.values():
        plain, padded = (decide(policy, state_of(cups, HIDES, num_padding=k), key) for k in (0, 2))
        verb, target = divmod(int(plain) - 1, 2)
        assert int(padded) == (FINISH if plain == FINISH else 1 + 4 * verb + target)


@pytest.mark.parametrize("planning_horizon", [1, 2])
def test_it_finishes_a_table_that_is_surely_clean(planning_horizon):
    state = state_of([Cup(1e-4), Cup(1e-4)], HIDES)

    assert decide(POMDPPolicy(CONFIG, planning_horizon), state, random.key_of(0)) == FINISH


@pytest.mark.parametrize("planning_horizon", [1, 2])
def test_it_washes_what_is_surely_dirty_and_looks_before_it_washes_what_is_not(planning_horizon):
    policy = POMDPPolicy(CONFIG, planning_horizon)
    in_doubt = state_of([Cup(0.5)], np.zeros((1, 1)))

    assert decide(policy, state_of([Cup(0.999)], np.zeros((1, 1))), random.key_of(0)) == 1
    assert decide(policy, in_doubt, random.key_of(0)) == 2
    # With one step to go there is nothing to look for.
    assert decide(policy, replace(in_doubt, steps_to_go=np.int32(1)), random.key_of(0)) != 2


@pytest.mark.slow
def test_it_never_takes_a_cup_that_is_gone():
    cups = [Cup(0.99, is_on_table=False), Cup(0.99, is_on_table=False), Cup(0.7)]
    state = state_of(cups, np.zeros((3, 3)))
    for planning_horizon in (1, 2):
        actions = [decide(POMDPPolicy(CONFIG, planning_horizon), state, random.key_of(k)) for k in range(5)]
        assert all(possible_actions(state)[action] for action in actions)


@pytest.mark.parametrize("name", ["planning_horizon", "num_simulations"])
def test_numbers_below_one_are_refused(name):
    with pytest.raises(ArgumentError, match=f"{name} is 0; it is at least 1"):
        POMDPPolicy(CONFIG, **{name: 0})


@pytest.mark.slow
def test_on_two_cups_a_long_look_earns_no_less_than_heuristics():
    layouts, num = pad_scenes([Scene(HIDES)]), 400

    def rewards(policy):
        return np.asarray(evaluate(CONFIG, layouts, policy, random.key_of(0), num).reward, dtype=float)

    found = rewards(POMDPPolicy(CONFIG, CONFIG.horizon, 32))
    greedy = found - rewards(GreedyPolicy(CONFIG, uses_history=True, counts_penalty=True))
    one_step = found - rewards(POMDPPolicy(CONFIG, 1))
    assert greedy.mean() > 2 * greedy.std() / np.sqrt(num)
    assert one_step.mean() > -2 * one_step.std() / np.sqrt(num)


@pytest.mark.parametrize("horizon", [1.5, float("nan"), float("inf")])
def test_a_horizon_between_steps_is_refused(horizon):
    with pytest.raises(ArgumentError, match=f"planning_horizon is {horizon}; it is a whole number"):
        POMDPPolicy(CONFIG, horizon)
