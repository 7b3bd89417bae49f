"""Rules of thumb: of one robot, the best of all expected rewards; of a team, what is worth its time."""

from dataclasses import replace

import naive_planner
import numpy as np
import pytest
from naive_planner import CONFIG, Cup

from halfseen.arrays import at, record
from halfseen.errors import ArgumentError
from halfseen.planners import HEURISTICS, GreedyPolicy, OneAtATime, ReservingPolicy, RoundRobin, TeamOfRules
from halfseen.planners.belief import expected_attempt_s, grip_posterior
from halfseen.planners.heuristics import TrueGrasp
from halfseen.world import UniformPolicy, Verb, WorldConfig, actions, random
from halfseen.world.actions import FINISH, possible_actions, wait_of
from halfseen.world.rollout import play
from halfseen.world.state import occlusion
from picked import picked
from tables import state_of
from world.world_cases import layouts_of

OPEN = np.zeros((2, 2))
HISTORY = GreedyPolicy(CONFIG, uses_history=True)
ALL = [GreedyPolicy(CONFIG, *how) for how in HEURISTICS.values()]


def choice(policy, cups, hides=OPEN):
    return int(policy.decide(state_of(cups, hides), random.key_of(0)).action)


@pytest.mark.parametrize("policy", ALL)
def test_the_choice_is_the_best_of_all_expected_rewards(policy):
    rng, actions = np.random.default_rng(0), set()
    for least_dirty in np.repeat([0.3, 0.0], 15):
        cups = [
            Cup(p, tuple(zip(rng.random(k), rng.random(k) < 0.5, strict=True)), is_on_table)
            for p, k, is_on_table in zip(
                rng.uniform(least_dirty, least_dirty + 0.6, 4), [0, 1, 2, 3], rng.random(4) < 0.8, strict=True
            )
        ]
        hides = rng.uniform(0, 0.5, (4, 4)) * ~np.eye(4, dtype=bool)
        worth = [0.0, *(_worth(policy, cups, hides, i) for i in range(4))]
        actions.add(choice(policy, cups, hides))
        assert choice(policy, cups, hides) == int(np.argmax(worth))
    assert FINISH in actions
    assert len(actions) > 2


def _worth(policy, cups, hides, i):
    if not cups[i].is_on_table:
        return -np.inf
    cup = cups[i] if policy.uses_history else Cup(cups[i].is_dirty)
    grasped = naive_planner.chance(cup, naive_planner.occlusion(cups, hides, i))
    dirty = 10 if policy.counts_penalty else 5
    return grasped * (dirty * cup.is_dirty - 10 * (1 - cup.is_dirty)) - (1 - grasped)


@record
class Fixed:
    """A grasp model that says what it was given."""

    probabilities: np.ndarray

    def probability(self, state):
        return self.probabilities


@pytest.mark.parametrize("hidden", [0.0, 0.5])
def test_the_true_probability_is_that_of_plain_python(hidden):
    cups, hides = [Cup(0.9, ((0.2, False), (0.6, True))), Cup(0.9)], np.array([[0.0, hidden], [0.0, 0.0]])
    for uses_history in (True, False):
        known = TrueGrasp(CONFIG, uses_history).probability(state_of(cups, hides))
        expected = [
            naive_planner.chance(cup if uses_history else Cup(0.9), naive_planner.occlusion(cups, hides, i))
            for i, cup in enumerate(cups)
        ]
        np.testing.assert_allclose(known, expected, rtol=1e-5)


def test_another_grasp_model_replaces_the_true_probability():
    cups = [Cup(0.95), Cup(0.95)]
    for best in (0, 1):
        believed = Fixed(np.where(np.arange(2) == best, 0.9, 0.1))
        assert choice(GreedyPolicy(CONFIG, uses_history=True, grasp=believed), cups) == 1 + best
    hopeless = Fixed(np.full(2, 0.01))
    assert choice(GreedyPolicy(CONFIG, uses_history=True, grasp=hopeless), cups) == FINISH


def test_a_grasp_model_without_history_is_refused():
    with pytest.raises(ArgumentError, match="uses_history is False"):
        GreedyPolicy(CONFIG, grasp=Fixed(np.ones(2)))


NUM_OBJECTS = 4
HIDES = np.triu(np.full((NUM_OBJECTS, NUM_OBJECTS), 0.2), 1)
REACH = np.array([[True, True, True, False], [False, True, True, True]])
RULE = GreedyPolicy(WorldConfig(horizon=5), uses_history=True, counts_penalty=True)
KEY = random.key_of(3)
WAIT = wait_of(NUM_OBJECTS)


