"""The Beta grasp model against closed forms, brute force and simulated parameters; and what both grasp models share."""

import itertools

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from scipy.optimize import approx_fprime
from scipy.special import comb, expit
from scipy.stats import betabinom
from sklearn.base import clone
from sklearn.exceptions import NotFittedError
from tried import beta_attempts, cut_some

from halfseen.censoring import KaplanMeier, censoring_weights
from halfseen.errors import ArgumentError, HalfseenWarning, PositivityError
from halfseen.tables import BetaGrasp, SVMGrasp
from halfseen.tables.grasp_attempts import checked_attempts, checked_history, kinds
from halfseen.tables.grasp_models import CENTRE, SPREAD, fitted_thetas, negative_log_posteriors, predictive


def history(occlusion, successes, failures):
    return {"occlusion": occlusion, "successes": successes, "failures": failures}


def with_theta(intercept, slope, strength):
    model = BetaGrasp().fit(beta_attempts(40))
    model.intercept_, model.slope_, model.strength_ = intercept, slope, strength
    return model


def negative_log_posterior(theta, decided):
    """Value and gradient at one place, under the weights of the attempts."""
    value, gradient, _ = negative_log_posteriors(np.asarray(theta)[None], decided, decided.weight[None])
    return float(value[0]), gradient[0]


def test_even_prior_of_strength_two_is_laplaces_rule_and_first_attempts_have_the_prior_mean():
    chances = with_theta(0.0, 0.0, 2.0).predict_proba(history([0.3, 0.3, 0.9], [0, 1, 2], [0, 0, 3]))
    np.testing.assert_allclose(chances, [[1 / 2, 1 / 2], [1 / 3, 2 / 3], [4 / 7, 3 / 7]], rtol=1e-12)
    for strength in (0.1, 2.0, 50.0):
        chance = with_theta(1.0, -2.0, strength).predict_proba(history([0.0, 0.5, 1.0], [0] * 3, [0] * 3))[:, 1]
        np.testing.assert_allclose(chance, expit([1.0, 0.0, -1.0]), rtol=1e-12)


@pytest.mark.parametrize(("intercept", "slope", "strength"), [(0.7, -1.0, 3.0), (-1.0, 2.0, 0.4)])
def test_at_constant_occlusion_the_predictives_multiply_to_the_beta_binomial(intercept, slope, strength):
    theta, occluded, num_tries = np.array([intercept, slope, np.log(strength)]), 0.4, 5
    mean = expit(intercept + slope * occluded)
    for outcomes in itertools.product([False, True], repeat=num_tries):
        succeeded = np.array(outcomes)
        before = np.cumsum(succeeded) - succeeded
        chance = predictive(
            theta, checked_history(history([occluded] * num_tries, before, np.arange(num_tries) - before))
        )
        product = np.prod(np.where(succeeded, chance, 1.0 - chance))
        total = betabinom.pmf(succeeded.sum(), num_tries, strength * mean, strength * (1.0 - mean))
        assert product == pytest.approx(total / comb(num_tries, succeeded.sum()), rel=1e-10)


def test_the_objective_is_the_weighted_likelihood_and_the_prior_and_its_derivatives_are_right():
    decided = checked_attempts(cut_some(beta_attempts(60)))
    rng = np.random.default_rng(1)
    for theta in rng.normal(size=(10, 3)) * [2.0, 3.0, 1.5]:
        chance = predictive(theta, decided.history)
        likelihood = decided.weight @ np.log(np.where(decided.succeeded, chance, 1 - chance))
        penalty = np.sum(np.square((theta - CENTRE) / SPREAD)) / 2
        assert negative_log_posterior(theta, decided)[0] == pytest.approx(penalty - likelihood)
        numeric = approx_fprime(theta, lambda at: negative_log_posterior(at, decided)[0], 1e-6)
        np.testing.assert_allclose(negative_log_posterior(theta, decided)[1], numeric, rtol=1e-4, atol=1e-3)
        bends = approx_fprime(theta, lambda at: negative_log_posterior(at, decided)[1], 1e-6)
        hessian = negative_log_posteriors(theta[None], decided, decided.weight[None])[2][0]
        np.testing.assert_allclose(hessian, bends, rtol=1e-4, atol=1e-3)


def test_nothing_on_a_fine_grid_is_better():
    decided = checked_attempts(cut_some(beta_attempts(150)))
    model = BetaGrasp().fit(cut_some(beta_attempts(150)))
    best = np.array([model.intercept_, model.slope_, np.log(model.strength_)])
    least = negative_log_posterior(best, decided)[0]
    steps = np.linspace(-2.0, 2.0, 13)
    grid = [negative_log_posterior(best + shift, decided)[0] for shift in itertools.product(steps, repeat=3)]

    assert min(grid) == pytest.approx(least, abs=1e-9)
    assert sum(value < least + 1e-7 for value in grid) == 1


