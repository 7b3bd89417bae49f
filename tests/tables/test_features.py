"""Features of tables and of teams: what shows alone, whatever the order, the padding and the number of objects."""

from dataclasses import replace

import numpy as np
import pytest

from fitted_laws import FITTED
from halfseen.learning import CensoredQLearner
from halfseen.planners import GreedyPolicy
from halfseen.policies.history import present_state
from halfseen.tables import BetaGrasp, TableTask
from halfseen.tables.explain import LearnedExplainer
from halfseen.tables.features import table_columns, table_features, table_q
from halfseen.tables.grasp.grasp_table import GraspTable
from halfseen.tables.present import first_state
from halfseen.tables.team_features import NUM_FEATURES, NUM_WASH, team_features
from halfseen.world import ExploringPolicy, Scene, TableWorld, UniformPolicy, random
from halfseen.world.actions import WAIT, ActionSpace, Verb, possible_actions, wait_of, worthwhile_actions
from halfseen.world.rollout import evaluate
from halfseen.world.state import pad_scenes
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


HIDES = np.array([[0.0, 0.5, 0.0], [0.0, 0.0, 0.0], [0.0, 0.2, 0.0]])
STATE = first_state(Scene(HIDES), horizon=10, dirty_share=0.6).state
EASE, CLEARER = 4, -1


def of_verb(state, verb, place, grasp=None):
    return table_columns(state, grasp).of_verb[verb][place]


def test_what_shows_of_a_grip_changes_what_is_within_reach():
    shown = replace(STATE, grip=np.float32([-2.0, 0.0, 1.0]))
    ratio = of_verb(shown, Verb.WASH, EASE) / of_verb(STATE, Verb.WASH, EASE)
    assert ratio[0] < 0.5 < ratio[1] == 1.0 < ratio[2] < 4 / 3


def test_a_grasp_model_counts_what_shows_as_log_odds():
    model = GraspTable(np.full((33, 3, 3), 0.8, dtype=np.float32))
    shown = replace(STATE, grip=np.float32([-2.0, 0.0, 1.0]))
    expected = 1.0 / (1.0 + np.exp(-(np.log(4.0) + np.array([-2.0, 0.0, 1.0]))))
    np.testing.assert_allclose(model.probability(shown), expected, rtol=1e-5)
    assert np.array_equal(model.probability(shown)[1], model.probability(STATE)[1])
    assert np.array_equal(of_verb(shown, Verb.WASH, EASE, model), model.probability(shown))


def test_where_all_was_seen_nothing_is_gained_by_a_look():
    seen = replace(STATE, seen=np.float32([0.3, 1.0, 0.2]))
    clearer = of_verb(seen, Verb.LIFT, CLEARER)
    assert clearer[1] == 0.0
    assert clearer[2] > 0.01
    laid_bare = of_verb(seen, Verb.LIFT, 0)
    assert laid_bare[1] < of_verb(STATE, Verb.LIFT, 0)[1]
    # One more look from where the last was taken shows nothing new: what there is to win is won as it stands.
    columns = table_columns(seen)
    is_dirty, ease = columns.table[0], columns.of_verb[Verb.WASH][EASE]
    np.testing.assert_allclose(columns.table[-1], ease * np.maximum(is_dirty - 0.5, 0.0), rtol=1e-6)


def test_q_is_the_same_with_and_without_the_features_put_together():
    state = replace(STATE, grip=np.float32([-2.0, 0.0, 1.0]), seen=np.float32([0.3, 1.0, 0.6]))
    coefficients = np.random.default_rng(0).normal(size=(3, 23)).astype(np.float32)
    features = table_features(state)
    verb = np.repeat([0, 1, 2], [1, 3, 3])
    expected = coefficients[verb, 0] + np.sum(features * coefficients[verb, 1:], axis=1)
    np.testing.assert_allclose(table_q(coefficients, state), expected, rtol=1e-4)


def test_the_present_takes_grips_from_the_cloud_and_what_was_seen_from_the_log():
    scene = Scene(HIDES, grip=np.array([0.5, -1.0, 0.0]))
    logs = TableWorld(FITTED).simulate(scene, UniformPolicy(), episodes=40, seed=0, cut_share=0.5)
    for path in logs.path_ids[~logs.is_finished]:
        history = logs.select([path])
        last = history.objects[history.objects["stage"] == history.horizon]
        there = last[last["location"] == "TABLE"]
        if len(there) == 3 and history.stages["action"].iloc[-1] == "LIFT":
            now = present_state(scene, 10, history, dirty_share=0.6).state
            assert now.grip.tolist() == [0.5, -1.0, 0.0]
            np.testing.assert_array_equal(now.seen, there["seen"].to_numpy(dtype=np.float32))
            return
    raise AssertionError("no path was cut in a LIFT")


@pytest.mark.slow
@pytest.mark.parametrize("grasp", [None, BetaGrasp()], ids=["succession", "beta"])
def test_a_policy_is_learned_where_grips_show_and_errors_persist(grasp):
    rng = np.random.default_rng(0)
    scenes = [
        Scene(np.tril(rng.uniform(0.0, 0.5, (4, 4)), -1), name=f"table {k}", grip=rng.normal(0.0, 1.5, 4))
        for k in range(6)
    ]
    heuristic = GreedyPolicy(FITTED, uses_history=True, counts_penalty=True)
    logs = TableWorld(FITTED).simulate(scenes, ExploringPolicy(heuristic, 0.5), episodes=400, seed=0, cut_share=0.3)
    learner = CensoredQLearner(10, TableTask(grasp)).fit(logs)
    rules = learner.policy_, UniformPolicy(), ExploringPolicy(heuristic, 0.5)
    learned, by_lot, logging = (
        float(evaluate(FITTED, pad_scenes(scenes), rule, random.key_of(1), 2_000).reward.mean()) for rule in rules
    )
    assert learned > logging > by_lot
    told = LearnedExplainer.of(learner, logs, num_replicates=5).explain(first_state(scenes[0], 10, 0.6).state)
    assert np.isfinite(told.values[0])
