"""A grasp model as a table inside policies: the same probabilities, compiled, batched, carried by what was learned."""

from dataclasses import replace

import numpy as np
import pytest
from sklearn.base import clone
from tried import beta_attempts

from halfseen.errors import ArgumentError
from halfseen.learning import CensoredQLearner
from halfseen.tables import BetaGrasp, LinearTablePolicy, SVMGrasp, attempts
from halfseen.tables.features import NUM_FEATURES, table_features
from halfseen.tables.grasp_table import GraspTable, tabulate
from halfseen.world import Scene, TableWorld, UniformPolicy, WorldConfig, random
from halfseen.world.policy import GraspModel
from halfseen.world.rollout import play
from halfseen.world.state import attempt_counts, occlusion, pad_scenes
from picked import picked

HORIZON = 10


@pytest.fixture(scope="module")
def scene():
    hides = np.zeros((4, 4))
    hides[1, 0], hides[2, 1], hides[3, 2] = 0.7, 0.45, 0.33
    return Scene(hides)


@pytest.fixture(scope="module")
def states(scene):
    episodes = play(WorldConfig(), pad_scenes([scene]), UniformPolicy(), random.key_of(1), 40)
    trajectory, stage = np.nonzero(np.asarray(episodes.is_taken))
    return picked(episodes.states, (trajectory, stage))


@pytest.fixture(scope="module")
def logs(scene):
    return TableWorld().simulate(scene, UniformPolicy(), episodes=150, seed=0, cut_share=0.3)


@pytest.fixture(scope="module")
def beta():
    return BetaGrasp().fit(beta_attempts(200))


def test_a_table_says_what_the_model_says(beta, states):
    seen = (occlusion(states), *attempt_counts(states))
    occluded, successes, failures = (np.asarray(leaf).ravel().astype(float) for leaf in seen)
    asked = {"occlusion": np.clip(occluded, 0.0, 1.0), "successes": successes, "failures": failures}
    expected = beta.predict_proba(asked)[:, 1].reshape(len(states.lifts), -1)
    np.testing.assert_allclose(tabulate(beta, HORIZON).probability(states), expected, atol=1e-3)
    assert asked["failures"].max() >= 2
    assert asked["successes"].max() >= 2


def test_it_is_exact_at_its_occlusions_and_linear_between(states):
    table = GraspTable(np.random.default_rng(0).random((3, 5, 5)).astype(np.float32))
    for hidden, levels in ((0.0, [1, 0, 0]), (0.5, [0, 1, 0]), (1.0, [0, 0, 1]), (0.125, [0.75, 0.25, 0])):
        hides = np.zeros((4, 4), dtype=np.float32)
        hides[0, 1] = hidden
        state = replace(
            picked(states, 0),
            hides=hides,
            is_on_table=np.ones(4, dtype=bool),
            attempt_object=np.array([0, 0, 0, 1, *[-1] * 6]),
            attempt_succeeded=np.array([True, False, True, *[False] * 7]),
        )
        assert float(table.probability(state)[0]) == pytest.approx(
            levels @ np.asarray(table.probabilities)[:, 2, 1], abs=1e-6
        )


def test_more_attempts_than_the_table_holds_count_as_the_most(beta, states):
    missed = {"attempt_object": np.zeros(10, dtype=np.int32), "attempt_succeeded": np.zeros(10, dtype=bool)}
    for horizon in (3, 10):
        known = tabulate(beta, horizon)
        said = known.probability(replace(picked(states, 0), **missed))[0]
        assert float(said) == pytest.approx(float(known.probabilities[0, 0, horizon]))


def test_a_batch_of_states_is_each_of_them(beta, states):
    table = tabulate(beta, HORIZON)
    each = [table.probability(picked(states, k)) for k in range(len(states.lifts))]
    np.testing.assert_array_equal(table.probability(states), each)


