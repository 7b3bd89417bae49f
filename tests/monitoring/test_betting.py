"""Wealth, p-values at any time and change points: against naive loops, and as often wrong as they say at most."""

import numpy as np
import pytest

from halfseen.monitoring import betting
from halfseen.monitoring.diagnosis import change_point


def naive_wealth(payoffs):
    """Of one gambler: the mean over the times from which on it bets, and over its ways."""
    num = len(payoffs)
    hazards = betting.SHAPE / (betting.SCALE + np.arange(num))
    waits = np.cumprod(np.append(1.0 - betting.FROM_FIRST, 1.0 - hazards))
    chances = np.append(betting.FROM_FIRST, waits[:-1] * hazards)
    course = []
    for end in range(1, num + 1):
        begins = [0, *range(end)]
        ways = [np.prod(payoffs[begin:end, 1:], axis=0).mean() for begin in begins]
        course.append(np.log(chances[: end + 1] @ ways + waits[end]))
    return np.array(course)


def test_wealth_is_the_mean_over_times_and_ways():
    p = np.random.default_rng(0).random((60, 2)) ** 1.5
    p[10:20, 1] = np.nan
    payoffs = betting.rank_payoffs(p)
    found = betting.log_wealth(payoffs)
    for k in range(2):
        np.testing.assert_allclose(found[:, k], naive_wealth(payoffs[:, k]), atol=1e-12)
    assert (payoffs[10:20, 1] == 1.0).all()


def test_no_bet_has_a_mean_above_one_while_nothing_has_changed():
    middles = (np.arange(100_000) + 0.5) / 100_000
    for is_less in (False, True):
        np.testing.assert_allclose(betting.rank_payoffs(middles[:, None], is_less=is_less).mean(axis=0), 1.0, atol=0.01)
    outcomes = np.array([[-2.0], [1.0], [1.0], [0.0]])
    assert (betting.mean_payoffs(outcomes, np.ones((4, 1)), np.zeros(1)).mean(axis=0) <= 1.0 + 1e-12).all()
    left = np.array([-1.0, 1.0])
    payoffs = betting.residual_payoffs(left, np.arange(2), 2, np.full(2, 0.1), 1.5)
    assert (payoffs.mean(axis=0) <= 1.0).all()


def test_residuals_of_one_trajectory_are_multiplied():
    left, place = np.array([-0.5, -0.5, 0.25]), np.array([0, 0, 1])
    each = betting.residual_payoffs(left, np.arange(3), 3, np.zeros(3), 1.0)
    together = betting.residual_payoffs(left, place, 3, np.zeros(3), 1.0)
    np.testing.assert_allclose(together[0], each[0] * each[1])
    np.testing.assert_allclose(together[1:, 0], [each[2, 0], np.ones(betting.NUM_STATES)])
    assert each[0, 0, 3] == pytest.approx(1.0 + betting.STAKE * 0.5)


def test_conformal_p_values_are_what_counting_gives():
    rng = np.random.default_rng(1)
    bins, draws, counts = rng.integers(-1, 4, 50), rng.random(50), np.array([3.0, 0.0, 2.0, 1.0])
    found = betting.rank_p_values(bins, 4, counts, draws)
    before = [k for k in range(4) for _ in range(int(counts[k]))]
    for value, draw, p in zip(bins, draws, found, strict=True):
        if value < 0:
            assert np.isnan(p)
            continue
        below, same = sum(b < value for b in before), sum(b == value for b in before)
        assert p == pytest.approx((below + draw * (same + 1)) / (len(before) + 1))
        before.append(value)


def test_a_change_is_found_where_it_is_and_against_a_reference_from_the_first_on():
    values = np.concatenate([np.zeros(40), np.ones(20)]) + 0.1 * np.random.default_rng(0).normal(size=60)
    found = change_point(values)
    assert (found.at, found.low, found.high) == (40, 40, 40)
    assert change_point(values[40:], 0.0, 100).at == 0
    sparse = np.full(120, np.nan)
    sparse[::2] = values
    sparse[:9] = np.nan
    assert change_point(sparse) == (80, 79, 80)
    assert change_point(sparse, 9.0, 100).low == 0


def test_a_larger_change_after_the_alarm_is_not_what_the_alarm_was_about():
    values = np.repeat([0.0, 1.0, 9.0], 40) + 0.1 * np.random.default_rng(0).normal(size=120)
    assert change_point(values).at == 80
    found = change_point(values, latest=50)
    assert (found.at, found.high <= 50) == (40, True)


@pytest.mark.slow
def test_the_interval_of_a_change_holds_it_as_often_as_said():
    rng, num = np.random.default_rng(3), 400
    found = [change_point(np.append(rng.normal(size=150), 1.0 + rng.normal(size=50))) for _ in range(num)]
    share = np.mean([one.low <= 150 <= one.high for one in found])
    assert share == pytest.approx(0.95, abs=3.0 * np.sqrt(0.95 * 0.05 / num))


@pytest.mark.slow
@pytest.mark.parametrize("is_less", [False, True])
def test_wealth_reaches_twenty_in_one_of_twenty_lifetimes_at_most(is_less):
    rng, num = np.random.default_rng(4), 400
    bins = rng.choice(6, size=(2000, num), p=[0.3, 0.3, 0.2, 0.1, 0.05, 0.05])
    draws = rng.random((2000, num))
    p = np.column_stack([betting.rank_p_values(bins[:, k], 6, np.zeros(6), draws[:, k]) for k in range(num)])
    share = (betting.p_values(betting.log_wealth(betting.rank_payoffs(p, is_less=is_less)))[-1] <= 0.05).mean()
    assert share <= 0.05 + 2.0 * np.sqrt(0.05 * 0.95 / num)


def test_a_hypothesis_is_first_rejected_when_its_own_evidence_is_enough():
    p = np.minimum.accumulate(np.array([[1.0, 1.0], [0.01, 1.0], [0.01, 0.04], [0.01, 0.04]]), axis=0)
    assert [betting.first_rejected(p, 0.05, k) for k in range(2)] == [1, 2]
    late = np.array([[0.04, 0.04], [0.03, 0.02]])
    assert [betting.first_rejected(late, 0.05, k) for k in range(2)] == [1, 1]


def test_an_alarm_stays_after_a_trajectory_of_thousands_of_stages():
    trajectory = np.append(np.zeros(5000, dtype=int), [1, 2])
    left = np.append(-np.ones(5000), [0.0, 0.0])
    payoffs = betting.residual_payoffs(left, trajectory, 3, np.zeros(5002), 1.0)
    assert np.isfinite(payoffs).all()
    (first, second, last) = betting.p_values(betting.log_wealth(payoffs))[:, 0]
    assert first == second == last < 1e-9
