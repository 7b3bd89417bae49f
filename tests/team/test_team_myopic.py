"""One robot looks ahead as `one_step` does; of a team, each takes what is possible, pays for it, leaves the rest."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from halfseen.planners.belief import belief_of, expected_attempt_s, grip_posterior
from halfseen.planners.heuristics import GreedyPolicy
from halfseen.planners.one_step import one_step_q
from halfseen.team import ExploringTeam, MyopicTeam, TeamOfRules, dynamics, episodes
from halfseen.team.actions import possible_actions, wait_of
from halfseen.team.config import TeamConfig
from halfseen.team.state import TeamLayout, Workspace
from halfseen.world import Scene, WorldConfig
from halfseen.world.action_space import FINISH
from halfseen.world.state import pad_scenes
from picked import picked

NUM_OBJECTS = 5
WORLD = WorldConfig(horizon=6)
RULE = GreedyPolicy(WORLD, uses_history=True, counts_penalty=True)
KEY = jax.random.key(0)
WAIT = wait_of(NUM_OBJECTS)
START, STEP = jax.jit(dynamics.start), jax.jit(dynamics.step)


def team_of(num_robots, **others):
    return TeamConfig(WORLD, (1.0,) * num_robots, **others)


def layouts_of(num_robots):
    """Objects 0 and 4 are each in reach of all robots but one; 1 and 2 stand near one another."""
    reach = np.ones((1, num_robots, NUM_OBJECTS), dtype=bool)
    if num_robots > 1:
        reach[0, 0, 4] = reach[0, 1, 0] = False
    near = np.eye(NUM_OBJECTS, dtype=bool)
    near[1, 2] = near[2, 1] = True
    scene = Scene(np.triu(np.full((NUM_OBJECTS, NUM_OBJECTS), 0.25), 1))
    return TeamLayout(pad_scenes([scene]), Workspace(jnp.asarray(reach), jnp.asarray(near[None])))


def states_of(team, num_paths=40):
    """States that a team meets, half by chance; axis B."""
    behaviour = ExploringTeam(TeamOfRules(RULE))
    paths = episodes.play(team, layouts_of(team.num_robots), behaviour, jax.random.key(3), num_paths)
    return picked(paths.states, paths.is_taken)


def while_the_other_washes(team):
    """A state in which robot 1 decides while robot 0 washes object 0."""
    layout = picked(layouts_of(team.num_robots), 0)
    state, hidden = START(team, layout, KEY)
    return STEP(team, state, hidden, jnp.asarray(1), KEY)[0]


@jax.jit
def _q_of(team, state):
    return MyopicTeam(team).q_values(state)


def q_of(team, state):
    return np.asarray(_q_of(team, state))


@jax.jit
def chosen_by(team, states):
    return jax.vmap(lambda state: MyopicTeam(team).decide(state, KEY).action)(states)


@pytest.mark.parametrize("num_robots", [1, 2, 3])
@pytest.mark.parametrize("price", [0.0, -0.2])
def test_what_is_chosen_is_possible(num_robots, price):
    team = team_of(num_robots, reward_per_s=price)
    states = states_of(team)
    chosen = chosen_by(team, states)
    possible = np.asarray(jax.jit(jax.vmap(possible_actions))(states))
    assert np.take_along_axis(possible, np.asarray(chosen)[:, None], axis=-1).all()


def test_one_robot_looks_ahead_as_it_does_without_a_team():
    team = team_of(1)

    def both(state):
        known = one_step_q(WORLD, belief_of(WORLD, state.table))
        return known - known[FINISH], MyopicTeam(team).q_values(state)[:-1]

    known, found = jax.jit(jax.vmap(both))(states_of(team))
    np.testing.assert_allclose(found, known, atol=1e-4)


def test_a_price_is_paid_for_every_try_and_once_by_one_robot():
    # All surely dirty and surely grasped: whoever is alone pays the seconds of each object, now or later.
    price = -0.01
    free, dear = (team_of(1, reward_per_s=each) for each in (0.0, price))
    layout = picked(layouts_of(1), 0)
    state, _ = START(team_of(1), layout, KEY)
    state = replace(state, table=replace(state.table, log_odds=jnp.full(NUM_OBJECTS, 9.0), hides=state.table.hides * 0))
    paid = np.subtract(*(q_of(team, state)[1 : 1 + NUM_OBJECTS] for team in (dear, free)))
    attempt_s = expected_attempt_s(WORLD, jnp.zeros(NUM_OBJECTS), grip_posterior(WORLD, state.table))
    # What is missed now is tried once more.
    assert (paid <= price * float(jnp.sum(attempt_s)) + 1e-4).all()
    assert (paid >= 2 * price * float(jnp.sum(attempt_s))).all()


def test_at_no_price_it_waits_for_a_label_and_at_a_high_one_it_leaves():
    free, dear = (q_of(team, while_the_other_washes(team)) for team in (team_of(2), team_of(2, reward_per_s=-5.0)))
    assert free[WAIT] >= free[FINISH]
    assert np.argmax(dear) == FINISH


def test_what_another_washes_is_nobody_elses():
    team = team_of(2)
    state = while_the_other_washes(team)
    q = q_of(team, state)
    sure = replace(state, table=replace(state.table, log_odds=state.table.log_odds.at[0].set(9.0)))
    np.testing.assert_allclose(q_of(team, sure), q, atol=1e-5)


def test_who_has_no_decision_left_tries_nothing_more():
    team = team_of(2)
    state = while_the_other_washes(team)
    spent = replace(state, robots=replace(state.robots, decisions_to_go=jnp.array([0, 3], dtype=jnp.int32)))
    before, after = (q_of(team, each) for each in (state, spent))
    assert before[FINISH] > 0.0
    assert after[FINISH] == 0.0


def test_a_slow_robot_leaves_to_a_fast_one_what_that_reaches():
    state = while_the_other_washes(team_of(2))
    only = jnp.where(jnp.arange(NUM_OBJECTS) == 3, 3.0, -9.0)
    state = replace(state, table=replace(state.table, log_odds=only))
    even, slow = (TeamConfig(WORLD, speed, reward_per_s=-0.1) for speed in ((1.0, 1.0), (1.0, 0.02)))
    assert int(chosen_by(even, picked(state, None))[0]) == 1 + 3
    assert int(chosen_by(slow, picked(state, None))[0]) in (FINISH, WAIT)