def test_without_history_the_mean_is_the_weighted_share_but_for_the_prior_and_strength_stays_at_two():
    rng = np.random.default_rng(0)
    succeeded = rng.random(300) < 0.7
    frame = history(np.zeros(300), np.zeros(300), np.zeros(300)) | {"succeeded": succeeded}
    model = BetaGrasp().fit(frame)

    # The score equation: Σ (y − m) = intercept / spread².
    assert np.sum(succeeded - expit(model.intercept_)) == pytest.approx(model.intercept_ / SPREAD[0] ** 2, abs=1e-4)
    assert model.strength_ == pytest.approx(2.0, rel=1e-5)
    assert model.slope_ == pytest.approx(0.0, abs=1e-5)


def test_simulated_parameters_come_back():
    model = BetaGrasp().fit(beta_attempts(20_000, intercept=1.5, slope=-2.5, strength=3.0))

    assert model.intercept_ == pytest.approx(1.5, abs=0.08)
    assert model.slope_ == pytest.approx(-2.5, abs=0.12)
    assert model.strength_ == pytest.approx(3.0, rel=0.06)


@pytest.mark.parametrize(("model", "num_objects"), [(BetaGrasp, 8000), (SVMGrasp, 1500)])
def test_cut_attempts_bias_nothing_if_weighted_and_do_if_dropped(model, num_objects):
    frame = beta_attempts(num_objects, num_tries=1)
    cut = cut_some(frame)
    weighted, dropped = (
        model(censoring=name).fit(cut).predict_proba(frame)[:, 1].mean() for name in ("kaplan-meier", "none")
    )
    assert weighted == pytest.approx(frame["succeeded"].mean(), abs=0.02)
    assert dropped > frame["succeeded"].mean() + 0.04


def test_weights_are_the_left_limits_of_kaplan_meier():
    # Of the four that are watched for 2 s, two are cut at 1 s, before: the others count twice.
    frame = pd.DataFrame(
        {
            "occlusion": [0.1, 0.3, 0.5, 0.7] * 8,
            "successes": 0,
            "failures": [0, 1, 0, 2] * 8,
            "succeeded": [True, False, None, None] * 8,
            "time_s": [2.0, 2.0, 1.0, 1.0] * 8,
            "is_finished": [True, True, False, False] * 8,
        }
    )
    decided = frame[frame["is_finished"]].drop(columns=["time_s", "is_finished"])
    twice = pd.concat([decided, decided]).assign(succeeded=lambda rows: rows["succeeded"].astype(bool))
    weighted, doubled = BetaGrasp().fit(frame), BetaGrasp().fit(twice)

    expected = censoring_weights(frame["time_s"], frame["is_finished"])
    np.testing.assert_array_equal(checked_attempts(frame).weight, expected[expected > 0])
    assert weighted.diagnostics_.largest_weight == 2.0
    assert weighted.intercept_ == pytest.approx(doubled.intercept_, abs=1e-6)
    assert weighted.strength_ == pytest.approx(doubled.strength_, rel=1e-6)


def test_a_fitted_model_of_the_cuts_is_used_as_it_is_and_cox_sees_the_history():
    frame = cut_some(beta_attempts(100))
    model = KaplanMeier().fit([1.0, 1.5, 9.0], [False, False, True])
    weights = checked_attempts(frame, model).weight
    np.testing.assert_allclose(weights, 1.0 / model.survival(frame.loc[frame["is_finished"], "time_s"]))

    by_cox = checked_attempts(frame, "cox").weight
    assert np.ptp(by_cox[frame.loc[frame["is_finished"], "time_s"] == 7.0]) > 1e-3


def test_many_weightings_are_fitted_as_one_by_one():
    decided = checked_attempts(cut_some(beta_attempts(200)))
    rng = np.random.default_rng(0)
    weight = np.concatenate([decided.weight * rng.integers(0, 2, (4, len(decided.weight))), decided.weight[None]])
    together = fitted_thetas(decided, weight)
    for theta, own in zip(together, weight, strict=True):
        np.testing.assert_allclose(fitted_thetas(decided, own[None])[0], theta, atol=1e-8)
        kept = decided.among(own > 0)
        np.testing.assert_allclose(fitted_thetas(kept, own[None, own > 0])[0], theta, atol=1e-8)
    assert np.ptp(together, axis=0).min() > 1e-3


def test_one_outcome_gives_a_finite_model():
    model = BetaGrasp().fit(beta_attempts(50).assign(succeeded=True, failures=0))
    assert np.isfinite([model.intercept_, model.slope_, model.strength_]).all()
    assert model.predict_proba(history([0.0], [0], [0]))[0, 1] > 0.95


def test_frames_of_all_kinds_give_the_same():
    frame = cut_some(beta_attempts(50))
    arrays = {name: frame[name].to_numpy(dtype=object if name == "succeeded" else None) for name in frame.columns}
    models = [BetaGrasp().fit(data) for data in (frame, arrays, pa.Table.from_pandas(frame))]
    assert len({model.intercept_ for model in models}) == 1


