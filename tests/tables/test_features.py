"""Features of tables and of teams: what shows alone, whatever the order, the padding and the number of objects."""

from dataclasses import replace

import numpy as np
import pytest

from fitted_laws import FITTED
from halfseen.learning import CensoredQLearner
from halfseen.learning.rows import q_values
from halfseen.planners import GreedyPolicy
from halfseen.policies.history import present_state
from halfseen.tables import BetaGrasp, LinearTablePolicy, TableTask
from halfseen.tables.features import (
    NUM_FEATURES,
    NUM_TABLE_FEATURES,
    NUM_TEAM_FEATURES,
    NUM_WASH,
    WASH_DIRTY,
    WASH_EASE,
    table_columns,
    table_features,
    team_features,
)
from halfseen.tables.grasp_table import GraspTable
from halfseen.tables.present import first_state
from halfseen.world import ActionSpace, ExploringPolicy, Scene, TableWorld, UniformPolicy, Verb, WorldConfig, random
from halfseen.world.actions import WAIT, possible_actions, wait_of, worthwhile_actions
from halfseen.world.rollout import evaluate, play
from halfseen.world.state import occlusion, occlusion_by, pad_scenes
from picked import picked
from played_teams import NUM_OBJECTS, WashWhatIsDirty, played, team_of
from world.world_cases import permuted

REACH = [[1, 1, 1, 0], [0, 1, 1, 1]]
SPACE = ActionSpace(NUM_OBJECTS)
PER_OBJECT = {"is_object": False, "is_on_table": False, "grip": -3.0, "log_odds": 7.0, "seen": 0.4, "lifts": 3}
"""And what padding holds."""


@pytest.fixture(scope="module")
def states():
    trajectories = played(team_of(2), 40, seed=5, reach=REACH)
    return picked(trajectories.states, np.nonzero(trajectories.is_taken))


@pytest.fixture(scope="module")
def of_one():
    hides = np.zeros((NUM_OBJECTS, NUM_OBJECTS))
    hides[2, 0], hides[3, 1], hides[3, 2] = 0.7, 0.5, 0.4
    logger = ExploringPolicy(WashWhatIsDirty(), 0.5)
    trajectories = play(WorldConfig(), pad_scenes([Scene(hides)]), logger, random.key_of(0), 60)
    return picked(trajectories.states, np.nonzero(trajectories.is_taken))


@pytest.fixture(scope="module")
def features(states):
    return team_features(states)


@pytest.mark.parametrize(
    ("played_by", "features_of", "num_features"),
    [("of_one", table_features, NUM_FEATURES), ("states", team_features, NUM_TEAM_FEATURES)],
)
def test_each_action_has_a_row_whatever_the_order_of_objects(request, played_by, features_of, num_features):
    states, order = request.getfixturevalue(played_by), np.array([2, 0, 3, 1])
    features = features_of(states)
    waits = [] if states.robots is None else [wait_of(NUM_OBJECTS)]
    assert features.shape[1:] == (1 + 2 * NUM_OBJECTS + len(waits), num_features)
    assert np.isfinite(features).all()
    rows = np.concatenate([[0], 1 + order, 1 + NUM_OBJECTS + order, waits]).astype(int)
    np.testing.assert_allclose(features_of(permuted(states, order)), features[:, rows], rtol=2e-5, atol=2e-5)


def random_policy():
    coefficients = np.random.default_rng(3).normal(size=(10, 3, NUM_FEATURES + 1))
    return LinearTablePolicy(coefficients.astype(np.float32))


def by_verb(values, num_objects):
    """Values of WASH and LIFT by object, and of FINISH."""
    return values[:, 1 : 1 + num_objects], values[:, 1 + num_objects :], values[:, :1]


def test_q_does_not_see_padding(of_one):
    more, q = 7 - NUM_OBJECTS, random_policy().q_values
    grown = {
        name: np.pad(getattr(of_one, name), ((0, 0), (0, more)), constant_values=value)
        for name, value in PER_OBJECT.items()
    }
    hides = np.pad(of_one.hides, ((0, 0), (0, more), (0, more)), constant_values=0.9)
    before, after = by_verb(q(of_one), NUM_OBJECTS), by_verb(q(replace(of_one, hides=hides, **grown)), 7)
    for left, right in zip(before, after, strict=True):
        np.testing.assert_allclose(right[:, : left.shape[1]], left, rtol=1e-4, atol=1e-4)
        assert (right[:, left.shape[1] :] == -np.inf).all()
    assert (np.ptp(np.where(np.isfinite(before[0]), before[0], 0.0), axis=1) > 0.1).any()


def test_a_policy_takes_the_best_possible_action_by_what_was_regressed_on(of_one):
    policy = random_policy()
    q, possible = policy.q_values(of_one), possible_actions(of_one)
    by_features = q_values(policy.coefficients[of_one.steps_to_go - 1], table_features(of_one), SPACE.verbs)
    np.testing.assert_allclose(q[possible], by_features[possible], rtol=1e-4, atol=1e-4)
    action = policy.decide(of_one, random.keys_of(random.key_of(0), len(of_one.lifts))).action
    assert possible[np.arange(len(action)), action].all()
    assert (q[np.arange(len(action)), action] == np.where(possible, q, -np.inf).max(axis=1)).all()
    assert not possible.all()
    empty = possible_actions(replace(of_one, is_on_table=np.zeros_like(of_one.is_on_table)))
    assert empty[:, 0].all()
    assert not empty[:, 1:].any()


@pytest.mark.parametrize("hidden", [0.7, 1.0])
def test_what_is_laid_bare_is_the_occlusion_that_goes(of_one, hidden):
    hides = of_one.hides.copy()
    hides[:, 2, 0] = hidden
    states, others = replace(of_one, hides=hides), ~np.eye(NUM_OBJECTS, dtype=bool)
    for k in range(20):
        state = picked(states, k)
        there, features = state.is_on_table, table_features(state)
        is_dirty = 1.0 / (1.0 + np.exp(-state.log_odds.astype(float)))
        without = occlusion_by(state.hides, there & others)
        gone = (occlusion(state) - without) * (there[:, None] & there) * others
        washed = features[1 : 1 + NUM_OBJECTS]
        laid_bare = washed[:, WASH_EASE] * (gone @ np.maximum(is_dirty - 0.5, 0.0))
        np.testing.assert_allclose(washed[there, NUM_TABLE_FEATURES], laid_bare[there], atol=1e-5)
        np.testing.assert_allclose(washed[there, WASH_DIRTY], is_dirty[there], atol=1e-5)


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


def test_the_present_takes_grips_from_the_cloud_and_what_was_seen_from_the_log():
    scene = Scene(HIDES, grip=np.array([0.5, -1.0, 0.0]))
    logs = TableWorld(FITTED).simulate(scene, UniformPolicy(), episodes=40, seed=0, cut_share=0.5)
    for trajectory in logs.trajectory_ids[~logs.is_finished]:
        history = logs.select([trajectory])
        last = history.objects[history.objects["stage"] == history.horizon]
        there = last[last["location"] == "TABLE"]
        if len(there) == 3 and history.stages["action"].iloc[-1] == "LIFT":
            now = present_state(scene, 10, history, dirty_share=0.6).state
            assert now.grip.tolist() == [0.5, -1.0, 0.0]
            np.testing.assert_array_equal(now.seen, there["seen"].to_numpy(dtype=np.float32))
            return
    raise AssertionError("no trajectory was cut in a LIFT")


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
