import numpy as np
import pandas as pd
import pytest

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

RNG = np.random.default_rng(0)
TIME, IS_FINISHED = RNG.integers(1, 20, 80).astype(float), RNG.random(80) < 0.5
Z = RNG.normal(size=(80, 2))
NAMES = [("kaplan-meier", KaplanMeier), ("cox", Cox), ("kernel", KernelKaplanMeier)]


class Own:
    """A user's model that says nothing of covariates."""

    def fit(self, time, is_finished, covariates=None):
        self.num_paths_ = len(time)
        return self

    def survival(self, u, covariates=None):
        return np.full(len(u), 0.5)


@pytest.mark.parametrize(("name", "kind"), NAMES)
def test_a_name_gives_a_fresh_model(name, kind):
    model = named_model(name)
    assert type(model) is kind
    assert isinstance(model, CensoringModel)
    assert not is_fitted(model)
    assert named_model(name) is not model
    assert uses_covariates(model) == (name != "kaplan-meier")


def test_a_model_is_copied_with_its_parameters():
    model = Cox(ridge=0.5)
    copy = named_model(model)
    assert copy is not model
    assert copy.get_params() == {"ties": "efron", "ridge": 0.5}


def test_a_users_own_model_is_taken_and_taken_not_to_need_covariates():
    assert isinstance(named_model(Own()), Own)
    assert not uses_covariates(Own())
    assert not is_fitted(Own())
    assert is_fitted(Own().fit([1.0], [True]))


@pytest.mark.parametrize("wrong", ["weibull", "KaplanMeier"])
def test_refuses_a_name_that_is_none_and_lists_those_that_are(wrong):
    with pytest.raises(ArgumentError, match=rf"censoring is '{wrong}'; it is 'kaplan-meier', 'cox', 'kernel', or a"):
        named_model(wrong)
    with pytest.raises(ArgumentError, match="'kaplan-meier', 'cox', 'kernel'"):
        censoring_weights(TIME, IS_FINISHED, wrong)


def test_refuses_a_class():
    # As a caller without type checks would meet it.
    with pytest.raises(ArgumentError, match=r"censoring is <class .*Cox'>; it is 'kaplan-meier'"):
        named_model(Cox)


@pytest.mark.parametrize(("name", "kind"), NAMES)
def test_names_unfitted_and_fitted_models_weigh_alike(name, kind):
    covariates = None if name == "kaplan-meier" else Z
    unfitted = kind()
    fitted = kind().fit(TIME, IS_FINISHED, covariates)
    expected = IS_FINISHED / fitted.survival(TIME, covariates)
    for model in (name, unfitted, fitted):
        weights = censoring_weights(TIME, IS_FINISHED, model, covariates=covariates)
        np.testing.assert_allclose(weights, expected, rtol=1e-12)
    assert not is_fitted(unfitted)


@pytest.mark.parametrize(("name", "kind"), NAMES)
def test_stages_are_weighed_with_the_covariates_of_their_path(name, kind):
    covariates = None if name == "kaplan-meier" else pd.DataFrame(Z, columns=["clutter", "speed"])
    clock = np.stack([TIME / 2, np.where(IS_FINISHED, TIME, np.nan)], axis=1)
    by_stage = stage_weights(clock, TIME, IS_FINISHED, name, covariates=covariates)
    by_path = censoring_weights(TIME, IS_FINISHED, kind(), covariates=covariates)
    np.testing.assert_allclose(by_stage[:, 1], by_path, rtol=1e-12)
    model = kind().fit(TIME, IS_FINISHED, covariates)
    np.testing.assert_allclose(by_stage[:, 0], 1.0 / model.survival(TIME / 2, covariates), rtol=1e-12)


def test_a_fitted_model_is_not_fitted_again():
    elsewhere = KaplanMeier().fit([1.0, 2.0, 3.0], [False, False, True])
    np.testing.assert_allclose(censoring_weights([3.0], [True], elsewhere), [3.0])


def test_covariates_reach_a_model_that_refuses_them():
    with pytest.raises(ArgumentError, match="KaplanMeier takes no covariates"):
        censoring_weights(TIME, IS_FINISHED, "kaplan-meier", covariates=Z)
    with pytest.raises(ArgumentError, match="Cox needs covariates"):
        censoring_weights(TIME, IS_FINISHED, "cox")
