"""Looks ahead: of one robot, against plain recursion; of several; and rewards with less luck."""

from dataclasses import replace

import naive_planner
import numpy as np
import pytest
from naive_planner import CONFIG, Cup

from fitted_laws import FITTED
from halfseen.errors import ArgumentError
from halfseen.planners import HEURISTICS, GreedyPolicy, MyopicPolicy, POMDPPolicy, TeamOfRules, named_policy
from halfseen.planners.control import controlled, controlled_each, start_values
from halfseen.planners.one_step import one_step_q
from halfseen.world import AssumedGrasping, ExploringPolicy, Scene, UniformPolicy, WorldConfig, random
from halfseen.world.actions import FINISH, possible_actions, wait_of
from halfseen.world.policy import surely
from halfseen.world.rollout import evaluate, evaluate_some, play
from halfseen.world.state import pad_scenes
from halfseen.world.transition import start, step
from picked import picked
from tables import state_of
from world.world_cases import layouts_of

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
        ({"planning_horizon": 0}, "planning_horizon is 0; give at least 1"),
        ({"num_simulations": 0}, "num_simulations is 0; give at least 1"),
        *(({"planning_horizon": wrong}, f"{wrong}; give a whole number") for wrong in (1.5, np.nan, np.inf)),
    ],
)
def test_numbers_that_are_none_are_refused(numbers, says):
    with pytest.raises(ArgumentError, match=says):
        POMDPPolicy(CONFIG, **numbers)


TABLES = pad_scenes([Scene(np.tril(np.full((n, n), 0.4), -1), name=str(n)) for n in (2, 4)])
ALONE = pad_scenes([Scene(np.zeros((1, 1)))])
WASH = 1


class Always:
    """Takes the same action at every table."""

    def __init__(self, action):
        self.action = action

    def decide(self, state, key):
        return surely(np.full(len(state.log_odds), self.action))


def washed(config, p, to_go):
    """What trying to wash one object in every step left earns: it is never hidden, and its grip has no offset."""
    law = config.grasping
    holds = 1.0 - np.exp(-law.limit_s / np.exp(law.log_time))
    missed = -1.0 + (-5.0 * p if to_go == 1 else washed(config, p, to_go - 1))
    return holds * (5.0 * p - 10.0 * (1.0 - p)) + (1.0 - holds) * missed


def first_beliefs(config, key, episodes):
    """P(DIRTY) after the first look, right with probability .8."""
    log_odds = play(config, ALONE, Always(FINISH), key, len(episodes)).states.log_odds[:, 0, 0]
    return 1.0 / (1.0 + np.exp(-log_odds.astype(np.float64)))


def test_with_one_object_and_one_step_it_is_what_is_expected_of_the_action():
    config = WorldConfig(grasping=AssumedGrasping(offset_std=0.0), horizon=1)
    episodes, key = np.arange(40), random.key_of(3)
    p = first_beliefs(config, key, episodes)
    assert sorted(set(p.round(6))) == pytest.approx([0.3 / 1.1, 1.2 / 1.4], abs=1e-5)
    for action, expected in ((FINISH, -5.0 * p), (WASH, washed(config, p, 1))):
        assert controlled(config, ALONE, Always(action), key, episodes).reward == pytest.approx(expected, abs=1e-4)


def test_with_two_steps_its_mean_is_what_is_expected_by_hand():
    config = WorldConfig(grasping=AssumedGrasping(offset_std=0.0), horizon=2)
    episodes, key = np.arange(6000), random.key_of(4)
    p = first_beliefs(config, key, episodes)
    gap = controlled(config, ALONE, Always(WASH), key, episodes).reward - washed(config, p, 2)
    for which in (p > 0.5, p < 0.5):
        error = gap[which].std() / np.sqrt(which.sum())
        assert abs(gap[which].mean()) < max(4.0 * error, 1e-4)
        assert error < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("config", [WorldConfig(horizon=6), replace(FITTED, horizon=6)], ids=["assumed", "fitted"])
@pytest.mark.parametrize("who", ["history-penalty", "one-step", "uniform"])
def test_its_mean_is_that_of_the_rewards_and_its_noise_is_less(config, who):
    policy = {"one-step": POMDPPolicy(config, 1), "uniform": UniformPolicy()}.get(who) or named_policy(who, config)
    episodes, key = np.arange(2000), random.key_of(5)
    ours = controlled(config, TABLES, policy, key, episodes)
    raw = evaluate_some(config, TABLES, policy, key, episodes)
    gap = ours.reward - np.asarray(raw.reward, dtype=np.float64)
    assert abs(gap.mean()) < 4.0 * gap.std() / np.sqrt(len(gap))
    np.testing.assert_allclose(ours.robot_s, raw.robot_s, rtol=1e-5)
    most = 0.9 if who == "uniform" else 0.5
    assert ours.reward.var() < most * np.asarray(raw.reward).var()


