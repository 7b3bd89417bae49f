"""What the examples simulate, estimate and say, each against a reference."""

from itertools import product

import numpy as np
import pytest
from cut_regression.methods import cox_median
from cut_regression.settings import CUT_SHARES, TAU, Sample, Setting, TrueCuts
from cut_regression.words import contrast
from sksurv.linear_model import CoxPHSurvivalAnalysis
from sksurv.util import Surv

from halfseen.censoring import Cox, censoring_weights

SETTINGS = [
    Setting(median, num_covariates, cuts, share)
    for median, num_covariates, cuts, share in product(
        ("linear", "quadratic"), (1, 10), ("uniform", "dependent"), CUT_SHARES
    )
]


@pytest.mark.parametrize("setting", SETTINGS)
def test_the_wanted_share_is_cut_and_times_are_positive(setting):
    sample = setting.sample(100_000, np.random.default_rng(1))
    assert sample.cut_share == pytest.approx(setting.cut_share, abs=0.006)
    assert sample.covariates.shape == (100_000, setting.num_covariates)
    assert sample.time.min() > 0


@pytest.mark.parametrize("setting", [s for s in SETTINGS if s.num_covariates == 1])
def test_true_weights_recover_the_true_median(setting):
    """Of the weighted rows half lie below m(z), near any z, and the weights have mean 1 in all."""
    sample = setting.sample(200_000, np.random.default_rng(2))
    end, is_seen = np.minimum(sample.time, TAU), sample.is_finished | (sample.time >= TAU)
    weights = censoring_weights(end, is_seen, TrueCuts(setting), covariates=sample.covariates)
    assert weights.mean() == pytest.approx(1.0, abs=0.02)
    below = weights * (end <= setting.medians(sample.covariates))
    for low in (0.0, 0.4, 0.8):
        here = (sample.covariates[:, 0] >= low) & (sample.covariates[:, 0] < low + 0.2)
        assert below[here].sum() / here.sum() == pytest.approx(0.5, abs=0.03)


@pytest.mark.parametrize("setting", SETTINGS)
def test_cox_median_is_scikit_survivals(setting):
    sample = setting.sample(150, np.random.default_rng(3))
    asked = np.random.default_rng(4).uniform(size=(40, setting.num_covariates))
    peer = CoxPHSurvivalAnalysis(ties="efron").fit(sample.covariates, Surv.from_arrays(sample.is_finished, sample.time))
    expected = []
    for curve in peer.predict_survival_function(asked):
        below = curve.x[curve.y <= 0.5]
        expected.append(min(below[0], TAU) if len(below) else TAU)
    assert cox_median(sample)(asked) == pytest.approx(np.array(expected), abs=1e-9)


def test_cox_answers_tau_where_its_curve_stays_above_a_half():
    rng = np.random.default_rng(5)
    z = rng.uniform(size=(40, 1))
    sample = Sample(z, rng.uniform(0.1, 4.0, size=40), rng.uniform(size=40) < 0.2)
    ends_above = Cox().fit(sample.time, ~sample.is_finished, z).survival(np.full(40, np.inf), z) > 0.5
    assert 0 < ends_above.sum() < 40
    assert ((cox_median(sample)(z) == TAU) == ends_above).all()


def test_the_interval_is_that_of_the_paired_t_test():
    ours, other = np.array([0.1, 0.3, 0.2]), np.array([0.4, 0.5, 0.6])
    result = contrast(ours, other)
    # Differences −0.3, −0.2, −0.4: mean −0.3, standard error 0.1/√3, and t(0.975, 2) = 4.30265.
    assert result == pytest.approx((0.2, 0.5, -0.3 - 4.30265 * 0.1 / 3**0.5, -0.3 + 4.30265 * 0.1 / 3**0.5), abs=1e-5)
