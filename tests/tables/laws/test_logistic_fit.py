"""The fit of the logistic law of grasping: against integrals taken one by one, and against the law that was drawn."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import approx_fprime
from scipy.special import expit
from scipy.stats import lognorm, norm
from simulated_tables import CALIBRATED, GRASPING, evidence

from halfseen.tables.laws.logistic_fit import SPREAD, centre, fit_logistic, law_of, negative_log_posterior
from halfseen.tables.laws.watched import AT_LIMIT, Watched

LIMIT_S = 9.5
SHARES = np.array([0.0, 0.5, 0.9])
THETAS = [
    centre(LIMIT_S),
    np.array([2.0, -0.5, np.log(0.8), 1.3, 0.3, np.log(0.25)]),
    np.array([-1.0, 2.0, -1.5, 2.2, -0.6, 0.1]),
]


def drawn(num_objects, seed=0, cut_share=0.3):
    """Attempts at objects until they hold, drawn from the law in NumPy; some are cut, and so end the object's row."""
    rng, law = np.random.default_rng(seed), GRASPING
    target = np.repeat(np.arange(num_objects), 4)
    num = len(target)
    offset = rng.normal(0.0, law.offset_std, num_objects)[target]
    occlusion, grip = rng.random(num), rng.normal(0.0, 0.5, num_objects)[target]
    holds = rng.random(num) < expit(law.log_odds + law.log_odds_per_occlusion * occlusion + grip + offset)
    log_s = np.where(holds, law.log_held_s, law.log_missed_s) + law.log_std * rng.normal(size=num)
    lasts_s = np.minimum(np.exp(log_s), law.limit_s)
    cut_s = np.where(rng.random(num) < cut_share, rng.uniform(0.0, law.limit_s, num), np.inf)
    is_cut = cut_s < lasts_s
    is_last = (holds | is_cut).reshape(-1, 4)
    is_kept = (np.cumsum(is_last, axis=1) - is_last == 0).ravel()
    columns = (target, target, occlusion, grip, np.minimum(cut_s, lasts_s), holds & ~is_cut, ~holds & ~is_cut)
    return Watched(*(column[is_kept] for column in columns))


def some_attempts():
    """Few attempts of all kinds: ended, at the limit, and cut, one of them at once; objects in no order."""
    tried = drawn(25)
    rng = np.random.default_rng(1)
    at_limit = ~(tried.is_held | tried.is_missed) & (rng.random(len(tried.object)) < 0.5)
    tried = tried._replace(is_missed=tried.is_missed | at_limit, watched_s=np.where(at_limit, LIMIT_S, tried.watched_s))
    tried.watched_s[np.flatnonzero(tried.is_held)[0]] = LIMIT_S
    tried.watched_s[np.flatnonzero(~(tried.is_held | tried.is_missed))[0]] = 0.0
    order = rng.permutation(len(tried.object))
    return Watched(*(values[order] for values in tried))


def rows_of(tried, target):
    chosen = np.flatnonzero(tried.object == target)
    return [tuple(values[row] for values in tried[2:]) for row in chosen]


def likelihood_of_object(theta, rows):
    """∫ Π P(what was seen | u) φ(u) du of one object, as the law says it, by adaptive quadrature."""
    law = law_of(theta, LIMIT_S)
    held, missed = (lognorm(law.log_std, scale=np.exp(log_s)) for log_s in (law.log_held_s, law.log_missed_s))

    def ended(duration, watched_s):
        return duration.pdf(watched_s) if watched_s < AT_LIMIT * LIMIT_S else duration.sf(AT_LIMIT * LIMIT_S)

    def integrand(u):
        value = norm.pdf(u, scale=law.offset_std)
        for occlusion, grip, watched_s, is_held, is_missed in rows:
            holds = expit(law.log_odds + law.log_odds_per_occlusion * occlusion + grip + u)
            if is_held:
                value *= holds * ended(held, watched_s)
            elif is_missed:
                value *= (1.0 - holds) * ended(missed, watched_s)
            else:
                value *= holds * held.sf(watched_s) + (1.0 - holds) * missed.sf(watched_s)
        return value

    end = 12.0 * law.offset_std
    return quad(integrand, -end, end, points=[0.0], limit=400, epsabs=0.0, epsrel=1e-10)[0]


@pytest.mark.parametrize("theta", THETAS)
def test_posterior_is_what_integrals_one_by_one_give(theta):
    tried, middle = some_attempts(), centre(LIMIT_S)
    total = norm.logpdf(theta, middle, SPREAD).sum() - norm.logpdf(middle, middle, SPREAD).sum()
    for target in np.unique(tried.object):
        total += np.log(likelihood_of_object(theta, rows_of(tried, target)))
    assert negative_log_posterior(theta, tried, LIMIT_S)[0] == pytest.approx(-total, abs=1e-4)


@pytest.mark.parametrize("theta", THETAS)
def test_gradient_is_that_of_the_posterior(theta):
    def value(at):
        return negative_log_posterior(at, some_attempts(), LIMIT_S)[0]

    gradient = negative_log_posterior(theta, some_attempts(), LIMIT_S)[1]
    np.testing.assert_allclose(gradient, approx_fprime(theta, value, 1e-7), atol=2e-4)