@pytest.mark.parametrize(
    "model", [BetaGrasp(truncate_at=3.0), SVMGrasp(kernel="rbf", gamma=0.5, reg=0.1, num_folds=3, random_state=4)]
)
def test_it_is_an_estimator_as_scikit_learn_knows_them_and_the_global_seed_changes_nothing(model):
    assert clone(model).get_params() == model.get_params()
    with pytest.raises(NotFittedError):
        model.predict_proba(history([0.1], [0], [0]))
    chances = []
    for seed in (0, 1):
        np.random.seed(seed)  # noqa: NPY002
        fitted = clone(model).fit(cut_some(beta_attempts(50)))
        chances.append(fitted.predict_proba(history(np.linspace(0, 1, 7), np.arange(7), np.zeros(7))))
    assert fitted.classes_.tolist() == [False, True]
    assert chances[0].shape == (7, 2)
    np.testing.assert_array_equal(*chances)
    np.testing.assert_allclose(chances[0].sum(axis=1), 1.0)
    if isinstance(model, SVMGrasp):
        assert (fitted.svc_.reg_, fitted.svc_.gamma_) == (0.1, 0.5)
    else:
        assert fitted.diagnostics_.largest_weight <= 3.0


GOOD = cut_some(beta_attempts(40))


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda f: f.drop(columns="failures"), "there is no column 'failures' among"),
        (lambda f: f.rename(columns={"occlusion": "occlusions"}), "rename 'occlusions'?"),
        (lambda f: f.drop(columns="succeeded"), "there is no column 'succeeded'"),
        (
            lambda f: f.assign(occlusion=f["occlusion"].where(f.index != 3, 1.2)),
            "row 3: occlusion is 1.2; give a hidden",
        ),
        (lambda f: f.assign(occlusion=f["occlusion"].where(f.index != 5)), "row 5: occlusion is nan; give a finite"),
        (lambda f: f.assign(successes=f["successes"].where(f.index != 2, -1)), "row 2: successes is -1; give a count"),
        (lambda f: f.assign(failures=f["failures"].where(f.index != 2, 0.5)), "row 2: failures is 0.5; give a count"),
        (lambda f: f.assign(occlusion="half"), "column 'occlusion' holds .*, not numbers"),
        (lambda f: f.assign(succeeded=2.0), "succeeded is 2.0; give True or False"),
        (lambda f: f.assign(succeeded=None), "succeeded is None; give True or False"),
        (lambda f: f.drop(columns="time_s"), "column is_finished needs time_s"),
        (lambda f: f.drop(columns="is_finished"), "column time_s needs is_finished"),
        (lambda f: f.assign(time_s=0.0), "row 0: time_s is 0.0; give the time for which"),
        (lambda f: f.assign(is_finished=False), "all 160 attempts were cut undecided"),
        (lambda f: f.iloc[:0], "has no rows"),
        (lambda f: pd.concat([f, f["occlusion"]], axis=1), "two columns 'occlusion'"),
    ],
)
def test_bad_attempts_are_refused_in_one_line(spoil, message):
    with pytest.raises(ArgumentError, match=message.replace("?", r"\?")) as refusal:
        BetaGrasp().fit(spoil(GOOD))
    assert "\n" not in str(refusal.value)


def test_bad_parameters_are_refused():
    with pytest.raises(ArgumentError, match="censoring is 'kaplan'"):
        BetaGrasp(censoring="kaplan").fit(GOOD)
    with pytest.raises(ArgumentError, match=r"truncate_at is 0\.5"):
        BetaGrasp(truncate_at=0.5).fit(GOOD)
    with pytest.raises(PositivityError, match="is not identified"):
        BetaGrasp(censoring=KaplanMeier().fit([1.0, 2.0], [False, False])).fit(GOOD)


def test_what_a_cut_attempt_says_of_its_outcome_is_not_read():
    cut = ~GOOD["is_finished"]
    lying = GOOD.assign(succeeded=GOOD["succeeded"].astype(object).where(~cut, "maybe").astype(str))
    lying["succeeded"] = [{"True": 1.0, "False": 0.0}.get(value, np.nan) for value in lying["succeeded"]]
    assert BetaGrasp().fit(lying).intercept_ == BetaGrasp().fit(GOOD).intercept_


def test_few_attempts_warn():
    with pytest.warns(HalfseenWarning, match="effective sample size of 8.0"):
        BetaGrasp().fit(beta_attempts(2))


def test_rows_of_a_kind_are_alike_in_all_columns():
    rng = np.random.default_rng(0)
    columns = rng.choice([0.0, 0.25, 1.0], 500), rng.integers(0, 3, 500).astype(float), rng.random(500) < 0.5
    first, kind = kinds(*columns)
    rows = list(zip(*(column.tolist() for column in columns), strict=True))
    assert [rows[k] for k in first[kind]] == rows
    assert len({rows[k] for k in first}) == len(first) == len(set(rows)) == 18
    assert [rows.index(rows[k]) for k in first] == first.tolist()
