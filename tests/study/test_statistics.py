"""Tests and intervals of the study, beside definitions and SciPy."""

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from halfseen.study.compare import adjusted, better, estimate_in, holm, over_repetitions


def naive_holm(p_values):
    """By definition: the k-th smallest times how many are not smaller, never below one before it."""
    ranked = sorted(range(len(p_values)), key=lambda i: p_values[i])
    found, largest = [0.0] * len(p_values), 0.0
    for rank, i in enumerate(ranked):
        largest = max(largest, min(1.0, (len(p_values) - rank) * p_values[i]))
        found[i] = largest
    return found


def test_holm_by_its_definition_and_what_was_not_tested_stays_so_and_does_not_count():
    for seed in range(5):
        p_values = np.round(np.random.default_rng(seed).random(12) ** 3, 2)  # rounded, so that some tie
        np.testing.assert_allclose(holm(p_values), naive_holm(p_values))
    np.testing.assert_allclose(holm(np.array([0.01, np.nan, 0.04])), [0.02, np.nan, 0.04])
    rows = pd.DataFrame({"p_value": [0.01, np.nan], "effect": 1.0, "effect_low": 0.0, "effect_high": 2.0})
    assert adjusted(rows, 0.05)["supported"].tolist() == [True, pd.NA]


def test_the_interval_of_a_mean_is_students_and_covers_what_it_says():
    values = np.array([1.0, 2.0, 3.0, 6.0])
    found, ends = over_repetitions(values), tuple(stats.ttest_1samp(values, 0.0).confidence_interval(0.95))
    assert (found.value, found.standard_error) == pytest.approx((3.0, np.sqrt(14 / 3 / 4)))
    again = estimate_in({"mean": found.value, "se": found.standard_error}, "mean", "se", 4)
    assert (found.low, found.high) == pytest.approx(ends)
    assert (again.low, again.high) == pytest.approx(ends)
    drawn = map(over_repetitions, np.random.default_rng(0).normal(size=(4000, 6)))
    assert np.mean([each.low <= 0.0 <= each.high for each in drawn]) == pytest.approx(0.95, abs=0.015)


def test_the_effect_is_the_mean_difference_with_the_interval_of_t_and_more_is_better_or_less_is():
    rng = np.random.default_rng(0)
    other = rng.normal(size=40)
    ours = other + 0.5 + 0.3 * rng.normal(size=40)
    found = better(ours, other, "reward")
    assert found.p_value < 1e-4
    assert better(ours, other, "time").p_value > 0.99
    assert better(other, ours, "time").p_value < 1e-4
    low, high = stats.ttest_rel(ours, other).confidence_interval(0.95)
    effect = found.effect
    assert (effect.value, effect.low, effect.high) == pytest.approx((np.mean(ours - other), low, high))
    nothing = better(other, other, "reward")
    assert (nothing.p_value, nothing.effect.low, nothing.effect.high) == (1.0, 0.0, 0.0)
