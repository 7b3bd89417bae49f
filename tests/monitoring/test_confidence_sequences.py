"""Bounds at all times: against a naive loop; and as often right as they say."""

import math

import numpy as np
import pytest

from halfseen.errors import ArgumentError
from halfseen.monitoring.outcomes import MOST_BET, BettingBounds


def naive_betting(values, alpha, grid):
    """Bounds on [0, 1], one candidate and one outcome after another."""
    need, lower, upper = 2.0 / alpha, [], []
    capital = {float(m): [1.0, 1.0] for m in grid}
    sums, squares, mean, out_low, out_high = 0.5, 0.25, 0.5, 0.0, 1.0
    for t, x in enumerate(values, start=1):
        bet = math.sqrt(2.0 * math.log(2.0 / alpha) / (squares / t * t * math.log(1 + t)))
        for m, (up, down) in capital.items():
            most_up, most_down = MOST_BET / m if m > 0 else math.inf, MOST_BET / (1.0 - m) if m < 1 else math.inf
            capital[m] = [up * (1.0 + min(bet, most_up) * (x - m)), down * (1.0 - min(bet, most_down) * (x - m))]
        sums += x
        mean = sums / (t + 1)
        squares += (x - mean) ** 2
        rejected = []
        for m in grid:
            if capital[float(m)][0] < need:
                break
            rejected.append(m)
        out_low = max([out_low, *rejected])
        rejected = []
        for m in grid[::-1]:
            if capital[float(m)][1] < need:
                break
            rejected.append(m)
        out_high = min([out_high, *rejected])
        lower.append(out_low)
        upper.append(out_high)
    return np.array(lower), np.array(upper)


def test_betting_is_what_a_loop_over_candidates_finds():
    values = np.random.default_rng(3).beta(2.0, 5.0, size=120)
    bounds = BettingBounds(0.0, 1.0, 0.1, num_points=51)
    course = bounds.add(values)
    lower, upper = naive_betting(values, 0.1, bounds.grid)
    np.testing.assert_allclose(course.lower, lower)
    np.testing.assert_allclose(course.upper, upper)
    assert 0.1 < course.lower[-1] < values.mean() < course.upper[-1] < 0.5


def test_another_scale_and_one_by_one_change_nothing():
    values = np.random.default_rng(0).random(200)
    at_once = BettingBounds(0.0, 1.0).add(values)
    scaled = BettingBounds(-3.0, 7.0).add(10.0 * values - 3.0)
    np.testing.assert_allclose(scaled.lower, 10.0 * at_once.lower - 3.0, atol=1e-9)
    bounds = BettingBounds(0.0, 1.0)
    np.testing.assert_allclose([float(bounds.add(value).upper[0]) for value in values], at_once.upper, atol=1e-9)
    assert bounds.num == 200


def test_what_lies_outside_is_refused():
    with pytest.raises(ArgumentError, match=r"outcome 3 is 1\.5 in a range of 0\.0 to 1\.0"):
        BettingBounds(0.0, 1.0).add([0.1, 0.2, 1.5])
    with pytest.raises(ArgumentError, match="outcome 1 is nan"):
        BettingBounds(0.0, 1.0).add(np.nan)
    with pytest.raises(ArgumentError, match="the lower first"):
        BettingBounds(1.0, 0.0)
    with pytest.raises(ArgumentError, match="alpha is 0"):
        BettingBounds(0.0, 1.0, 0.0)


@pytest.mark.slow
def test_the_mean_is_ever_outside_no_more_often_than_said():
    # Skewed outcomes, whose range also changes from one to the next.
    rng, num, alpha = np.random.default_rng(5), 200, 0.1
    missed = 0
    for _ in range(num):
        heavy = np.where(rng.random(2000) < 0.5, 5.0, 1.25)
        values = np.where(rng.random(2000) < 0.1 / heavy, heavy, 0.0)
        course = BettingBounds(0.0, 1.0, alpha).add(values, 0.0, heavy)
        missed += bool((course.lower > 0.1 + 1e-9).any() or (course.upper < 0.1 - 1e-9).any())
    assert missed <= alpha * num + 2.0 * np.sqrt(num * alpha * (1 - alpha))
