"""The fit of the law of grasping: against integrals taken one by one, and against the law that made the attempts."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import approx_fprime
from scipy.stats import norm
from simulated_tables import evidence

from halfseen.tables.laws.grasping_fit import CENTRE, SPREAD, fit_grasping, negative_log_posterior
from halfseen.tables.laws.watched import Watched
from halfseen.world import WorldConfig

LIMIT_S = 6.0
THETAS = [CENTRE, np.array([-1.1, 2.2, 0.0]), np.array([0.5, -1.0, -1.5])]


def some_attempts(num=40, num_objects=12, seed=0):
    rng = np.random.default_rng(seed)
    watched_s, is_held = rng.uniform(0.0, LIMIT_S, num), rng.random(num) < 0.6
    target = np.sort(rng.integers(0, num_objects, num))
    is_missed = ~is_held & (rng.random(num) < 0.5)
    watched_s[is_missed] = LIMIT_S
    return Watched(target // 3, target, rng.random(num), rng.normal(0.0, 0.5, num), watched_s, is_held, is_missed)


def no_attempts():
    return some_attempts().first(0)


def log_likelihood_of_object(theta, attempts):
    """∫ Π f(t | u)^d S(t | u)^(1 − d) φ(u) du of one object, as the law says it, by adaptive quadrature."""
    log_time, std = theta[0] + np.log(LIMIT_S), np.exp(theta[2])

    def integrand(u):
        value = norm.pdf(u, scale=std)
        for occlusion, grip, watched_s, is_held in attempts:
            rate = 1.0 / np.exp(log_time + theta[1] * occlusion - grip - u)
            value *= (rate if is_held else 1.0) * np.exp(-rate * watched_s)
        return value

    return np.log(quad(integrand, -12.0 * std, 12.0 * std, points=[0.0], limit=400, epsabs=1e-14)[0])


@pytest.mark.parametrize("theta", THETAS)
def test_posterior_is_what_integrals_one_by_one_give(theta):
    tried = some_attempts()
    total = norm.logpdf(theta, CENTRE, SPREAD).sum() - norm.logpdf(CENTRE, CENTRE, SPREAD).sum()
    for target in np.unique(tried.object):
        rows = np.flatnonzero(tried.object == target)
        columns = (tried.occlusion, tried.grip, tried.watched_s, tried.is_held)
        total += log_likelihood_of_object(theta, [tuple(column[row] for column in columns) for row in rows])
    assert negative_log_posterior(theta, tried, LIMIT_S)[0] == pytest.approx(-total, abs=1e-3)


@pytest.mark.parametrize("theta", THETAS)
def test_gradient_is_that_of_the_posterior(theta):
    def value(at):
        return negative_log_posterior(at, some_attempts(), LIMIT_S)[0]

    gradient = negative_log_posterior(theta, some_attempts(), LIMIT_S)[1]
    np.testing.assert_allclose(gradient, approx_fprime(theta, value, 1e-7), atol=1e-4)


def test_misses_are_taken_to_have_lasted_the_limit():
    tried = some_attempts()
    early = tried._replace(watched_s=np.where(tried.is_missed, 1.0, tried.watched_s))
    assert fit_grasping(early, LIMIT_S) == fit_grasping(tried, LIMIT_S)


def test_without_attempts_the_law_is_the_prior_s():
    law = fit_grasping(no_attempts(), LIMIT_S)
    assert np.exp(law.log_failure(0.7, 0.0)) == pytest.approx(0.5)
    assert law.offset_std == pytest.approx(0.5)


def test_what_was_watched_for_no_time_tells_nothing():
    tried = some_attempts()
    more = Watched(
        *(np.append(values, more) for values, more in zip(tried, (3, 11, 0.9, 2.0, 0.0, False, False), strict=True))
    )
    assert fit_grasping(more, LIMIT_S).log_time == pytest.approx(fit_grasping(tried, LIMIT_S).log_time, abs=1e-9)


def test_the_same_attempts_give_the_same_bits():
    assert fit_grasping(some_attempts(), LIMIT_S) == fit_grasping(some_attempts(), LIMIT_S)


def test_numbers_of_objects_mean_nothing_but_which_attempts_share_one():
    tried = some_attempts()
    renumbered = tried._replace(object=37 - tried.object)
    assert fit_grasping(renumbered, LIMIT_S).log_time == pytest.approx(fit_grasping(tried, LIMIT_S).log_time, abs=1e-6)


def numbers(law):
    return np.array([law.log_time, law.log_time_per_occlusion, law.offset_std])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cut_share", "cut_kind"), [(0.0, "independent"), (0.5, "independent"), (0.5, "attempt"), (0.5, "occlusion")]
)
def test_the_law_that_made_the_attempts_is_found_however_they_were_cut(cut_share, cut_kind):
    fits = [numbers(fit_grasping(evidence(2000, cut_share, cut_kind, seed=seed).tried, LIMIT_S)) for seed in range(6)]
    truth = numbers(WorldConfig().grasping)
    np.testing.assert_allclose(np.mean(fits, axis=0), truth, atol=0.08)


@pytest.mark.slow
def test_without_cut_attempts_the_law_seems_faster_than_it_is_where_the_slow_ones_are_cut():
    tried = evidence(4000, 0.7, "attempt").tried
    is_kept = tried.is_held | tried.is_missed
    dropped = fit_grasping(Watched(*(values[is_kept] for values in tried)), LIMIT_S)
    whole, truth = fit_grasping(tried, LIMIT_S), WorldConfig().grasping
    assert dropped.log_time < truth.log_time - 0.1
    assert abs(whole.log_time - truth.log_time) < 0.05
