"""Rules of a team: what is possible is chosen, a team of one is the rule of one, and nobody waits for nothing."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from halfseen.planners.belief import belief_of
from halfseen.planners.heuristics import GreedyPolicy
from halfseen.planners.one_step import one_step_q
from halfseen.team import dynamics
from halfseen.team.actions import possible_actions, wait_of
from halfseen.team.config import TeamConfig
from halfseen.team.episodes import evaluate, play
from halfseen.team.planners.myopic import MyopicTeam
from halfseen.team.planners.reservation import ReservingTeam
from halfseen.team.planners.round_robin import RoundRobin, dealt
from halfseen.team.policy import ExploringTeam, TeamOfRules
from halfseen.team.state import TeamLayout, Workspace
from halfseen.world import Scene, WorldConfig
from halfseen.world.episodes import evaluate as evaluate_one
from halfseen.world.state import pad_scenes

NUM_OBJECTS = 5
SCENE = Scene(np.triu(np.full((NUM_OBJECTS, NUM_OBJECTS), 0.25), 1))
WORLD = WorldConfig(horizon=6)
RULE = GreedyPolicy(WORLD, uses_history=True, counts_penalty=True)


def layouts_of(num_robots):
    reach = np.ones((1, num_robots, NUM_OBJECTS), dtype=bool)
    if num_robots > 1:
        reach[0, 0, 4] = reach[0, 1, 0] = False
    near = np.eye(NUM_OBJECTS, dtype=bool)
    near[1, 2] = near[2, 1] = True
    return TeamLayout(pad_scenes([SCENE]), Workspace(jnp.asarray(reach), jnp.asarray(near[None])))


POLICIES = [
    ReservingTeam(RULE),
    ReservingTeam(RULE, -0.2),
    RoundRobin(RULE),
    MyopicTeam(WORLD),
    MyopicTeam(WORLD, -0.2),
]


@pytest.mark.parametrize("num_robots", [1, 2, 3])
@pytest.mark.parametrize("policy", POLICIES, ids=lambda policy: type(policy).__name__)
def test_what_is_chosen_is_possible(num_robots, policy):
    team = TeamConfig(WORLD, (1.0,) * num_robots)
    played = play(team, layouts_of(num_robots), ExploringTeam(policy, 0.3), jax.random.key(1), 40)
    possible = jax.vmap(jax.vmap(possible_actions))(played.states)
    chosen = jax.vmap(jax.vmap(lambda state: policy.decide(state, jax.random.key(0)).action))(played.states)
    taken = np.asarray(played.is_taken)
    assert np.take_along_axis(np.asarray(possible), np.asarray(chosen)[..., None], axis=-1)[..., 0][taken].all()


@pytest.mark.parametrize("policy", [ReservingTeam(RULE), RoundRobin(RULE)], ids=lambda policy: type(policy).__name__)
def test_a_team_of_one_is_the_rule_of_one_robot(policy):
    alone = evaluate_one(WORLD, layouts_of(1).table, RULE, jax.random.key(2), 50)
    team = evaluate(TeamConfig(WORLD), layouts_of(1), policy, jax.random.key(2), 50)
    np.testing.assert_array_equal(alone.reward, team.reward)


def test_the_look_ahead_of_a_team_of_one_is_that_of_one_robot():
    team, layouts = TeamConfig(WORLD), layouts_of(1)
    played = play(team, layouts, ExploringTeam(TeamOfRules(RULE)), jax.random.key(3), 30)

    def both(state):
        known = one_step_q(WORLD, belief_of(WORLD, state.table))
        return known - known[0], MyopicTeam(WORLD).q_values(state)[:-1]

    known, found = (np.asarray(each) for each in jax.vmap(jax.vmap(both))(played.states))
    taken = np.asarray(played.is_taken)
    np.testing.assert_allclose(found[taken], known[taken], atol=1e-4)


def test_at_no_price_of_seconds_waiting_for_a_label_is_worth_as_much_as_any_doubt():
    team = TeamConfig(WORLD, (1.0, 1.0))
    layout = jax.tree.map(lambda leaf: leaf[0], layouts_of(2))
    state, hidden = dynamics.start(team, layout, jax.random.key(0))
    state, hidden, _ = dynamics.step(team, state, hidden, jnp.asarray(1), jax.random.key(1))
    free, dear = (np.asarray(MyopicTeam(WORLD, price).q_values(state)) for price in (0.0, -5.0))
    wait = wait_of(NUM_OBJECTS)
    assert free[wait] >= free[0]
    # At five points a second nothing is worth waiting for.
    assert np.argmax(dear) == 0


def test_who_waits_for_nothing_leaves():
    team = TeamConfig(WORLD, (1.0, 1.0))
    layout = jax.tree.map(lambda leaf: leaf[0], layouts_of(2))
    state, hidden = dynamics.start(team, layout, jax.random.key(0))
    state, hidden, _ = dynamics.step(team, state, hidden, jnp.asarray(1), jax.random.key(1))
    assert int(state.decider) == 1
    sure = replace(state, table=replace(state.table, log_odds=jnp.full(NUM_OBJECTS, -6.0)))
    assert int(ReservingTeam(RULE).decide(sure, jax.random.key(0)).action) == 0
    doubt = replace(state, table=replace(state.table, log_odds=jnp.full(NUM_OBJECTS, -0.3)))
    assert int(ReservingTeam(RULE).decide(doubt, jax.random.key(0)).action) == wait_of(NUM_OBJECTS)


def test_each_object_is_dealt_to_one_robot_that_reaches_it():
    team = TeamConfig(WORLD, (1.0, 1.0, 1.0))
    layout = jax.tree.map(lambda leaf: leaf[0], layouts_of(3))
    state, _ = dynamics.start(team, layout, jax.random.key(0))
    shares = np.stack([np.asarray(dealt(replace(state, decider=jnp.asarray(r)))) for r in range(3)])
    np.testing.assert_array_equal(shares.sum(axis=0), 1)
    assert not (shares & ~np.asarray(layout.workspace.is_in_reach)).any()
    assert (shares.sum(axis=1) >= 1).all()
