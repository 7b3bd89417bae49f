"""A grasp model as a table inside policies; and the SVM grasp model, folds by object, and scikit-learn's habits."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from sklearn.base import clone
from tried import beta_attempts, cut_some

from halfseen.errors import ArgumentError
from halfseen.learning import CensoredQLearner, CensoredSVC
from halfseen.tables import BetaGrasp, LinearTablePolicy, SVMGrasp, attempts
from halfseen.tables.features import NUM_FEATURES, table_features
from halfseen.tables.grasp_attempts import checked_attempts, splits_of
from halfseen.tables.grasp_models import linear_and_gaussian
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
    with pytest.raises(ArgumentError, match="give None, BetaGrasp"):
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


def bumpy_attempts(num_rows, seed):
    """Grasps succeed at middling occlusion alone: no Beta mean that rises or falls with it can say so."""
    rng = np.random.default_rng(seed)
    occluded = rng.random(num_rows)
    succeeded = rng.random(num_rows) < np.where(np.abs(occluded - 0.5) < 0.2, 0.9, 0.2)
    return pd.DataFrame({"occlusion": occluded, "successes": 0, "failures": 0, "succeeded": succeeded})


def log_loss(model, frame):
    chance = model.predict_proba(frame)[:, 1]
    return -np.mean(np.log(np.where(frame["succeeded"], chance, 1.0 - chance)))


def test_it_sees_what_a_beta_mean_cannot():
    learned, held_out = bumpy_attempts(600, 0), bumpy_attempts(2000, 1)
    assert log_loss(SVMGrasp().fit(learned), held_out) < log_loss(BetaGrasp().fit(learned), held_out) - 0.1


def test_where_the_beta_mean_is_right_it_comes_close():
    learned, held_out = beta_attempts(500, seed=0), beta_attempts(2000, seed=1)
    assert log_loss(SVMGrasp().fit(learned), held_out) < log_loss(BetaGrasp().fit(learned), held_out) + 0.01


def test_it_is_the_censored_svm_on_scaled_features_with_weights_by_kaplan_meier():
    frame = cut_some(beta_attempts(80))
    model = SVMGrasp(reg=0.01, num_landmarks=None, random_state=3).fit(frame)
    decided = checked_attempts(frame)
    features = np.column_stack(
        [decided.history.occlusion, np.log(1 + decided.history.successes), np.log(1 + decided.history.failures)]
    )
    centre = np.average(features, axis=0, weights=decided.weight)
    scale = np.sqrt(np.average((features - centre) ** 2, axis=0, weights=decided.weight))
    svc = CensoredSVC("logistic", kernel=linear_and_gaussian, reg=0.01, calibrate=False)
    svc.fit((features - centre) / scale, decided.succeeded, sample_weight=decided.weight)

    asked = {"occlusion": [0.1, 0.8, 0.8], "successes": [0, 2, 0], "failures": [0, 0, 3]}
    rows = np.column_stack([asked["occlusion"], np.log1p(asked["successes"]), np.log1p(asked["failures"])])
    f = svc.decision_function((rows - centre) / scale)
    expected = 1.0 / (1.0 + np.exp(-(model.svc_.sigmoid_.slope * f + model.svc_.sigmoid_.offset)))
    assert 1 / 100 < expected.min() < expected.max() < 1 - 1 / 100
    np.testing.assert_allclose(model.predict_proba(asked)[:, 1], expected, rtol=1e-5)


def test_the_attempts_of_an_object_are_never_split():
    decided = checked_attempts(beta_attempts(60))
    splits = splits_of(decided, 5, 0)
    assert len(splits) == 5
    for fitted, held in splits:
        assert not set(decided.group[fitted]) & set(decided.group[held])
        assert len(fitted) + len(held) == len(decided.group)
    alone = checked_attempts(beta_attempts(60).drop(columns="object"))
    _, held = splits_of(alone, 5, 0)[0]
    assert set(np.diff(np.sort(held))) - {4}, "without objects, attempts are dealt one by one"


def test_of_about_equal_losses_the_smoothest_is_taken():
    frame = beta_attempts(100)
    decided = checked_attempts(frame)
    model = SVMGrasp().fit(frame)
    features = np.column_stack([frame["occlusion"], np.log1p(frame["successes"]), np.log1p(frame["failures"])])
    scaled = (features - model.centre_) / model.scale_
    svc = CensoredSVC("logistic", kernel=linear_and_gaussian, num_landmarks=50, cv=splits_of(decided, 5, 0))
    losses = svc.fit(scaled, frame["succeeded"], sample_weight=decided.weight).cv_losses_[0]
    regs = svc.reg_ * 10.0 ** (np.argmin(losses) - np.arange(len(losses)))

    assert model.svc_.reg_ == pytest.approx(max(regs[losses <= 1.01 * losses.min()]))


def test_no_chance_is_surer_than_the_log_allows():
    learned = beta_attempts(30, num_tries=1)
    learned["succeeded"] = learned["occlusion"] < 0.5
    extreme = {"occlusion": [0.0, 1.0], "successes": [40, 0], "failures": [0, 40]}
    chances = SVMGrasp(reg=1e-7).fit(learned).predict_proba(extreme)
    assert chances.min() >= 1 / 32
    np.testing.assert_allclose(chances.sum(axis=1), 1.0)


@pytest.mark.parametrize("seed", range(5))
def test_every_fold_holds_both_outcomes_however_rare_one_is(seed):
    rng = np.random.default_rng(seed)
    frame = beta_attempts(40, seed=seed)
    decided = checked_attempts(frame.assign(succeeded=frame["object"].isin(rng.choice(40, 3, replace=False))))
    splits = splits_of(decided, 5, seed)
    assert len(splits) == 3
    for rows in (rows for split in splits for rows in split):
        assert set(decided.succeeded[rows]) == {False, True}


def test_the_kernel_is_as_stated():
    rng = np.random.default_rng(0)
    x, z = rng.normal(size=(4, 3)), rng.normal(size=(5, 3))
    expected = [[a @ b + np.exp(-np.sum((a - b) ** 2) / 3) for b in z] for a in x]
    np.testing.assert_allclose(linear_and_gaussian(x, z), expected, rtol=1e-12)


def test_constant_features_are_no_trouble():
    frame = beta_attempts(60, num_tries=1, occlusion=0.3)
    chance = SVMGrasp().fit(frame).predict_proba(frame)[:, 1]
    np.testing.assert_allclose(chance, frame["succeeded"].mean(), atol=0.03)


@pytest.mark.parametrize(
    ("frame", "message"),
    [
        (beta_attempts(20).assign(succeeded=True), "all 80 decided attempts succeeded; an SVM needs both"),
        (beta_attempts(20).assign(succeeded=False), "all 80 decided attempts failed; an SVM needs both"),
        (beta_attempts(20).assign(object=0), "failures were seen for at most one object"),
        (
            beta_attempts(20).assign(succeeded=lambda f: f["object"] == 3),
            "successes were seen for at most one object",
        ),
        (beta_attempts(20).assign(occlusion=-0.1), "row 0: occlusion is -0.1"),
    ],
)
def test_attempts_that_teach_nothing_are_refused_and_so_are_too_few_folds(frame, message):
    with pytest.raises(ArgumentError, match=message):
        SVMGrasp().fit(frame)
    with pytest.raises(ArgumentError, match="num_folds is 1"):
        SVMGrasp(num_folds=1).fit(beta_attempts(20))


def posed_attempts(num_rows, seed):
    """What lies is hard to hold, and nothing else tells anything."""
    rng = np.random.default_rng(seed)
    is_lying = rng.random(num_rows) < 0.5
    succeeded = rng.random(num_rows) < np.where(is_lying, 0.3, 0.9)
    frame = pd.DataFrame({"occlusion": rng.random(num_rows), "successes": 0, "failures": 0, "succeeded": succeeded})
    return frame.assign(is_lying=is_lying.astype(float), width_m=0.08)


def test_covariates_tell_it_what_occlusion_and_past_attempts_do_not():
    learned, held_out = posed_attempts(400, 0), posed_attempts(2000, 1)
    model = SVMGrasp(covariates=("is_lying", "width_m")).fit(learned)
    chance = model.predict_proba(held_out)[:, 1]
    assert chance[held_out["is_lying"] == 1.0].mean() == pytest.approx(0.3, abs=0.06)
    assert chance[held_out["is_lying"] == 0.0].mean() == pytest.approx(0.9, abs=0.06)
    assert log_loss(model, held_out) < log_loss(SVMGrasp().fit(learned), held_out) - 0.1


def test_cut_attempts_keep_their_covariates_apart_from_those_of_decided_ones():
    cut = cut_some(posed_attempts(400, 0))
    shuffled = cut.assign(is_lying=cut["is_lying"].where(cut["is_finished"], 1.0 - cut["is_lying"]))
    asked = posed_attempts(20, 2)
    models = (SVMGrasp(covariates=("is_lying",), reg=0.01).fit(frame) for frame in (cut, shuffled))
    np.testing.assert_array_equal(*(model.predict_proba(asked) for model in models))


def test_a_covariate_that_is_missing_is_named():
    with pytest.raises(ArgumentError, match="room_m"):
        SVMGrasp(covariates=("room_m",)).fit(posed_attempts(40, 0))
    model = SVMGrasp(covariates=("is_lying",)).fit(posed_attempts(40, 0))
    with pytest.raises(ArgumentError, match="is_lying"):
        model.predict_proba({"occlusion": [0.1], "successes": [0], "failures": [0]})
    frame = posed_attempts(40, 0)
    frame.loc[3, "width_m"] = np.nan
    with pytest.raises(ArgumentError, match="row 3: width_m is nan"):
        SVMGrasp(covariates=("width_m",)).fit(frame)
