"""What a linear Q of a team looks at: symmetric in objects and robots, and nothing at all where all is over."""

from dataclasses import replace

import numpy as np
import pytest

from halfseen.tables.team_features import NUM_FEATURES, NUM_WASH, team_features
from halfseen.world.actions import WAIT, ActionSpace, Verb, possible_actions, wait_of, worthwhile_actions
from picked import picked
from played_teams import NUM_OBJECTS, played, team_of

REACH = [[1, 1, 1, 0], [0, 1, 1, 1]]
SPACE = ActionSpace(NUM_OBJECTS)


@pytest.fixture(scope="module")
def states():
    paths = played(team_of(2), 40, seed=5, reach=REACH)
    at = np.nonzero(paths.is_taken)
    return picked(paths.states, at)


@pytest.fixture(scope="module")
def features(states):
    return team_features(states)


def test_one_row_for_each_action(features):
    assert features.shape[1:] == (2 + 2 * NUM_OBJECTS, NUM_FEATURES)
    assert np.isfinite(features).all()


def test_the_order_of_objects_is_irrelevant(states, features):
    order = np.array([2, 0, 3, 1])
    new = np.argsort(order)
    robots, space, tried = states.robots, states.workspace, states.attempt_object
    is_near = space.is_near[:, order][:, :, order]
    turned = replace(
        states,
        **{
            name: getattr(states, name)[:, order]
            for name in ("is_object", "is_on_table", "log_odds", "lifts", "grip", "seen")
        },
        hides=states.hides[:, order][:, :, order],
        attempt_object=np.where(tried >= 0, new[tried], tried),
        workspace=replace(space, is_in_reach=space.is_in_reach[:, :, order], is_near=is_near),
        robots=replace(robots, target=new[robots.target]),
    )
    rows = np.concatenate([[0], 1 + order, 1 + NUM_OBJECTS + order, [wait_of(NUM_OBJECTS)]])
    np.testing.assert_allclose(team_features(turned), features[:, rows], rtol=2e-5, atol=2e-5)


def test_the_names_of_robots_are_irrelevant(states, features):
    robots, space = states.robots, states.workspace
    other = picked(robots, np.s_[:, ::-1])
    turned = replace(
        states,
        robots=other,
        workspace=replace(space, is_in_reach=space.is_in_reach[:, ::-1]),
        decider=1 - states.decider,
    )
    np.testing.assert_allclose(team_features(turned), features, rtol=1e-5, atol=1e-6)


def test_a_wash_of_another_counts_as_one_of_ones_own(states, features):
    robots = states.robots
    other = 1 - states.decider
    at = np.arange(len(other))
    washes = robots.is_busy[at, other] & (robots.verb[at, other] == Verb.WASH)
    target = robots.target[at, other]
    assert washes.sum() > 20
    finish = features[washes][:, 0, :NUM_WASH]
    assert (finish[:, 0] == 1).all()
    # The target's own numbers, as they would stand in the row of the robot that decides: twice where both are there.
    own = features[washes, SPACE.encode(Verb.WASH, target[washes])][:, :NUM_WASH]
    np.testing.assert_allclose(own, 2.0 * finish, rtol=1e-5, atol=1e-6)


def test_finish_of_the_last_robot_looks_at_nothing(states, features):
    others = np.arange(2) != states.decider[:, None]
    is_last = ~(others & ~states.robots.is_done).any(axis=1)
    assert is_last.sum() > 10
    assert not features[is_last, 0].any()
    assert features[~is_last, 0].any(axis=1).all()


def test_it_waits_only_for_something_that_another_robot_is_in_the_way_of(states):
    allowed, possible = worthwhile_actions(states), possible_actions(states)
    np.testing.assert_array_equal(allowed[:, :-1], possible[:, :-1])
    reach = states.workspace.is_in_reach[np.arange(len(allowed)), states.decider]
    wanted = reach & states.is_on_table & (states.log_odds > 0)
    waits_for = (wanted & ~possible[:, 1 : 1 + NUM_OBJECTS]).any(axis=1)
    np.testing.assert_array_equal(allowed[:, -1], possible[:, -1] & waits_for)
    assert 0 < allowed[:, -1].sum() < possible[:, -1].sum()
    assert WAIT == 3
