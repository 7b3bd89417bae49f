"""The fit of the law of seeing: against a loop over objects, and against the law that made the labels."""

import numpy as np
import pytest
from scipy.optimize import approx_fprime
from scipy.stats import norm
from simulated_tables import evidence

from halfseen.tables.laws.labels import Labels
from halfseen.tables.laws.seeing_fit import CENTRE, SPREAD, fit_seeing, law_of, negative_log_posterior
from halfseen.world import WorldConfig

THETAS = [CENTRE, np.array([0.4, -1.0, 0.4]), np.array([-1.0, -4.0, -0.6])]
SHARE = 0.6


def some_labels(num=80, num_objects=15, seed=0):
    rng = np.random.default_rng(seed)
    target = np.append(np.arange(num_objects), rng.integers(0, num_objects, num - num_objects))
    occlusion = np.where(rng.random(num) < 0.1, 1.0, rng.random(num))
    shown = rng.choice(3, num_objects)[target]
    no_views = np.zeros(num, dtype=bool), np.zeros(num), np.zeros(num)
    return Labels(target // 3, target, occlusion, *no_views, rng.random(num) < 0.6, shown == 1, shown == 2)


@pytest.mark.parametrize("theta", THETAS)
def test_posterior_is_what_a_loop_over_objects_gives(theta):
    told, law = some_labels(), law_of(theta)
    total = norm.logpdf(theta, CENTRE, SPREAD).sum() - norm.logpdf(CENTRE, CENTRE, SPREAD).sum()
    for target in np.unique(told.object):
        likelihood = {True: SHARE, False: 1.0 - SHARE}
        for row in np.flatnonzero(told.object == target):
            for is_dirty in likelihood:
                accuracy = law.accuracy(told.occlusion[row])
                likelihood[is_dirty] *= accuracy if told.says_dirty[row] == is_dirty else 1.0 - accuracy
        possible = [True] * (not told.was_clean[row]) + [False] * (not told.was_dirty[row])
        total += np.log(sum(likelihood[is_dirty] for is_dirty in possible))
    assert negative_log_posterior(theta, told, SHARE)[0] == pytest.approx(-total, abs=1e-9)


@pytest.mark.parametrize("theta", THETAS)
def test_gradient_is_that_of_the_posterior(theta):
    def value(at):
        return negative_log_posterior(at, some_labels(), SHARE)[0]

    gradient = negative_log_posterior(theta, some_labels(), SHARE)[1]
    np.testing.assert_allclose(gradient, approx_fprime(theta, value, 1e-7), atol=1e-4)


def test_without_labels_the_law_is_the_prior_s():
    law = fit_seeing(some_labels().first(0), SHARE)
    assert law.accuracy(0.0) == pytest.approx(0.75)
    assert law.power == pytest.approx(1.0)


def test_the_same_labels_give_the_same_bits():
    assert fit_seeing(some_labels(), SHARE) == fit_seeing(some_labels(), SHARE)


@pytest.mark.slow
@pytest.mark.parametrize(("cut_share", "cut_kind"), [(0.0, "independent"), (0.5, "attempt"), (0.5, "occlusion")])
def test_the_law_that_made_the_labels_is_found_although_labels_choose_what_is_washed(cut_share, cut_kind):
    shares = np.array([0.0, 0.2, 0.5, 0.8])
    fits = [
        fit_seeing(evidence(2000, cut_share, cut_kind, seed=seed).told, SHARE).accuracy(shares) for seed in range(4)
    ]
    np.testing.assert_allclose(np.mean(fits, axis=0), WorldConfig().seeing.accuracy(shares), atol=0.012)


@pytest.mark.slow
def test_what_is_washed_is_chosen_by_its_labels_which_the_fit_takes_in():
    told, right = evidence(2000).told, WorldConfig().seeing.accuracy(0.0)
    in_view = told.occlusion == 0.0
    # Of washed objects labels say DIRTY more often than of others, be they dirty or clean.
    assert np.mean(told.says_dirty[in_view & told.was_dirty]) > right + 0.02
    assert np.mean(~told.says_dirty[in_view & told.was_clean]) < right - 0.02
    assert abs(fit_seeing(told, SHARE).accuracy(0.0) - right) < 0.012