def test_nothing_makes_the_posterior_infinite_or_warns():
    tried = some_attempts()._replace(grip=np.linspace(-30.0, 30.0, len(some_attempts().object)))
    for theta in (THETAS[0] - 5.0, THETAS[0] + 4.0, THETAS[2] - np.array([0, 0, 0, 0, 0, 4.0])):
        value, gradient = negative_log_posterior(theta, tried, LIMIT_S)
        assert np.isfinite(value)
        assert np.isfinite(gradient).all()


def test_without_attempts_the_law_is_the_prior_s():
    law = fit_logistic(some_attempts().first(0), LIMIT_S)
    assert np.exp(law.log_failure(0.7, 0.0)) == pytest.approx(0.5)
    assert (law.offset_std, law.log_held_s) == pytest.approx((0.5, np.log(LIMIT_S / 2.0)))
    assert law.log_missed_s == law.log_held_s


def test_without_misses_a_miss_lasts_as_long_as_what_holds():
    tried = drawn(40, cut_share=0.0)
    law = fit_logistic(Watched(*(values[tried.is_held] for values in tried)), LIMIT_S)
    assert law.log_missed_s == pytest.approx(law.log_held_s, abs=1e-3)
    assert law.log_held_s == pytest.approx(GRASPING.log_held_s, abs=0.1)


def test_what_was_watched_for_no_time_tells_nothing():
    tried = some_attempts()
    more = Watched(
        *(np.append(values, more) for values, more in zip(tried, (3, 11, 0.9, 2.0, 0.0, False, False), strict=True))
    )
    assert fit_logistic(more, LIMIT_S) == fit_logistic(tried, LIMIT_S)


def test_a_cut_attempt_tells_of_a_miss_as_far_as_misses_take_longer():
    tried = drawn(300, cut_share=0.0)
    late = tried._replace(is_held=tried.is_held & (tried.object % 3 > 0), watched_s=tried.watched_s.copy())
    is_cut = ~(late.is_held | late.is_missed)

    def misses_if_cut_after(seconds):
        late.watched_s[is_cut] = seconds
        law = fit_logistic(late, LIMIT_S)
        return np.exp(law.log_failure(0.5, 0.0))

    assert misses_if_cut_after(7.0) > misses_if_cut_after(1.0) + 0.05


def test_the_same_attempts_give_the_same_bits():
    assert fit_logistic(some_attempts(), LIMIT_S) == fit_logistic(some_attempts(), LIMIT_S)


def test_numbers_of_objects_mean_nothing_but_which_attempts_share_one():
    tried = drawn(200)
    renumbered = tried._replace(object=1000 - 3 * tried.object)
    one, other = (fit_logistic(each, LIMIT_S) for each in (tried, renumbered))
    np.testing.assert_allclose(numbers(one), numbers(other), atol=1e-5)


def test_grips_enter_as_they_are():
    tried = drawn(200)
    moved = tried._replace(grip=tried.grip + 0.7)
    # The prior on log_odds is all that changes.
    assert fit_logistic(moved, LIMIT_S).log_odds == pytest.approx(fit_logistic(tried, LIMIT_S).log_odds - 0.7, abs=0.05)


def numbers(law):
    values = (law.log_odds, law.log_odds_per_occlusion, law.offset_std, law.log_held_s, law.log_missed_s, law.log_std)
    return np.array(values)


@pytest.mark.parametrize("cut_share", [0.0, 0.4])
def test_the_law_that_was_drawn_from_is_found(cut_share):
    law = fit_logistic(drawn(8000, cut_share=cut_share), LIMIT_S)
    tolerance = np.array([0.2, 0.25, 0.2, 0.01, 0.02, 0.01])
    assert (np.abs(numbers(law) - numbers(GRASPING)) < tolerance).all(), law


def missing(law):
    """P(miss) at some occlusions, over all objects."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(61)
    misses = np.exp(law.log_failure(SHARES[:, None], law.offset_std * nodes))
    return misses @ weights / weights.sum()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cut_share", "cut_kind"), [(0.0, "independent"), (0.5, "independent"), (0.5, "attempt"), (0.5, "occlusion")]
)
def test_the_law_that_made_the_attempts_is_found_however_they_were_cut(cut_share, cut_kind):
    fits = [
        fit_logistic(evidence(2000, cut_share, cut_kind, config=CALIBRATED, seed=seed).tried, LIMIT_S)
        for seed in range(6)
    ]
    np.testing.assert_allclose(np.mean([missing(law) for law in fits], axis=0), missing(GRASPING), atol=0.012)
    mean = np.mean([numbers(law) for law in fits], axis=0)
    assert (np.abs(mean - numbers(GRASPING)) < np.array([0.15, 0.15, 0.25, 0.01, 0.02, 0.005])).all(), mean


@pytest.mark.slow
def test_without_cut_attempts_misses_seem_rarer_than_they_are_where_the_slow_ones_are_cut():
    tried = evidence(4000, 0.7, "attempt", config=CALIBRATED).tried
    is_kept = tried.is_held | tried.is_missed
    dropped = fit_logistic(Watched(*(values[is_kept] for values in tried)), LIMIT_S)
    whole = fit_logistic(tried, LIMIT_S)
    assert missing(dropped)[0] < missing(GRASPING)[0] - 0.02
    assert abs(missing(whole)[0] - missing(GRASPING)[0]) < 0.015
