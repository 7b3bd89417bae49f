import numpy as np
import pandas as pd
import pytest
from scipy import stats

from halfseen.study.statistics import adjusted, estimate_in, holm, over_repetitions, paired_test


def naive_holm(p_values):
    """By definition: the k-th smallest times how many are not smaller, never below one before it."""
    ranked = sorted(range(len(p_values)), key=lambda i: p_values[i])
    adjusted, largest = [0.0] * len(p_values), 0.0
    for rank, i in enumerate(ranked):
        largest = max(largest, min(1.0, (len(p_values) - rank) * p_values[i]))
        adjusted[i] = largest
    return adjusted


@pytest.mark.parametrize("seed", range(5))
def test_holm_by_its_definition(seed):
    p_values = np.round(np.random.default_rng(seed).random(12) ** 3, 2)  # rounded, so that some tie

    np.testing.assert_allclose(holm(p_values), naive_holm(p_values))


def test_what_was_not_tested_stays_so_and_does_not_count():
    np.testing.assert_allclose(holm(np.array([0.01, np.nan, 0.04])), [0.02, np.nan, 0.04])
    table = adjusted(
        pd.DataFrame({"p_value": [0.01, np.nan], "effect": 1.0, "effect_low": 0.0, "effect_high": 2.0}), 0.05
    )
    assert table["supported"].tolist() == [True, pd.NA]


def test_the_interval_of_a_mean_is_students():
    values = np.array([1.0, 2.0, 3.0, 6.0])
    found = over_repetitions(values)
    low, high = stats.ttest_1samp(values, 0.0).confidence_interval(0.95)
    assert (found.value, found.standard_error) == pytest.approx((3.0, np.sqrt(14 / 3 / 4)))
    assert (found.low, found.high) == pytest.approx((low, high))
    again = estimate_in({"mean": found.value, "se": found.standard_error}, "mean", "se", 4)
    assert (again.low, again.high) == pytest.approx((low, high))


def test_intervals_of_few_repetitions_cover_what_they_say():
    rng = np.random.default_rng(0)
    covered = [estimate.low <= 0.0 <= estimate.high for estimate in map(over_repetitions, rng.normal(size=(4000, 6)))]
    assert np.mean(covered) == pytest.approx(0.95, abs=0.015)


def test_more_is_better_or_less_is():
    rng = np.random.default_rng(0)
    other = rng.normal(size=40)
    ours = other + 0.5 + 0.3 * rng.normal(size=40)

    assert paired_test(ours, other, is_more_better=True).p_value < 1e-4
    assert paired_test(ours, other, is_more_better=False).p_value > 0.99
    assert paired_test(other, ours, is_more_better=False).p_value < 1e-4


def test_the_effect_is_the_mean_difference_and_its_interval_is_that_of_t():
    rng = np.random.default_rng(1)
    ours, other = rng.normal(1.0, 1.0, 20), rng.normal(size=20)
    test = paired_test(ours, other, is_more_better=True)
    low, high = stats.ttest_rel(ours, other).confidence_interval(0.95)

    assert (test.effect.value, test.effect.low, test.effect.high) == pytest.approx((np.mean(ours - other), low, high))


def test_where_nothing_differs_nothing_is_claimed():
    same = np.array([1.0, 2.0, 3.0])

    test = paired_test(same, same, is_more_better=True)
    assert (test.p_value, test.effect.low, test.effect.high) == (1.0, 0.0, 0.0)
