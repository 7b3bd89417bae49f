"""Fits of both laws of grasping: against integrals one by one, the laws that made the attempts, and one another."""

from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import approx_fprime
from scipy.special import expit
from scipy.stats import lognorm, norm
from simulated_tables import CALIBRATED, GRASPING, evidence

from halfseen.tables.evidence import AT_LIMIT, TimedAttempts, of_first
from halfseen.tables.law_grasping import Exponential, LogisticFamily, choose_grasping, misses_at_limit_alone
from halfseen.world import AssumedGrasping, FittedGrasping, WorldConfig

LIMIT_S = 9.5
SHARES = np.array([0.0, 0.5, 0.9])


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
    return TimedAttempts(*(column[is_kept] for column in columns))


def some_attempts():
    """Few attempts of all kinds: ended, at the limit, and cut, one of them at once; objects in no order."""
    tried = drawn(15)
    rng = np.random.default_rng(1)
    at_limit = ~(tried.is_held | tried.is_missed) & (rng.random(len(tried.object)) < 0.5)
    tried = tried._replace(is_missed=tried.is_missed | at_limit, watched_s=np.where(at_limit, LIMIT_S, tried.watched_s))
    tried.watched_s[np.flatnonzero(tried.is_held)[0]] = LIMIT_S
    tried.watched_s[np.flatnonzero(~(tried.is_held | tried.is_missed))[0]] = 0.0
    order = rng.permutation(len(tried.object))
    return TimedAttempts(*(values[order] for values in tried))


def exponential_likelihood(law, u, occlusion, grip, watched_s, is_held, is_missed):
    rate = 1.0 / np.exp(law.log_time + law.log_time_per_occlusion * occlusion - grip - u)
    return (rate if is_held else 1.0) * np.exp(-rate * (LIMIT_S if is_missed else watched_s))


@cache
def lasting(log_s, log_std):
    """Durations of attempts; to make one takes longer than to ask it."""
    return lognorm(log_std, scale=np.exp(log_s))


def logistic_likelihood(law, u, occlusion, grip, watched_s, is_held, is_missed):
    held, missed = lasting(law.log_held_s, law.log_std), lasting(law.log_missed_s, law.log_std)
    holds = expit(law.log_odds + law.log_odds_per_occlusion * occlusion + grip + u)
    if is_held or is_missed:
        duration, chance = (held, holds) if is_held else (missed, 1.0 - holds)
        is_early = watched_s < AT_LIMIT * LIMIT_S
        return chance * (duration.pdf(watched_s) if is_early else duration.sf(AT_LIMIT * LIMIT_S))
    return holds * held.sf(watched_s) + (1.0 - holds) * missed.sf(watched_s)


class Family(NamedTuple):
    of: Any
    likelihood: Any
    thetas: list
    numbers: list
    tolerance: float

    def fitted(self, tried, limit_s=LIMIT_S):
        family = self.of(tried, limit_s)
        return family.law(family.fitted())

    def numbers_of(self, law):
        return np.array([getattr(law, name) for name in self.numbers])


NONE = of_first(drawn(2), 0)
EXPONENTIAL = Family(
    Exponential,
    exponential_likelihood,
    [Exponential(NONE, LIMIT_S).prior.mode, np.array([-1.1, 2.2, 0.0]), np.array([0.5, -1.0, -1.5])],
    ["log_time", "log_time_per_occlusion", "offset_std"],
    1e-3,
)
LOGISTIC = Family(
    LogisticFamily,
    logistic_likelihood,
    [
        LogisticFamily(NONE, LIMIT_S).prior.mode,
        np.array([2.0, -0.5, np.log(0.8), 1.3, 0.3, np.log(0.25)]),
        np.array([-1.0, 2.0, -1.5, 2.2, -0.6, 0.1]),
    ],
    ["log_odds", "log_odds_per_occlusion", "offset_std", "log_held_s", "log_missed_s", "log_std"],
    1e-4,
)
BOTH = pytest.mark.parametrize("family", [EXPONENTIAL, LOGISTIC], ids=["exponential", "logistic"])


def likelihood_of_object(family, law, rows):
    """∫ Π P(what was seen | u) φ(u) du of one object, as the law says it, by adaptive quadrature."""

    def integrand(u):
        return norm.pdf(u, scale=law.offset_std) * np.prod([family.likelihood(law, u, *row) for row in rows])

    end = 12.0 * law.offset_std
    return quad(integrand, -end, end, points=[0.0], limit=400, epsabs=0.0, epsrel=1e-10)[0]


@pytest.mark.slow
@pytest.mark.parametrize("k", range(3))
@BOTH
def test_posterior_is_what_integrals_one_by_one_give(family, k):
    tried, theta = some_attempts(), family.thetas[k]
    fit = family.of(tried, LIMIT_S)
    prior = fit.prior
    total = norm.logpdf(theta, *prior).sum() - norm.logpdf(prior.mode, *prior).sum()
    for target in np.unique(tried.object):
        rows = [tuple(values[row] for values in tried[2:]) for row in np.flatnonzero(tried.object == target)]
        total += np.log(likelihood_of_object(family, fit.law(theta), rows))
    assert fit.loss(theta)[0] == pytest.approx(-total, abs=family.tolerance)


