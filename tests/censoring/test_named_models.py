"""What all models of the cuts have in common: names, habits, and covariates that they refuse."""

import doctest

import numpy as np
import pandas as pd
import pytest
from sklearn.base import clone

from halfseen.censoring import (
    CensoringModel,
    Cox,
    KaplanMeier,
    KernelKaplanMeier,
    censoring_weights,
    is_fitted,
    named_model,
    stage_weights,
    uses_covariates,
)
from halfseen.errors import ArgumentError
from refusals import refused_type

RNG = np.random.default_rng(0)
TIME, IS_FINISHED = RNG.integers(1, 20, 80).astype(float), RNG.random(80) < 0.5
Z = RNG.normal(size=(80, 2))
NAMED = pd.DataFrame(Z, columns=["clutter", "speed"])
NAMES = [("kaplan-meier", KaplanMeier), ("cox", Cox), ("kernel", KernelKaplanMeier)]


class Own:
    """A user's model that says nothing of covariates."""

    def fit(self, time, is_finished, covariates=None):
        self.num_trajectories_ = len(time)
        return self

    def survival(self, u, covariates=None):
        return np.full(len(u), 0.5)


@pytest.mark.parametrize(("name", "kind"), NAMES)
def test_names_unfitted_and_fitted_models_weigh_alike(name, kind):
    model = named_model(name)
    assert type(model) is kind
    assert isinstance(model, CensoringModel)
    assert not is_fitted(model)
    assert named_model(name) is not model
    assert uses_covariates(model) == (name != "kaplan-meier")
    covariates = NAMED if uses_covariates(model) else None
    fitted = kind().fit(TIME, IS_FINISHED, covariates)
    for each in (name, model, fitted):
        weights = censoring_weights(TIME, IS_FINISHED, each, covariates=covariates)
        np.testing.assert_allclose(weights, IS_FINISHED / fitted.survival(TIME, covariates), rtol=1e-12)
    assert not is_fitted(model)
    # Stages are weighed with the covariates of their trajectory.
    clock = np.stack([TIME / 2, np.where(IS_FINISHED, TIME, np.nan)], axis=1)
    by_stage = stage_weights(clock, TIME, IS_FINISHED, name, covariates=covariates)
    np.testing.assert_allclose(by_stage[:, 1], weights, rtol=1e-12)
    np.testing.assert_allclose(by_stage[:, 0], 1.0 / fitted.survival(TIME / 2, covariates), rtol=1e-12)
    assert doctest.DocTestFinder().find(kind)[0].examples


def test_a_users_own_model_is_taken_and_taken_not_to_need_covariates():
    assert isinstance(named_model(Own()), Own)
    assert not uses_covariates(Own())
    assert not is_fitted(Own())
    assert is_fitted(Own().fit([1.0], [True]))


def test_a_fitted_model_is_not_fitted_again():
    elsewhere = KaplanMeier().fit([1.0, 2.0, 3.0], [False, False, True])
    np.testing.assert_allclose(censoring_weights([3.0], [True], elsewhere), [3.0])


@pytest.mark.parametrize(
    ("model", "covariates", "message"),
    [
        ("weibull", None, "censoring is 'weibull'; give 'kaplan-meier', 'cox', 'kernel', or a"),
        ("KaplanMeier", None, "censoring is 'KaplanMeier'; give 'kaplan-meier', 'cox', 'kernel', or a"),
        ("kaplan-meier", Z, "KaplanMeier takes no covariates"),
        ("cox", None, "Cox needs covariates"),
        (object(), None, "censoring is <object object at .*>; give 'kaplan-meier', 'cox', 'kernel', or a"),
    ],
)
def test_a_name_that_is_none_and_covariates_that_are_not_used_or_lacking_are_refused(model, covariates, message):
    with refused_type(message):
        censoring_weights(TIME, IS_FINISHED, model, covariates=covariates)


MODELS = pytest.mark.parametrize("model", [KaplanMeier(), Cox(), KernelKaplanMeier(bandwidth=0.5)], ids=repr)


def covariates_of(model, rows=slice(None)):
    return Z[rows] if uses_covariates(model) else None


@MODELS
def test_order_of_trajectories_is_irrelevant_and_where_nothing_was_cut_survival_is_one(model):
    asked, order = covariates_of(model), np.random.default_rng(0).permutation(len(TIME))
    one, other = (
        named_model(model).fit(TIME[rows], IS_FINISHED[rows], covariates_of(model, rows)).survival(TIME, asked)
        for rows in (slice(None), order)
    )
    np.testing.assert_allclose(one, other, rtol=0, atol=1e-12)
    fitted = named_model(model).fit(TIME, np.ones(80, dtype=bool), asked)
    assert (fitted.num_trajectories_, fitted.num_cut_, fitted.last_time_) == (80, 0, TIME.max())
    np.testing.assert_array_equal(fitted.survival(TIME + 5.0, asked), 1.0)


