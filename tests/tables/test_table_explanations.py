from dataclasses import replace

import numpy as np
import pytest

from halfseen.errors import ArgumentError
from halfseen.learning import CensoredQLearner
from halfseen.tables.explain import LearnedExplainer
from halfseen.world import ExploringPolicy, Scene, TableWorld, UniformPolicy, WorldConfig, random
from halfseen.world.state import pad_scenes
from halfseen.world.transition import start
from picked import picked

pytestmark = pytest.mark.slow

HORIZON = 4
CONFIG = WorldConfig(horizon=HORIZON)
SCENE = Scene(np.array([[0.0, 0.6, 0.0], [0.1, 0.0, 0.0], [0.0, 0.0, 0.0]]))


def logs_of(num_trajectories):
    return TableWorld(CONFIG).simulate(SCENE, ExploringPolicy(UniformPolicy()), num_trajectories, seed=0, cut_share=0.3)


@pytest.fixture(scope="module")
def logs():
    return logs_of(60)


@pytest.fixture(scope="module")
def learner(logs):
    return CensoredQLearner.for_table(HORIZON, laws=None).fit(logs)


@pytest.fixture(scope="module")
def explainer(learner, logs):
    return LearnedExplainer.of(learner, logs, num_replicates=20)


@pytest.fixture(scope="module")
def state():
    layout = picked(pad_scenes([SCENE]), 0)
    return start(CONFIG, layout, random.key_of(0))[0]


def test_what_was_learned_is_what_is_explained(learner, explainer, state):
    found = explainer.explain(state)
    np.testing.assert_allclose(found.values, learner.policy_.q_values(state), rtol=1e-5)
    assert found.best == int(learner.policy_.decide(state, random.key_of(0)).action)
    assert found.probability_best.sum() == pytest.approx(1.0, abs=0.1)


@pytest.mark.slow
def test_the_more_trajectories_the_less_doubt(explainer, state):
    many = logs_of(480)
    surer = LearnedExplainer.of(
        CensoredQLearner.for_table(HORIZON, laws=None).fit(many), many, num_replicates=20
    ).explain(state)
    found = explainer.explain(state)
    assert np.median(surer.high - surer.low) < 0.7 * np.median(found.high - found.low)


def test_an_error_that_lasts_makes_everything_less_sure(explainer, state):
    kind, harsh = (replace(explainer, lasting_error=error).explain(state) for error in (0.0, 50.0))
    assert (harsh.high - harsh.low > 3.0 * (kind.high - kind.low)).all()
    assert harsh.probability_best.max() < kind.probability_best.max() or kind.probability_best.max() < 0.5
    np.testing.assert_array_equal(harsh.values, kind.values)


def test_intervals_are_about_q_and_not_about_its_lower_bound(learner, explainer, state):
    q = np.asarray(replace(learner.policy_, margin=None).q_values(state))
    found = explainer.explain(state)
    assert learner.policy_.margin is not None
    assert ((found.low < q) & (q < found.high)).all()
    assert (found.values <= q).all()


def test_a_verb_that_was_never_seen_completed_is_impossible(explainer, state):
    is_seen = np.ones((HORIZON, 3), dtype=bool)
    is_seen[:, 2] = False
    policies = (replace(policy, is_seen=is_seen) for policy in (explainer.policy, explainer.replicates))
    found = replace(explainer, **dict(zip(("policy", "replicates"), policies, strict=True))).explain(state)
    assert np.isfinite(found.values[:4]).all()
    assert (found.values[4:] == -np.inf).all()
    assert (found.probability_best[4:] == 0.0).all()


def test_objects_that_nothing_tells_apart_are_equally_good(explainer, state):
    alike = replace(state, hides=np.zeros((3, 3), dtype=np.float32), log_odds=np.float32([2.0, 2.0, 0.0]))
    found = explainer.explain(alike)

    assert found.probability_best[1] == found.probability_best[2]
    assert found.values[4] == found.values[5] != found.values[6]


def test_new_numbers_for_the_objects_only_permute_the_explanation(explainer, state):
    order = np.array([2, 0, 1])
    other = replace(state, hides=state.hides[np.ix_(order, order)], log_odds=state.log_odds[order])
    found, moved = explainer.explain(state), explainer.explain(other)

    actions = np.concatenate([[0], 1 + order, 4 + order])
    np.testing.assert_allclose(moved.values, found.values[actions], rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(moved.probability_best, found.probability_best[actions], atol=1e-9)


def test_what_is_off_the_table_is_impossible(explainer, state):
    found = explainer.explain(replace(state, is_on_table=np.array([True, False, True])))

    np.testing.assert_array_equal(np.isfinite(found.values), [True, True, False, True, True, False, True])


def test_the_seed_of_the_draws_is_all_that_chance_has(learner, logs, state):
    found = [
        LearnedExplainer.of(learner, logs, num_replicates=20, random_state=seed).explain(state) for seed in (0, 0, 1)
    ]

    np.testing.assert_array_equal(found[0].low, found[1].low)
    assert not np.array_equal(found[0].low, found[2].low)


def test_what_cannot_be_explained_is_refused(learner, logs, explainer, state):
    with pytest.raises(ArgumentError, match="the log has 12 trajectories, but the learner was fitted to 60"):
        LearnedExplainer.of(learner, logs_of(12))
    with pytest.raises(ArgumentError, match="fit it to a log of tables"):
        LearnedExplainer.of(CensoredQLearner.for_table(HORIZON, laws=None), logs)
    with pytest.raises(ArgumentError, match="num_replicates is 1"):
        LearnedExplainer.of(learner, logs, num_replicates=1)
    with pytest.raises(ArgumentError, match="the trajectory is over"):
        explainer.explain(replace(state, steps_to_go=np.asarray(0)))