def test_features_take_the_probability_in_place_of_laplaces_guess(states):
    class Laplace:
        def probability(self, state):
            successes, failures = attempt_counts(state)
            return (1.0 - occlusion(state)) * (1.0 + successes) / (1.0 + successes + failures)

    plain = table_features(states, None)
    np.testing.assert_allclose(table_features(states, Laplace()), plain, atol=1e-6)
    learned = tabulate(BetaGrasp().fit(beta_attempts(50)), HORIZON)
    assert np.abs(table_features(states, learned) - plain).max() > 0.1


def test_a_policy_decides_with_its_own_table(beta, states):
    coefficients = np.random.default_rng(3).normal(size=(HORIZON, 3, NUM_FEATURES + 1))
    table = tabulate(beta, HORIZON)
    policy = LinearTablePolicy(coefficients.astype(np.float32), table)
    q = policy.q_values(states)
    plain = replace(policy, grasp=None).q_values(states)
    is_possible = np.isfinite(q)
    assert np.abs(q[is_possible] - plain[is_possible]).max() > 0.1
    features = table_features(states, table)
    wash = policy.coefficients[states.steps_to_go - 1, 1]
    expected = wash[:, 0] + np.sum(features[:, 1] * wash[:, 1:], axis=-1)
    np.testing.assert_allclose(np.where(np.isfinite(q[:, 1]), q[:, 1], expected), expected, rtol=1e-3, atol=1e-3)


@pytest.mark.slow
def test_the_learner_fits_the_grasp_model_to_its_log_and_leaves_the_one_given_alone(logs):
    given = BetaGrasp()
    learner = CensoredQLearner.for_table(horizon=HORIZON, grasp=given, laws=None).fit(logs)
    expected = tabulate(BetaGrasp().fit(attempts(logs, HORIZON)), HORIZON)
    assert not hasattr(given, "strength_")
    assert learner.policy_.grasp is learner.model_.task.grasp
    np.testing.assert_array_equal(learner.model_.task.grasp.probabilities, expected.probabilities)
    assert isinstance(clone(learner).actions.grasp, BetaGrasp)


@pytest.mark.slow
def test_fitted_estimators_tables_and_models_of_ones_own_are_taken_as_they_are(logs, beta):
    table = tabulate(beta, HORIZON)
    fits = [CensoredQLearner.for_table(grasp=grasp, laws=None).fit(logs) for grasp in (beta, table)]
    np.testing.assert_array_equal(*(fit.q_functions_.coefficients for fit in fits))
    assert isinstance(table, GraspModel)
    plain = CensoredQLearner.for_table(laws=None).fit(logs)
    assert plain.model_.task.grasp is None
    assert plain.policy_.grasp is None
    assert np.abs(plain.q_functions_.coefficients - fits[0].q_functions_.coefficients).max() > 1e-3


@pytest.mark.slow
def test_an_svm_serves_as_well(logs):
    learner = CensoredQLearner.for_table(grasp=SVMGrasp(), laws=None).fit(logs)
    spread = np.asarray(learner.model_.task.grasp.probabilities)
    assert ((spread >= 0) & (spread <= 1)).all()
    assert spread[0, 0, 0] > spread[-1, 0, 0], "what is hidden is harder to grasp"


@pytest.mark.parametrize("grasp", ["beta", BetaGrasp, 0.5])
def test_what_is_no_grasp_model_is_refused(logs, grasp):
    with pytest.raises(ArgumentError, match="it is None, BetaGrasp"):
        CensoredQLearner.for_table(grasp=grasp, laws=None).fit(logs)


def test_tables_that_cannot_be_are_refused(beta):
    class Sure:
        def fit(self, frame):
            return self

        def predict_proba(self, frame):
            return np.full((len(frame["occlusion"]), 2), 1.5)

    with pytest.raises(ArgumentError, match="horizon is 0"):
        tabulate(beta, 0)
    with pytest.raises(ArgumentError, match=r"gives 1\.5 at occlusion 0"):
        tabulate(Sure(), 3)
