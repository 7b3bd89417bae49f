import naive_planner
import numpy as np
import pytest
from naive_planner import CONFIG, Cup

from halfseen.errors import ArgumentError
from halfseen.planners import HEURISTICS, GreedyPolicy, POMDPPolicy
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


def random_cups(num, seed):
    """Cups, the second of which was taken away, with how far each hides the others."""
    rng = np.random.default_rng(seed)
    hides = rng.uniform(0.0, 0.6, (num, num)) * ~np.eye(num, dtype=bool)
    cups = [
        Cup(p, ((0.3, False),) * int(rng.integers(3)), is_on_table=i != 1, grip=rng.normal(), seen=rng.uniform())
        for i, p in enumerate(rng.uniform(0.2, 0.95, num))
    ]
    return cups, hides


@by_table
@pytest.mark.parametrize("steps_to_go", [1, 3, 10])
def test_one_step_ahead_every_outcome_counts_as_often_as_it_happens(cups, steps_to_go):
    q = one_step_q(CONFIG, state_of(cups, HIDES, steps_to_go))

    np.testing.assert_allclose(q, naive_planner.q_values(cups, HIDES, steps_to_go, depth=1), atol=2e-4)


@pytest.mark.parametrize("cups", [TWO_CUPS["nothing was tried"], TWO_CUPS["both were tried"]])
@pytest.mark.slow
def test_two_steps_ahead_rollouts_agree_with_all_that_may_follow(cups):
    state, policy = state_of(cups, HIDES, 4), POMDPPolicy(CONFIG, 2, num_simulations=20_000)

    q = policy.q_values(state, random.key_of(0))

    expected = np.array(naive_planner.q_values(cups, HIDES, 4, depth=2))
    np.testing.assert_allclose(q, expected, atol=0.06)
    assert np.max(np.abs(expected - one_step_q(CONFIG, state))) > 0.25


def test_q_does_not_depend_on_the_order_of_the_cups():
    (cups, hides), order = random_cups(4, 0), np.array([2, 0, 3, 1])
    shuffled = one_step_q(CONFIG, state_of([cups[i] for i in order], hides[order][:, order]))
    of_action = np.concatenate([[0], 1 + order, 5 + order])

    np.testing.assert_allclose(shuffled, one_step_q(CONFIG, state_of(cups, hides))[of_action], rtol=1e-5)


def test_padding_changes_nothing():
    plain, padded = (one_step_q(CONFIG, state_of(*random_cups(3, 1), steps_to_go=2, num_padding=k)) for k in (0, 2))
    is_real = np.array([True] + 2 * ([True] * 3 + [False] * 2))

    np.testing.assert_allclose(padded[is_real], plain, rtol=1e-5)
    assert np.all(padded[~is_real] == -np.inf)


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