@pytest.mark.parametrize("k", range(3))
@BOTH
def test_gradient_is_that_of_the_posterior(family, k):
    theta, fit = family.thetas[k], family.of(some_attempts(), LIMIT_S)
    numeric = approx_fprime(theta, lambda at: fit.loss(at)[0], 1e-7)
    np.testing.assert_allclose(fit.loss(theta)[1], numeric, atol=2e-4)


def test_nothing_makes_the_logistic_posterior_infinite_or_warns():
    tried = some_attempts()._replace(grip=np.linspace(-30.0, 30.0, len(some_attempts().object)))
    first, _, last = LOGISTIC.thetas
    for theta in (first - 5.0, first + 4.0, last - np.array([0, 0, 0, 0, 0, 4.0])):
        value, gradient = LogisticFamily(tried, LIMIT_S).loss(theta)
        assert np.isfinite(value)
        assert np.isfinite(gradient).all()


def test_misses_of_the_exponential_family_are_taken_to_have_lasted_the_limit():
    tried = some_attempts()
    late = tried._replace(watched_s=np.where(tried.is_missed, LIMIT_S, tried.watched_s))
    assert EXPONENTIAL.fitted(late) == EXPONENTIAL.fitted(tried)


@BOTH
def test_without_attempts_the_law_is_the_prior_s(family):
    law = family.fitted(of_first(some_attempts(), 0))
    assert np.exp(law.log_failure(0.7, 0.0)) == pytest.approx(0.5)
    assert law.offset_std == pytest.approx(0.5)
    if family is LOGISTIC:
        assert law.log_held_s == pytest.approx(np.log(LIMIT_S / 2.0))
        assert law.log_missed_s == law.log_held_s


@BOTH
def test_what_was_watched_for_no_time_tells_nothing(family):
    tried = some_attempts()
    more = (3, 11, 0.9, 2.0, 0.0, False, False)
    longer = TimedAttempts(*(np.append(values, more) for values, more in zip(tried, more, strict=True)))
    laws = family.fitted(longer), family.fitted(tried)
    np.testing.assert_allclose(*map(family.numbers_of, laws), atol=1e-9)


@BOTH
def test_numbers_of_objects_mean_nothing_but_which_attempts_share_one(family):
    tried = drawn(200)
    laws = family.fitted(tried), family.fitted(tried._replace(object=1000 - 3 * tried.object))
    np.testing.assert_allclose(*map(family.numbers_of, laws), atol=1e-5)


def test_without_misses_a_miss_lasts_as_long_as_what_holds():
    tried = drawn(40, cut_share=0.0)
    law = LOGISTIC.fitted(TimedAttempts(*(values[tried.is_held] for values in tried)))
    assert law.log_missed_s == pytest.approx(law.log_held_s, abs=1e-3)
    assert law.log_held_s == pytest.approx(GRASPING.log_held_s, abs=0.1)


def test_a_cut_attempt_tells_of_a_miss_as_far_as_misses_take_longer():
    tried = drawn(300, cut_share=0.0)
    late = tried._replace(is_held=tried.is_held & (tried.object % 3 > 0), watched_s=tried.watched_s.copy())
    is_cut = ~(late.is_held | late.is_missed)

    def misses_if_cut_after(seconds):
        late.watched_s[is_cut] = seconds
        return np.exp(LOGISTIC.fitted(late).log_failure(0.5, 0.0))

    assert misses_if_cut_after(7.0) > misses_if_cut_after(1.0) + 0.05


def test_grips_enter_as_they_are():
    tried = drawn(200)
    moved = tried._replace(grip=tried.grip + 0.7)
    # The prior on log_odds is all that changes.
    assert LOGISTIC.fitted(moved).log_odds == pytest.approx(LOGISTIC.fitted(tried).log_odds - 0.7, abs=0.05)


@pytest.mark.parametrize("cut_share", [0.0, 0.4])
def test_the_law_that_was_drawn_from_is_found(cut_share):
    law = LOGISTIC.fitted(drawn(8000, cut_share=cut_share))
    tolerance = np.array([0.2, 0.25, 0.2, 0.01, 0.02, 0.01])
    assert (np.abs(LOGISTIC.numbers_of(law) - LOGISTIC.numbers_of(GRASPING)) < tolerance).all(), law


