"""Futures of a team of one are those of one robot to the last bit, and what is chosen is what they say."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from halfseen.errors import ArgumentError
from halfseen.planners.futures import as_expected, future
from halfseen.planners.heuristics import GreedyPolicy
from halfseen.planners.rollout import sampled_values
from halfseen.team.actions import possible_actions
from halfseen.team.config import TeamConfig
from halfseen.team.dynamics import TEAM
from halfseen.team.planners.myopic import MyopicTeam
from halfseen.team.planners.reservation import ReservingTeam
from halfseen.team.planners.rollout import TeamRollout, future_worths
from halfseen.team.planners.unknown import sampled_hidden
from halfseen.team.state import TeamLayout, Workspace
from halfseen.world import Scene, WorldConfig
from halfseen.world.episodes import ONE_ROBOT
from halfseen.world.state import pad_scenes

HIDES = np.array([[0.0, 0.4, 0.1], [0.0, 0.0, 0.3], [0.2, 0.0, 0.0]])


def begin(num_robots, horizon=4, seed=0):
    world = WorldConfig(horizon=horizon)
    team = TeamConfig(world, (1.0,) * num_robots)
    layout = jax.tree.map(lambda leaf: leaf[0], pad_scenes([Scene(HIDES)]))
    space = Workspace(jnp.ones((num_robots, 3), dtype=bool), jnp.eye(3, dtype=bool))
    state, _ = TEAM.start(team, TeamLayout(layout, space), jax.random.key(seed))
    return team, state


@pytest.mark.parametrize("seed", range(3))
def test_futures_of_a_team_of_one_are_those_of_one_robot_to_the_last_bit(seed):
    team, state = begin(1, seed=seed)
    rule = GreedyPolicy(team.world, uses_history=True, counts_penalty=True)
    is_possible = possible_actions(state)
    every, key = jnp.arange(len(is_possible), dtype=jnp.int32), jax.random.key(seed)
    found = np.asarray(future_worths(team, ReservingTeam(rule), state, every, is_possible, key, 4))

    def of_one(key, action):
        hidden_key, world_key = jax.random.split(key)
        now = state.table, sampled_hidden(team, state, hidden_key).table
        told = future(ONE_ROBOT, team.world, now, action, rule, world_key)
        return as_expected(team.world, told.reward, state.table.is_on_table, told.state, told.hidden)

    alone = jax.vmap(lambda key: jax.vmap(partial(of_one, key))(every[:-1]))(jax.random.split(key, 4))
    np.testing.assert_array_equal(found[:, :-1], np.asarray(alone))
    assert np.isneginf(found[:, -1]).all()


def test_futures_of_a_team_of_one_are_worth_what_rollouts_of_one_robot_are():
    team, state = begin(1)
    is_possible = possible_actions(state)
    every = jnp.arange(len(is_possible), dtype=jnp.int32)
    found = future_worths(team, MyopicTeam(team.world), state, every, is_possible, jax.random.key(1), 4000)[:, :-1]
    known = np.asarray(sampled_values(team.world, state.table, jax.random.key(2), 1000), dtype=np.float64)
    found = np.asarray(found, dtype=np.float64)
    error = np.sqrt(found.var(axis=0) / len(found) + known.var(axis=0) / len(known))
    assert (np.abs(found.mean(axis=0) - known.mean(axis=0)) < 4 * error + 1e-4).all()


def test_what_is_drawn_of_being_dirty_is_integrated_out():
    team, state = begin(2)
    is_possible = possible_actions(state)
    every, key = jnp.arange(len(is_possible), dtype=jnp.int32), jax.random.key(1)
    base = MyopicTeam(team.world)

    def raw(key):
        hidden_key, world_key = jax.random.split(key)
        now = state, sampled_hidden(team, state, hidden_key)
        return future(TEAM, team, now, jnp.asarray(1, dtype=jnp.int32), base, world_key).reward

    plain = np.asarray(jax.vmap(raw)(jax.random.split(key, 4000)), dtype=np.float64)
    found = future_worths(team, base, state, every[1:2], is_possible[1:2], key, 4000)[:, 0]
    found = np.asarray(found, dtype=np.float64)
    assert abs((plain - found).mean()) < 4 * (plain - found).std() / np.sqrt(len(plain))
    assert found.std() < 0.8 * plain.std()


def test_the_best_of_futures_is_chosen_where_it_is_clear():
    team, state = begin(2)
    policy = TeamRollout(team, ReservingTeam(GreedyPolicy(team.world)), num_rollouts=64)
    is_possible = possible_actions(state)
    every = jnp.arange(len(is_possible), dtype=jnp.int32)
    worth = np.asarray(future_worths(team, policy.base, state, every, is_possible, jax.random.key(9), 2000)).mean(
        axis=0
    )
    chosen = int(jax.jit(policy.decide)(state, jax.random.key(3)).action)
    assert bool(is_possible[chosen])
    assert worth[chosen] > worth.max() - 0.3


@pytest.mark.parametrize("numbers", [{"num_rollouts": 1}, {"num_kept": 0}])
def test_what_cannot_be_is_refused(numbers):
    team, _ = begin(2)
    with pytest.raises(ArgumentError, match="it is at least"):
        TeamRollout(team, MyopicTeam(team.world), **numbers)
