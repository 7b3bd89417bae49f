from itertools import product

import numpy as np
import pytest
from scipy.special import stdtr, stdtrit

from halfseen.evaluation.estimate import around, crossing, upper_tail


@pytest.mark.parametrize("freedom", [1.0, 1.5, 2.0, 3.7, 10.0, 55.3, 500.0, 1e4, 1e6, 9e6, 1e7, 1e9, np.inf])
def test_tails_are_those_of_scipy(freedom):
    x = np.array([-1e6, -30.0, -3.0, -1.0, -1e-3, 0.0, 1e-3, 0.3, 1.0, 1.96, 3.0])
    found = [upper_tail(each, freedom) for each in x]
    np.testing.assert_allclose(found, stdtr(freedom, -x), rtol=1e-12 if freedom <= 500 else 1e-5)


@pytest.mark.parametrize("x", [30.0, 1e3, 1e6])
def test_far_tails_keep_their_digits(x):
    for freedom in (1.0, 3.7, 55.3):
        np.testing.assert_allclose(upper_tail(x, freedom), stdtr(freedom, -x), rtol=1e-12)


@pytest.mark.parametrize(("freedom", "level"), [*product([1, 2, 9, 30, 1e5], [0.05, 0.8, 0.95, 0.999999])])
def test_reach_of_an_interval_is_the_quantile_of_scipy(freedom, level):
    np.testing.assert_allclose(
        around(0.0, 1.0, 5.0, freedom, level).high, stdtrit(freedom, (1.0 + level) / 2.0), rtol=1e-9
    )


@pytest.mark.parametrize(("freedom", "level", "bias"), [*product([1, 9, 1e5], [0.05, 0.95], [1e-9, 0.1, 8.0])])
def test_reach_with_a_bias_holds_the_truth_as_often_as_the_level_says(freedom, level, bias):
    reach = around(0.0, 1.0, 5.0, freedom, level, bias).high
    np.testing.assert_allclose(stdtr(freedom, bias - reach) + stdtr(freedom, -bias - reach), 1.0 - level, rtol=1e-9)


@pytest.mark.parametrize(("low", "high"), [(0.0, 9.0), (2.0, 9.0), (-5.0, 2.0), (1.9999999, 1e6)])
def test_a_crossing_is_found_from_any_bracket(low, high):
    assert crossing(lambda x: x**3 - 8.0, low, high) == pytest.approx(2.0, rel=1e-13)
    assert crossing(lambda x: 8.0 - x**3, low, high) == pytest.approx(2.0, rel=1e-13)


@pytest.mark.parametrize("error", [1e-17, 1e-300, 5e-324])
def test_a_bias_that_dwarfs_the_standard_error_is_the_reach(error):
    assert around(0.0, error, 5.0, 9.0, 0.95, bias=3.0).high == pytest.approx(3.0, rel=1e-12)