def missing(law):
    """P(miss) at some occlusions, over all objects."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(61)
    misses = np.exp(law.log_failure(SHARES[:, None], law.offset_std * nodes))
    return misses @ weights / weights.sum()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("family", "config", "tolerance"),
    [(EXPONENTIAL, WorldConfig(), [0.08] * 3), (LOGISTIC, CALIBRATED, [0.15, 0.15, 0.25, 0.01, 0.02, 0.005])],
    ids=["exponential", "logistic"],
)
@pytest.mark.parametrize(
    ("cut_share", "cut_kind"), [(0.0, "independent"), (0.5, "independent"), (0.5, "attempt"), (0.5, "occlusion")]
)
def test_the_law_that_made_the_attempts_is_found_however_they_were_cut(family, config, tolerance, cut_share, cut_kind):
    truth = config.grasping
    made = [evidence(2000, cut_share, cut_kind, config=config, seed=seed).tried for seed in range(4)]
    fits = [family.fitted(tried, truth.limit_s) for tried in made]
    mean = np.mean([family.numbers_of(law) for law in fits], axis=0)
    assert (np.abs(mean - family.numbers_of(truth)) < np.array(tolerance)).all(), mean
    if family is LOGISTIC:
        np.testing.assert_allclose(np.mean([missing(law) for law in fits], axis=0), missing(truth), atol=0.012)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("family", "config", "tells", "seems", "near"),
    [
        (EXPONENTIAL, WorldConfig(), lambda law: law.log_time, 0.1, 0.05),
        (LOGISTIC, CALIBRATED, lambda law: missing(law)[0], 0.02, 0.015),
    ],
    ids=["faster", "fewer misses"],
)
def test_without_cut_attempts_the_law_seems_better_than_it_is_where_the_slow_ones_are_cut(
    family, config, tells, seems, near
):
    tried, limit_s = evidence(4000, 0.7, "attempt", config=config).tried, config.grasping.limit_s
    is_kept = tried.is_held | tried.is_missed
    dropped = family.fitted(TimedAttempts(*(values[is_kept] for values in tried)), limit_s)
    assert tells(dropped) < tells(config.grasping) - seems
    assert abs(tells(family.fitted(tried, limit_s)) - tells(config.grasping)) < near


@BOTH
def test_of_one_attempt_each_family_is_a_distribution_over_the_same_results(family):
    begin_s, theta = AT_LIMIT * LIMIT_S, family.thetas[1]
    mode, spread = family.of(NONE, LIMIT_S).prior
    prior = (((theta - mode) / spread) ** 2).sum() / 2.0

    def density(watched_s, is_held):
        columns = (0, 0, 0.4, 0.3, watched_s, is_held, not is_held)
        one = family.of(TimedAttempts(*(np.array([value]) for value in columns)), LIMIT_S)
        return np.exp(one.score(theta) + prior)

    total = quad(lambda s: density(s, True), 0.0, begin_s)[0] + density(LIMIT_S, True) + density(LIMIT_S, False)
    if family is LOGISTIC:
        total += quad(lambda s: density(s, False), 0.0, begin_s)[0]
    assert total == pytest.approx(1.0, abs=1e-3)


def timed_out(num=60):
    rng = np.random.default_rng(0)
    grasp_s = rng.exponential(0.6 * LIMIT_S, num)
    is_held, target = grasp_s < LIMIT_S, np.arange(num) // 2
    return TimedAttempts(
        target, target, rng.random(num), np.zeros(num), np.minimum(grasp_s, LIMIT_S), is_held, ~is_held
    )


def test_the_unit_of_time_does_not_choose():
    def margin(tried, limit_s):
        exponential, logistic = Exponential(tried, limit_s), LogisticFamily(tried, limit_s)
        return exponential.score(exponential.fitted()) - logistic.score(logistic.fitted())

    tried = timed_out()
    tried.watched_s[np.flatnonzero(tried.is_held)[:3]] = 0.99 * LIMIT_S
    in_ms = tried._replace(watched_s=1000.0 * tried.watched_s)
    assert margin(in_ms, 1000.0 * LIMIT_S) == pytest.approx(margin(tried, LIMIT_S), abs=1e-3)


def test_one_miss_before_the_limit_or_steady_durations_choose_the_logistic_family():
    tried = timed_out()
    assert misses_at_limit_alone(tried, LIMIT_S)
    assert isinstance(choose_grasping(tried, LIMIT_S), AssumedGrasping)
    steady = np.where(tried.is_held, np.random.default_rng(0).normal(3.0, 0.2, 60), LIMIT_S)
    assert isinstance(choose_grasping(tried._replace(watched_s=steady), LIMIT_S), FittedGrasping)
    tried.watched_s[np.flatnonzero(tried.is_missed)[0]] = 0.9 * LIMIT_S
    assert not misses_at_limit_alone(tried, LIMIT_S)
    assert isinstance(choose_grasping(tried, LIMIT_S), FittedGrasping)


def test_what_tells_nothing_leaves_the_law_with_fewer_numbers():
    no = np.zeros(60, dtype=bool)
    cut = timed_out()._replace(is_held=no, is_missed=no, watched_s=np.full(60, 0.1))
    for tried in (cut, of_first(cut, 0)):
        assert isinstance(choose_grasping(tried, LIMIT_S), AssumedGrasping)
