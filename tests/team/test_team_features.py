"""What a linear Q of a team looks at: symmetric in objects and robots, and nothing at all where all is over."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from played_teams import NUM_OBJECTS, played, team_of

from halfseen.team.actions import WAIT, possible_actions, wait_of, worthwhile_actions
from halfseen.team.features import NUM_FEATURES, NUM_WASH, team_features
from halfseen.world.action_space import ActionSpace, Verb
from picked import picked

REACH = [[1, 1, 1, 0], [0, 1, 1, 1]]
SPACE = ActionSpace(NUM_OBJECTS)
FEATURES = jax.jit(jax.vmap(team_features))


@pytest.fixture(scope="module")
def states():
    paths = played(team_of(2), 40, seed=5, reach=REACH)
    at = np.nonzero(np.asarray(paths.is_taken))
    return picked(paths.states, at)


@pytest.fixture(scope="module")
def features(states):
    return np.asarray(FEATURES(states))


def test_one_row_for_each_action(features):
    assert features.shape[1:] == (2 + 2 * NUM_OBJECTS, NUM_FEATURES)
    assert np.isfinite(features).all()


def test_the_order_of_objects_is_irrelevant(states, features):
    order = np.array([2, 0, 3, 1])
    new = jnp.asarray(np.argsort(order), dtype=jnp.int32)
    table, robots, space = states.table, states.robots, states.workspace
    moved = replace(
        table,
        **{
            name: getattr(table, name)[:, order]
            for name in ("is_object", "is_on_table", "log_odds", "lifts", "grip", "seen")
        },
        hides=table.hides[:, order][:, :, order],
        attempt_object=jnp.where(table.attempt_object >= 0, new[table.attempt_object], table.attempt_object),
    )
    reached = replace(space, is_in_reach=space.is_in_reach[:, :, order], is_near=space.is_near[:, order][:, :, order])
    turned = replace(states, table=moved, workspace=reached, robots=replace(robots, target=new[robots.target]))
    rows = np.concatenate([[0], 1 + order, 1 + NUM_OBJECTS + order, [wait_of(NUM_OBJECTS)]])
    np.testing.assert_allclose(FEATURES(turned), features[:, rows], rtol=2e-5, atol=2e-5)


def test_the_names_of_robots_are_irrelevant(states, features):
    robots, space = states.robots, states.workspace
    other = picked(robots, np.s_[:, ::-1])
    turned = replace(
        states,
        robots=other,
        workspace=replace(space, is_in_reach=space.is_in_reach[:, ::-1]),
        decider=1 - states.decider,
    )
    np.testing.assert_allclose(FEATURES(turned), features, rtol=1e-5, atol=1e-6)


def test_a_wash_of_another_counts_as_one_of_ones_own(states, features):
    robots = states.robots
    other = 1 - np.asarray(states.decider)
    at = np.arange(len(other))
    washes = np.asarray(robots.is_busy)[at, other] & (np.asarray(robots.verb)[at, other] == Verb.WASH)
    target = np.asarray(robots.target)[at, other]
    assert washes.sum() > 20
    finish = features[washes][:, 0, :NUM_WASH]
    assert (finish[:, 0] == 1).all()
    # The target's own numbers, as they would stand in the row of the robot that decides: twice where both are there.
    own = features[washes, SPACE.encode(Verb.WASH, target[washes])][:, :NUM_WASH]
    np.testing.assert_allclose(own, 2.0 * finish, rtol=1e-5, atol=1e-6)


def test_finish_of_the_last_robot_looks_at_nothing(states, features):
    others = np.arange(2) != np.asarray(states.decider)[:, None]
    is_last = ~(others & ~np.asarray(states.robots.is_done)).any(axis=1)
    assert is_last.sum() > 10
    assert not features[is_last, 0].any()
    assert features[~is_last, 0].any(axis=1).all()


def test_it_waits_only_for_something_that_another_robot_is_in_the_way_of(states):
    allowed, possible = (
        np.asarray(jax.jit(jax.vmap(which))(states)) for which in (worthwhile_actions, possible_actions)
    )
    np.testing.assert_array_equal(allowed[:, :-1], possible[:, :-1])
    reach = np.asarray(states.workspace.is_in_reach)[np.arange(len(allowed)), np.asarray(states.decider)]
    wanted = reach & np.asarray(states.table.is_on_table) & (np.asarray(states.table.log_odds) > 0)
    waits_for = (wanted & ~possible[:, 1 : 1 + NUM_OBJECTS]).any(axis=1)
    np.testing.assert_array_equal(allowed[:, -1], possible[:, -1] & waits_for)
    assert 0 < allowed[:, -1].sum() < possible[:, -1].sum()
    assert WAIT == 3
