"""One robot looks ahead as `one_step` does; of a team, each takes what is possible, pays for it, leaves the rest."""

from dataclasses import replace

import numpy as np
import pytest

from halfseen.planners import GreedyPolicy, MyopicPolicy, TeamOfRules
from halfseen.planners.one_step import one_step_q
from halfseen.world import ExploringPolicy, WorldConfig, random
from halfseen.world.actions import FINISH, possible_actions, wait_of
from halfseen.world.rollout import play
from halfseen.world.transition import start, step
from picked import picked
from world.world_cases import layouts_of

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