def test_several_policies_side_by_side_earn_what_they_earn_alone_and_begin_alike():
    config, key, episodes = replace(FITTED, horizon=4), random.key_of(6), np.array([1, 4, 6, 7])
    policies = [named_policy(name, config) for name in ("greedy", "history-penalty")] + [POMDPPolicy(config, 1)]
    together = controlled_each(config, TABLES, policies, key, episodes)
    begun = start_values(config, TABLES, key, episodes)
    for policy, ours in zip(policies, together, strict=True):
        alone = controlled(config, TABLES, policy, key, episodes)
        for each, other in zip(ours, alone, strict=True):
            np.testing.assert_allclose(each, other, atol=1e-5)
        np.testing.assert_allclose(ours.value, begun, atol=1e-5)


NUM_OBJECTS = 5
WORLD = WorldConfig(horizon=6)
RULE = GreedyPolicy(WORLD, uses_history=True, counts_penalty=True)
KEY = random.key_of(0)
WAIT = wait_of(NUM_OBJECTS)


def team_of(num_robots, **others):
    return replace(WORLD, speed=(1.0,) * num_robots, **others)


def layouts(num_robots):
    """Objects 0 and 4 are each in reach of all robots but one; 1 and 2 stand near one another."""
    reach = np.ones((num_robots, NUM_OBJECTS), dtype=bool)
    if num_robots > 1:
        reach[0, 4] = reach[1, 0] = False
    return layouts_of(np.triu(np.full((NUM_OBJECTS, NUM_OBJECTS), 0.25), 1), reach, near=[(1, 2)])


def states_of(team, num_trajectories=40):
    """States that a team meets, half by chance; axis B."""
    behaviour = ExploringPolicy(TeamOfRules(RULE))
    trajectories = play(team, layouts(team.num_robots), behaviour, random.key_of(3), num_trajectories)
    return picked(trajectories.states, trajectories.is_taken)


def while_the_other_washes(team):
    """A state in which robot 1 decides while robot 0 washes object 0."""
    layout = picked(layouts(team.num_robots), 0)
    state, hidden = start(team, layout, KEY)
    return step(team, state, hidden, np.asarray(1), KEY)[0]


def q_of(team, state):
    return MyopicPolicy(team).q_values(state)


def chosen_by(team, states):
    return MyopicPolicy(team).decide(states, KEY).action


@pytest.mark.parametrize("num_robots", [1, 2, 3])
@pytest.mark.parametrize("price", [0.0, -0.2])
def test_what_is_chosen_is_possible(num_robots, price):
    team = team_of(num_robots, reward_per_s=price)
    states = states_of(team)
    chosen = chosen_by(team, states)
    assert np.take_along_axis(possible_actions(states), chosen[:, None], axis=-1).all()


def test_one_robot_looks_ahead_as_it_does_without_a_team():
    team = team_of(1)
    states = states_of(team)
    known = one_step_q(WORLD, states)
    np.testing.assert_allclose(q_of(team, states)[:, :-1], known - known[:, [FINISH]], atol=1e-4)


def test_at_no_price_it_waits_for_a_label_and_at_a_high_one_it_leaves():
    free, dear = (q_of(team, while_the_other_washes(team)) for team in (team_of(2), team_of(2, reward_per_s=-5.0)))
    assert free[WAIT] >= free[FINISH]
    assert np.argmax(dear) == FINISH


def test_who_has_no_decision_left_tries_nothing_more():
    team = team_of(2)
    state = while_the_other_washes(team)
    spent = replace(state, robots=replace(state.robots, decisions_to_go=np.array([0, 3], dtype=np.int32)))
    before, after = (q_of(team, each) for each in (state, spent))
    assert before[FINISH] > 0.0
    assert after[FINISH] == 0.0


def test_a_slow_robot_leaves_to_a_fast_one_what_that_reaches():
    state = while_the_other_washes(team_of(2))
    only = np.where(np.arange(NUM_OBJECTS) == 3, np.float32(3.0), np.float32(-9.0))
    state = replace(state, log_odds=only)
    even, slow = (replace(WORLD, speed=speed, reward_per_s=-0.1) for speed in ((1.0, 1.0), (1.0, 0.02)))
    assert int(chosen_by(even, state)) == 1 + 3
    assert int(chosen_by(slow, state)) in (FINISH, WAIT)