@pytest.mark.parametrize(
    ("model", "parameters", "text"),
    [
        (KaplanMeier(), {}, "KaplanMeier()"),
        (Cox("breslow", ridge=0.5), {"ties": "breslow", "ridge": 0.5}, "Cox(ties='breslow', ridge=0.5)"),
        (
            KernelKaplanMeier(2.0, random_state=4),
            {"bandwidth": 2.0, "kernel": "gaussian", "num_folds": 5, "random_state": 4},
            "KernelKaplanMeier(bandwidth=2.0, random_state=4)",
        ),
    ],
)
def test_models_keep_scikit_learns_habits(model, parameters, text):
    model.fit(TIME, IS_FINISHED, covariates_of(model))
    copy = clone(model)
    assert (copy.get_params(), repr(copy)) == (parameters, text)
    assert not is_fitted(copy)
    with pytest.raises(ValueError, match=f"{type(model).__name__} has no parameter alpha; choose among "):
        model.set_params(alpha=1.0)


@MODELS
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 0.0, -1.0])
def test_a_time_that_is_no_end_of_a_trajectory_is_refused(model, value):
    with pytest.raises(ArgumentError, match=rf"time, row 1: {value} is not the end of a trajectory"):
        model.fit([1.0, value, *TIME[2:]], IS_FINISHED, covariates_of(model))


@MODELS
def test_a_question_is_of_a_fitted_model_and_of_a_time(model):
    with pytest.raises(ArgumentError, match="not fitted; call fit"):
        named_model(model).survival([1.0], covariates_of(model, slice(1)))
    with pytest.raises(ArgumentError, match="u, row 1: nan is not a time"):
        model.fit(TIME, IS_FINISHED, covariates_of(model)).survival([1.0, np.nan], covariates_of(model, slice(2)))


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (Cox().set_params(ties="exact"), "ties is 'exact'; give 'efron' or 'breslow'"),
        (Cox(ridge=-1.0), "ridge is -1.0; give a finite number ≥ 0"),
        (Cox(ridge=np.nan), "ridge is nan"),
        (
            Cox().set_params(ridge=np.eye(2)),
            r"^ridge is array\(\[\[1., 0.\], \[0., 1.\]\]\); give a finite number ≥ 0$",
        ),
        (KernelKaplanMeier().set_params(kernel="tricube"), "kernel is 'tricube'; give 'gaussian' or 'epanechnikov'"),
        (KernelKaplanMeier(num_folds=1), "num_folds is 1; cross-validation needs at least 2"),
        (KernelKaplanMeier().set_params(num_folds="5"), "num_folds is '5'; cross-validation needs at least 2"),
        (KernelKaplanMeier().set_params(random_state="x"), "random_state is 'x'; it is a seed"),
        *(
            (KernelKaplanMeier().set_params(bandwidth=width), r"bandwidth is .*; give a number of")
            for width in (0.0, -1.0, np.nan, "wide", True, None)
        ),
    ],
)
def test_parameters_that_do_not_exist_are_refused(model, message):
    with pytest.raises(ArgumentError, match=message):
        model.fit(TIME, IS_FINISHED, Z)


WITH_COVARIATES = pytest.mark.parametrize("model", [Cox(), KernelKaplanMeier(bandwidth=1.0)], ids=repr)


def missing(value, wrap=np.array):
    return wrap(np.where(np.arange(160).reshape(80, 2) == 5, value, Z))


@WITH_COVARIATES
@pytest.mark.parametrize(
    ("covariates", "message"),
    [
        (None, "needs covariates, one row for each trajectory; give them, or use KaplanMeier"),
        (Z[:3], "covariates has 3 rows for 80 trajectories"),
        (Z[:, 0], r"covariates has shape \(80,\); give one row per trajectory and one column per covariate"),
        (np.empty((80, 0)), "covariates has no columns"),
        ([["a"]] * 80, "covariates is not numeric"),
        (pd.DataFrame({"arm": list("ab") * 40}), "covariates, arm: not numeric.*encode its categories"),
        (pd.DataFrame(Z, columns=["x", "x"]), "covariates has two columns 'x'; rename one"),
        (np.column_stack([Z, np.full(80, 0.1)]), r"covariates, column 2: 0.1 in every row.*leave it out"),
        *(
            (missing(value), f"covariates, row 2, column 1: {value} is not a value")
            for value in (np.nan, np.inf, -np.inf)
        ),
        *(
            (Z * [1.0, unit], r"covariates, column 1: the largest is .*; give it in another unit")
            for unit in (1e99, 1e-99)
        ),
        (NAMED.where(NAMED["speed"] != Z[2, 1], np.nan), "covariates, row 2, clutter: "),
    ],
)
def test_covariates_that_no_model_can_be_fitted_to_are_refused(model, covariates, message):
    with pytest.raises(ArgumentError, match=message):
        model.fit(TIME, IS_FINISHED, covariates)


@WITH_COVARIATES
@pytest.mark.parametrize(
    ("covariates", "message"),
    [
        (None, "needs covariates"),
        (Z[:2], "covariates has 2 rows for 80 trajectories"),
        (Z[:, :1], "covariates has 1 columns, but the fit had 2"),
        (missing(np.nan), "covariates, row 2, column 1: "),
    ],
)
def test_questions_whose_covariates_do_not_match_are_refused(model, covariates, message):
    fitted = model.fit(TIME, IS_FINISHED, Z)
    with pytest.raises(ArgumentError, match=message):
        fitted.survival(TIME, covariates)
