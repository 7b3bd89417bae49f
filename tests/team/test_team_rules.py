"""Rules of a team: what is worth its time, what is left to others, and what one robot does alone."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from halfseen.planners.belief import expected_attempt_s, grip_posterior
from halfseen.planners.heuristics import GreedyPolicy
from halfseen.team import dynamics, episodes
from halfseen.team.actions import possible_actions, wait_of
from halfseen.team.config import TeamConfig
from halfseen.team.policy import UniformTeam
from halfseen.team.rules import OneAtATime, ReservingTeam, RoundRobin, TeamOfRules
from halfseen.team.state import TeamLayout, Workspace
from halfseen.world import Scene, WorldConfig
from halfseen.world import episodes as one_robot
from halfseen.world.action_space import Verb
from halfseen.world.state import occlusion, pad_scenes
from picked import picked

NUM_OBJECTS = 4
HIDES = np.triu(np.full((NUM_OBJECTS, NUM_OBJECTS), 0.2), 1)
REACH = np.array([[True, True, True, False], [False, True, True, True]])
RULE = GreedyPolicy(WorldConfig(horizon=5), uses_history=True, counts_penalty=True)
KEY = jax.random.key(3)
WAIT = wait_of(NUM_OBJECTS)


def layouts_of(reach):
    near = jnp.eye(NUM_OBJECTS, dtype=bool)[None]
    return TeamLayout(pad_scenes([Scene(HIDES)]), Workspace(jnp.asarray(reach)[None], near))


def config_of(price=0.0, num_robots=2):
    return TeamConfig(RULE.config, (1.0,) * num_robots, reward_per_s=price)


def states_of(config, num_paths=60):
    """States that two robots meet by chance; axis B."""
    paths = episodes.play(config, layouts_of(REACH), UniformTeam(), KEY, num_paths)
    return picked(paths.states, paths.is_taken)


@jax.jit
def decide_each(policy, states):
    return jax.vmap(lambda state: policy.decide(state, KEY).action)(states)


def chosen(policy, states):
    return np.asarray(decide_each(policy, states))


def gone(robots):
    """Who is done for good, or goes home."""
    return robots.is_done | (robots.is_busy & (robots.verb == Verb.FINISH))


def attempt_s_of(state):
    return expected_attempt_s(RULE.config, occlusion(state.table), grip_posterior(RULE.config, state.table))


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


@pytest.mark.parametrize("price_per_s", [0.0, 0.3])
def test_a_team_with_reservation_washes_what_is_worth_its_time(price_per_s):
    config = config_of(-price_per_s)
    states = states_of(config)
    worth, attempt_s, is_possible = jax.jit(
        jax.vmap(lambda state: (RULE.worth(state.table), attempt_s_of(state), possible_actions(state)))
    )(states)
    columns = (states.decider, gone(states.robots), states.table.is_on_table, worth, attempt_s, is_possible)
    naive = [naive_choice(price_per_s, *row) for row in zip(*map(np.asarray, columns), strict=True)]
    assert {0, WAIT} < set(naive)
    np.testing.assert_array_equal(chosen(ReservingTeam(config, RULE), states), naive)


def test_without_a_price_of_time_it_is_the_team_of_rules():
    states = states_of(config_of())
    np.testing.assert_array_equal(chosen(ReservingTeam(config_of(), RULE), states), chosen(TeamOfRules(RULE), states))


@pytest.mark.parametrize("policy", [ReservingTeam(config_of(num_robots=1), RULE), RoundRobin(RULE), OneAtATime(RULE)])
def test_one_robot_does_as_its_rule(policy):
    config, layouts = config_of(num_robots=1), layouts_of(np.ones((1, NUM_OBJECTS), dtype=bool))
    alone = one_robot.play(config.world, layouts.table, RULE, KEY, 60)
    team = episodes.play(config, layouts, policy, KEY, 60)
    np.testing.assert_array_equal(alone.action, team.action)


def test_what_is_dealt_to_another_is_left_alone_until_that_one_goes():
    # Everyone reaches everything: the even numbers fall to robot 0, the odd ones to robot 1.
    config, layouts = config_of(), layouts_of(np.ones((2, NUM_OBJECTS), dtype=bool))
    paths = episodes.play(config, layouts, RoundRobin(RULE), KEY, 60)
    is_wash = np.asarray(paths.is_taken & (paths.action >= 1) & (paths.action <= NUM_OBJECTS))
    decider, robots = np.asarray(paths.states.decider), paths.states.robots
    other_goes_on = ~np.take_along_axis(np.asarray(gone(robots)), np.expand_dims(1 - decider, -1), axis=-1).squeeze(-1)
    is_dealt: np.ndarray = np.equal(np.asarray(paths.action - 1) % 2, decider)
    assert is_dealt[is_wash & other_goes_on].all()
    assert not is_dealt[is_wash & ~other_goes_on].all()


def test_one_at_a_time_never_has_two_at_work():
    paths = episodes.play(config_of(), layouts_of(REACH), OneAtATime(RULE), KEY, 60)
    robots = paths.states.robots
    num_at_work = np.asarray(jnp.sum(robots.is_busy & (robots.verb != 3), axis=-1))
    begins = np.asarray(paths.is_taken & (paths.action != WAIT))
    assert (num_at_work[begins] == 0).all()


def test_a_second_costs_a_slow_robot_more():
    layout = picked(layouts_of(REACH), 0)
    config = config_of(-0.6)
    state, _ = jax.jit(dynamics.start)(config, layout, jax.random.key(1))
    state = replace(state, table=replace(state.table, log_odds=jnp.full(NUM_OBJECTS, 2.0)))
    slow = replace(config, speed=(0.1, 1.0))
    assert int(chosen(ReservingTeam(config, RULE), picked(state, None))[0]) != 0
    assert int(chosen(ReservingTeam(slow, RULE), picked(state, None))[0]) == 0