def config_of(price=0.0, speed=(1.0, 1.0)):
    return replace(RULE.config, speed=speed, reward_per_s=price)


def states_of(config, num_trajectories=60):
    """States that two robots meet by chance; axis B."""
    trajectories = play(config, layouts_of(HIDES, REACH), UniformPolicy(), KEY, num_trajectories)
    return picked(trajectories.states, trajectories.is_taken)


def chosen(policy, states):
    return policy.decide(states, KEY).action


def gone(robots):
    """Who is done for good, or goes home."""
    return robots.is_done | (robots.is_busy & (robots.verb == Verb.FINISH))


def attempt_s_of(state):
    return expected_attempt_s(RULE.config, occlusion(state), grip_posterior(RULE.config, state))


def naive_choice(price_per_s, me, is_gone, is_on_table, worth, attempt_s, is_possible):
    """By plain loops: what a robot that knows the price of time begins."""
    others = [r for r in range(2) if r != me and not is_gone[r]]
    best, best_at, is_hope = None, 0, False
    for i in range(NUM_OBJECTS):
        price = price_per_s * attempt_s[i]
        gain = worth[i] - price / (1 + len(others))
        if not REACH[me][i] or not is_on_table[i] or gain <= 0.0:
            continue
        is_hope = True
        gain -= price if any(REACH[r][i] for r in others) else 0.0
        if is_possible[1 + i] and (best is None or gain > best):
            best, best_at = gain, i
    if best is not None:
        return 1 + best_at
    return WAIT if is_hope and is_possible[WAIT] else 0


@pytest.mark.parametrize(("price_per_s", "speed"), [(0.0, (1.0, 1.0)), (0.3, (1.0, 1.0)), (0.6, (0.1, 1.0))])
def test_a_team_with_reservation_washes_what_is_worth_its_time(price_per_s, speed):
    config = config_of(-price_per_s, speed)
    states = states_of(config)
    attempt_s = attempt_s_of(states) / np.array(speed)[states.decider][:, None]
    worth, is_possible = RULE.worth(states), possible_actions(states)
    columns = (states.decider, gone(states.robots), states.is_on_table, worth, attempt_s, is_possible)
    naive = [naive_choice(price_per_s, *row) for row in zip(*columns, strict=True)]
    assert {0, WAIT} < set(naive)
    np.testing.assert_array_equal(chosen(ReservingPolicy(config, RULE), states), naive)


def test_without_a_price_of_time_it_is_the_team_of_rules():
    states = states_of(config_of())
    np.testing.assert_array_equal(chosen(ReservingPolicy(config_of(), RULE), states), chosen(TeamOfRules(RULE), states))


@pytest.mark.parametrize("policy", [ReservingPolicy(config_of(speed=(1.0,)), RULE), RoundRobin(RULE), OneAtATime(RULE)])
def test_one_robot_does_as_its_rule(policy):
    config, layouts = config_of(speed=(1.0,)), layouts_of(HIDES, np.ones((1, NUM_OBJECTS), dtype=bool))
    alone = play(config, replace(layouts, workspace=None), RULE, KEY, 60)
    team = play(config, layouts, policy, KEY, 60)
    np.testing.assert_array_equal(alone.action, team.action)


def test_what_is_dealt_to_another_is_left_alone_until_that_one_goes():
    # Everyone reaches everything: the even numbers fall to robot 0, the odd ones to robot 1.
    config, layouts = config_of(), layouts_of(HIDES, np.ones((2, NUM_OBJECTS), dtype=bool))
    trajectories = play(config, layouts, RoundRobin(RULE), KEY, 60)
    is_wash = trajectories.is_taken & (trajectories.action >= 1) & (trajectories.action <= NUM_OBJECTS)
    decider = trajectories.states.decider
    other_goes_on = ~at(gone(trajectories.states.robots), 1 - decider)
    is_dealt = (trajectories.action - 1) % 2 == decider
    assert is_dealt[is_wash & other_goes_on].all()
    assert not is_dealt[is_wash & ~other_goes_on].all()


def test_one_at_a_time_never_has_two_at_work():
    trajectories = play(config_of(), layouts_of(HIDES, REACH), OneAtATime(RULE), KEY, 60)
    robots = trajectories.states.robots
    num_at_work = np.sum(robots.is_busy & (robots.verb != actions.WAIT), axis=-1)
    begins = trajectories.is_taken & (trajectories.action != WAIT)
    assert (num_at_work[begins] == 0).all()
