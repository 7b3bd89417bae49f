"""What the examples' figures claim, with samples large enough to tell: the bias of each way, against its limit."""

from functools import cache

import numpy as np
import pytest
from cut_regression.comparison import GRID
from cut_regression.methods import cox_median
from cut_regression.settings import CUT_SLOPE, SHAPE, TAU, Setting, TrueCuts
from threadpoolctl import threadpool_limits

from halfseen.learning import CensoredSVR, survival_array

NUM_ROWS, NUM_SAMPLES, REG = 1500, 4, 1e-3
HEAVY = [Setting(median, 1, cuts, 0.5) for median in ("linear", "quadratic") for cuts in ("uniform", "dependent")]
DEPENDENT = [setting for setting in HEAVY if setting.cuts == "dependent"]
# The edges are left to the kernel.
INNER = (GRID >= 0.05) & (GRID <= 0.95)

pytestmark = pytest.mark.slow


@cache
def mean_curve(setting, method):
    """Mean estimate over samples at GRID [s]; λ is small and fixed, so that the bias is the weights'."""
    curves = []
    for r in range(NUM_SAMPLES):
        sample = setting.sample(NUM_ROWS, np.random.default_rng([7, r]))
        if method == "cox-times":
            curves.append(cox_median(sample)(GRID[:, None]))
            continue
        censoring = TrueCuts(setting) if method == "true" else method
        model = CensoredSVR(loss="absolute", censoring=censoring, tau=TAU, reg=REG, tol=1e-5)
        with threadpool_limits(1):
            model.fit(sample.covariates, survival_array(sample.time, sample.is_finished))
        curves.append(model.predict(GRID[:, None]))
    return np.mean(curves, axis=0)


def bias(setting, method):
    """Mean of |mean estimate − m(z)| over inner z [s]."""
    return np.abs(mean_curve(setting, method) - setting.medians(GRID[:, None]))[INNER].mean()


def limits(setting):
    """Medians that unweighted uncut rows and Kaplan–Meier weights tend to at GRID [s], by quadrature."""
    edges = np.linspace(0.0, TAU, 1501)
    middle, width = (edges[1:] + edges[:-1]) / 2, edges[1]
    alive = np.exp(-np.log(2.0) * (edges[None] / setting.medians(GRID[:, None])[:, None]) ** SHAPE)
    watched = np.array([setting.cut_survival(middle, np.full((len(middle), 1), z)) for z in GRID])
    hazard = np.exp(CUT_SLOPE * GRID)[:, None] / setting.cut_scale
    at_risk = (alive[:, 1:] + alive[:, :-1]) / 2 * watched
    kaplan_meier = np.exp(-np.cumsum((hazard * at_risk).mean(axis=0) / at_risk.mean(axis=0)) * width)
    mass = -np.diff(alive, axis=1) * watched
    mass = np.column_stack([mass, alive[:, -1] * watched[:, -1]])
    places = np.append(middle, TAU)
    return _medians(mass, places), _medians(mass / np.append(kaplan_meier, kaplan_meier[-1]), places)


def _medians(mass, places):
    share = np.cumsum(mass, axis=1) / mass.sum(axis=1, keepdims=True)
    return places[np.argmax(share >= 0.5, axis=1)]


@pytest.mark.parametrize("setting", HEAVY)
def test_true_weights_take_most_of_the_bias_of_uncut_rows_away(setting):
    assert bias(setting, "none") > 0.2
    assert bias(setting, "true") < bias(setting, "none") / 3


@pytest.mark.parametrize("setting", [s for s in HEAVY if s.cuts == "uniform"])
@pytest.mark.parametrize("method", ["kaplan-meier", "cox"])
def test_under_uniform_cuts_estimated_weights_do_as_well(setting, method):
    assert bias(setting, method) < bias(setting, "none") / 3


@pytest.mark.parametrize("setting", DEPENDENT)
def test_under_dependent_cuts_kaplan_meier_is_biased_and_cox_less_so(setting):
    assert bias(setting, "cox") < 0.7 * bias(setting, "kaplan-meier") < 0.7 * bias(setting, "none")


@pytest.mark.parametrize("setting", DEPENDENT)
def test_the_biases_are_those_that_theory_foretells(setting):
    uncut, kaplan_meier = limits(setting)
    assert np.abs(mean_curve(setting, "none") - uncut)[INNER].mean() < 0.1
    assert np.abs(mean_curve(setting, "kaplan-meier") - kaplan_meier)[INNER].mean() < 0.1
    truth = setting.medians(GRID[:, None])
    assert np.abs(uncut - truth).mean() > 1.8 * np.abs(kaplan_meier - truth).mean() > 0.25


@pytest.mark.parametrize("setting", HEAVY)
def test_coxs_model_of_the_times_is_near_where_it_is_nearly_right(setting):
    if setting.median == "linear":
        assert bias(setting, "cox-times") < 0.1
    else:
        assert bias(setting, "cox-times") > 0.4
