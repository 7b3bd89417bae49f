"""Which family of laws a log speaks for: densities of the same data, and the right one on either world."""

import numpy as np
import pytest
from scipy.integrate import quad
from simulated_tables import CALIBRATED, recorded

from fitted_laws import FITTED
from halfseen.tables.fitted_world import evidence_of
from halfseen.tables.laws import grasping_fit, logistic_fit
from halfseen.tables.laws.families import (
    choose_grasping,
    choose_seeing,
    exponential_score,
    logistic_score,
    misses_at_limit_alone,
)
from halfseen.tables.laws.watched import AT_LIMIT, Watched
from halfseen.world import AssumedGrasping, AssumedSeeing, FittedGrasping, PersistentSeeing, WorldConfig

LIMIT_S = 6.0


@pytest.mark.parametrize("cut_share", [0.0, 0.5])
@pytest.mark.parametrize(
    ("config", "families"),
    [
        (WorldConfig(), (AssumedGrasping, AssumedSeeing)),
        (CALIBRATED, (FittedGrasping, PersistentSeeing)),
        (FITTED, (FittedGrasping, PersistentSeeing)),
    ],
)
def test_a_log_speaks_for_the_laws_that_made_it(config, families, cut_share):
    _, logs = recorded(200, cut_share, config=config)
    for begin in range(0, 200, 50):
        told = evidence_of(logs.select(logs.path_ids[begin : begin + 50]), config)
        assert isinstance(choose_grasping(told.tried, config.grasping.limit_s), families[0])
        assert isinstance(choose_seeing(told.told, told.dirty_share), families[1])


def one_attempt(watched_s, is_held, is_missed):
    columns = (0, 0, 0.4, 0.3, watched_s, is_held, is_missed)
    return Watched(*(np.array([value]) for value in columns))


def exponential(tried):
    theta = np.array([-1.1, 2.2, 0.0])
    prior = (((theta - grasping_fit.CENTRE) / grasping_fit.SPREAD) ** 2).sum() / 2.0
    return np.exp(exponential_score(theta, tried, LIMIT_S) + prior)


def logistic(tried):
    theta = np.array([0.5, -1.0, 0.0, 1.2, 0.5, -0.3])
    prior = (((theta - logistic_fit.centre(LIMIT_S)) / logistic_fit.SPREAD) ** 2).sum() / 2.0
    return np.exp(logistic_score(theta, tried, LIMIT_S) + prior)


@pytest.mark.parametrize(("family", "misses_early"), [(exponential, False), (logistic, True)])
def test_of_one_attempt_each_family_is_a_distribution_over_the_same_results(family, misses_early):
    begin_s = AT_LIMIT * LIMIT_S
    total = quad(lambda s: family(one_attempt(s, True, False)), 0.0, begin_s)[0]
    total += family(one_attempt(LIMIT_S, True, False)) + family(one_attempt(LIMIT_S, False, True))
    if misses_early:
        total += quad(lambda s: family(one_attempt(s, False, True)), 0.0, begin_s)[0]
    assert total == pytest.approx(1.0, abs=1e-3)


def timed_out(num=60, seed=0):
    rng = np.random.default_rng(seed)
    grasp_s = rng.exponential(4.0, num)
    is_held = grasp_s < LIMIT_S
    target = np.arange(num) // 2
    return Watched(target, target, rng.random(num), np.zeros(num), np.minimum(grasp_s, LIMIT_S), is_held, ~is_held)


def margin(tried, limit_s):
    """By how much the exponential family does better."""
    exponential = exponential_score(grasping_fit.fit_theta(tried, limit_s), tried, limit_s)
    return exponential - logistic_score(logistic_fit.fit_theta(tried, limit_s), tried, limit_s)


def test_the_unit_of_time_does_not_choose():
    tried = timed_out()
    tried.watched_s[np.flatnonzero(tried.is_held)[:3]] = 0.99 * LIMIT_S
    in_ms = tried._replace(watched_s=1000.0 * tried.watched_s)
    assert margin(in_ms, 1000.0 * LIMIT_S) == pytest.approx(margin(tried, LIMIT_S), abs=1e-3)


def test_one_miss_before_the_limit_is_none_that_the_exponential_family_makes():
    tried = timed_out()
    assert misses_at_limit_alone(tried, LIMIT_S)
    assert isinstance(choose_grasping(tried, LIMIT_S), AssumedGrasping)
    tried.watched_s[np.flatnonzero(tried.is_missed)[0]] = 0.9 * LIMIT_S
    assert not misses_at_limit_alone(tried, LIMIT_S)
    assert isinstance(choose_grasping(tried, LIMIT_S), FittedGrasping)


def test_durations_alone_may_choose_the_logistic_family():
    rng = np.random.default_rng(0)
    tried = timed_out()
    steady = tried._replace(watched_s=np.where(tried.is_held, rng.normal(3.0, 0.2, 60), LIMIT_S))
    assert isinstance(choose_grasping(steady, LIMIT_S), FittedGrasping)


def test_what_tells_nothing_leaves_the_law_with_fewer_numbers():
    nothing = timed_out().first(0)
    assert isinstance(choose_grasping(nothing, LIMIT_S), AssumedGrasping)
    cut = timed_out()._replace(is_held=np.zeros(60, dtype=bool), is_missed=np.zeros(60, dtype=bool))
    assert isinstance(choose_grasping(cut._replace(watched_s=np.full(60, 0.1)), LIMIT_S), AssumedGrasping)
