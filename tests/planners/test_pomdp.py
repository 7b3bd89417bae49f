import naive_planner
import numpy as np
import pytest
from naive_planner import CONFIG, Cup

from halfseen.errors import ArgumentError
from halfseen.planners import HEURISTICS, GreedyPolicy, POMDPPolicy
from halfseen.planners.belief import Belief, Grip, belief_of
from halfseen.planners.one_step import one_step_q
from halfseen.world import Scene, WorldConfig, random
from halfseen.world.actions import FINISH
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
@pytest.mark.parametrize(
    ("is_dirty", "steps_to_go", "action"), [((1e-4, 1e-4), 10, 0), ((0.999,), 10, 1), ((0.5,), 10, 2), ((0.5,), 1, 0)]
)
def test_it_leaves_what_is_clean_washes_what_is_dirty_and_looks_before_the_last_step(
    planning_horizon, is_dirty, steps_to_go, action
):
    state = state_of([Cup(p) for p in is_dirty], np.zeros((len(is_dirty), len(is_dirty))), steps_to_go)

    assert decide(POMDPPolicy(CONFIG, planning_horizon), state, random.key_of(0)) == action


def rewards(policy, layouts, num):
    return np.asarray(evaluate(policy.config, layouts, policy, random.key_of(0), num).reward, dtype=float)


def in_errors(difference):
    """Mean of a difference in its standard errors."""
    return difference.mean() / (difference.std() / np.sqrt(len(difference)))


def random_layouts(seed, sizes):
    rng = np.random.default_rng(seed)
    return pad_scenes(
        [Scene(rng.uniform(0, 0.5, (n, n)) * (rng.random((n, n)) < 0.4) * ~np.eye(n, dtype=bool)) for n in sizes]
    )


@pytest.mark.slow
def test_on_two_cups_a_long_look_earns_no_less_than_heuristics():
    layouts, rule = pad_scenes([Scene(HIDES)]), GreedyPolicy(CONFIG, uses_history=True, counts_penalty=True)
    long, greedy, one = (
        rewards(each, layouts, 400) for each in (POMDPPolicy(CONFIG, CONFIG.horizon, 32), rule, POMDPPolicy(CONFIG, 1))
    )
    assert in_errors(long - greedy) > 2
    assert in_errors(long - one) > -2


@pytest.mark.slow
def test_looking_further_ahead_earns_more_on_the_same_tables():
    layouts = random_layouts(0, (4, 6))
    heuristics = [rewards(GreedyPolicy(CONFIG, *how), layouts, 3000) for how in HEURISTICS.values()]
    best = max(heuristics, key=np.mean)
    one, two = (rewards(POMDPPolicy(CONFIG, h, 32), layouts, 3000) for h in (1, 2))

    assert in_errors(one - best) > 3
    assert in_errors(two - one) > 3


@pytest.mark.slow
def test_more_simulations_earn_no_less_on_the_same_tables():
    layouts, config = random_layouts(1, (4, 4, 4)), WorldConfig(horizon=5)
    myopic, few, many = (rewards(POMDPPolicy(config, h, n), layouts, 300) for h, n in ((1, 1), (5, 16), (5, 128)))

    assert in_errors(many - few) > -2
    assert in_errors(many - myopic) > -2


@pytest.mark.parametrize(
    ("numbers", "says"),
    [
        ({"planning_horizon": 0}, "planning_horizon is 0; it is at least 1"),
        ({"num_simulations": 0}, "num_simulations is 0; it is at least 1"),
        *(({"planning_horizon": wrong}, f"{wrong}; it is a whole number") for wrong in (1.5, np.nan, np.inf)),
    ],
)
def test_numbers_that_are_none_are_refused(numbers, says):
    with pytest.raises(ArgumentError, match=says):
        POMDPPolicy(CONFIG, **numbers)
