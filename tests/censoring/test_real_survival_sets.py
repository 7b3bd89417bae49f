"""Identities on real survival data: the event is the finish, censoring is the cut."""

import warnings
from functools import cache

import numpy as np
import pytest
from lifelines import KaplanMeierFitter
from oracles import naive_survival, redistribute_to_the_right
from sksurv import datasets
from sksurv.nonparametric import kaplan_meier_estimator

from halfseen.censoring import Cox, KaplanMeier, KernelKaplanMeier, censoring_weights

LOADERS = {
    "aids": datasets.load_aids,
    "aids, death": lambda: datasets.load_aids(endpoint="death"),
    "breast cancer": datasets.load_breast_cancer,
    "flchain": datasets.load_flchain,
    "gbsg2": datasets.load_gbsg2,
    "veterans": datasets.load_veterans_lung_cancer,
    "whas500": datasets.load_whas500,
    "bmt": datasets.load_bmt,
    "cgvhd": datasets.load_cgvhd,
}
TIED = ("whas500", "gbsg2", "veterans", "flchain")
"""Sets in which finishes and cuts fall together."""

# Survival with and without maintenance chemotherapy in acute myelogenous leukaemia, Miller (1981): `aml` in R's
# survival package, the data of its `rttright` example. At 13 and at 45 weeks one patient died and another was censored.
AML_WEEKS = [9, 13, 13, 18, 23, 28, 31, 34, 45, 48, 161, 5, 5, 8, 8, 12, 16, 23, 27, 30, 33, 43, 45]
AML_DIED = [1, 1, 0, 1, 1, 0, 1, 1, 0, 1, 0, 1, 1, 1, 1, 1, 0, 1, 1, 1, 1, 1, 1]


@cache
def real(name):
    """Ends, whether finished, and covariates; times from 0 on are moved by 1, which changes no order."""
    if name == "aml":
        return np.array(AML_WEEKS, dtype=float), np.array(AML_DIED, dtype=bool), None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        covariates, y = LOADERS[name]()
    is_finished, time = (np.array(y[field]) for field in y.dtype.names)
    time = time.astype(float)
    return time + (1.0 if time.min() <= 0 else 0.0), is_finished.astype(bool), covariates


@pytest.mark.parametrize("name", LOADERS)
def test_weights_add_up_to_one_minus_kaplan_meier_of_two_packages(name):
    time, is_finished, _ = real(name)
    assert np.isin(time[is_finished], time[~is_finished]).any() or name not in TIED
    weights = censoring_weights(time, is_finished)
    times, survival = kaplan_meier_estimator(is_finished, time)
    seen_by = [weights[time <= t].sum() / len(time) for t in times]
    np.testing.assert_allclose(seen_by, 1.0 - survival, rtol=0, atol=1e-12)
    total = 1.0 - KaplanMeierFitter().fit(time, is_finished).survival_function_at_times(time.max()).iloc[0]
    assert weights.mean() == pytest.approx(total, abs=1e-12)


@pytest.mark.parametrize(
    "name", [pytest.param("aids, death", marks=pytest.mark.slow), "gbsg2", "veterans", "whas500", "aml"]
)
def test_weights_equal_redistribution_to_the_right(name):
    time, is_finished, _ = real(name)
    mass = redistribute_to_the_right(time.tolist(), is_finished.tolist())
    # The last trajectories, if cut, have no heirs and keep their mass; they have no weight.
    expected = [float(m * len(time)) if finished else 0.0 for m, finished in zip(mass, is_finished, strict=True)]
    np.testing.assert_allclose(censoring_weights(time, is_finished), expected, rtol=1e-12)


def test_leukaemia_by_hand():
    """Weights in whole numbers: nobody leaves uncut before 13; the cut at 13 shares among the 15 that stay longer."""
    time, is_finished, _ = real("aml")
    weights = censoring_weights(time, is_finished)
    np.testing.assert_array_equal(weights[is_finished & (time <= 13)], 1.0)
    np.testing.assert_allclose(weights[is_finished & (time > 16) & (time <= 28)], 16 / 15 * 15 / 14, rtol=1e-14)
    assert weights[22] == pytest.approx(weights[21], rel=1e-14)


@pytest.mark.parametrize("name", ["veterans", "whas500"])
def test_kaplan_meier_equals_the_double_loop(name):
    time, is_finished, _ = real(name)
    asked = np.quantile(time, np.linspace(0.0, 1.0, 12))
    expected = [naive_survival(time.tolist(), is_finished.tolist(), u) for u in asked]
    np.testing.assert_allclose(KaplanMeier().fit(time, is_finished).survival(asked), expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", ["aids", "whas500", "gbsg2"])
def test_models_with_covariates_fit_real_data_and_weigh_about_one(name):
    time, is_finished, covariates = real(name)
    numeric = covariates.select_dtypes("number")
    numeric = numeric.loc[:, numeric.nunique() > 2]
    inside = is_finished & (time <= np.quantile(time, 0.8))
    alike = censoring_weights(time, is_finished)[inside].sum()
    for model in (Cox(), KernelKaplanMeier()):
        weights = censoring_weights(time, is_finished, model, covariates=numeric)
        assert weights[inside].sum() == pytest.approx(alike, rel=0.15)
