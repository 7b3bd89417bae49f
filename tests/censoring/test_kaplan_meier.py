import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles import naive_survival, tied_ends
from sksurv.nonparametric import CensoringDistributionEstimator

from halfseen.censoring import KaplanMeier
from halfseen.errors import ArgumentError


@pytest.fixture
def untied():
    rng = np.random.default_rng(3)
    own, cut = rng.exponential(10.0, 400), rng.exponential(15.0, 400)
    return np.minimum(own, cut), own <= cut


@given(tied_ends(), st.lists(st.floats(0.1, 8.0), max_size=5))
def test_equals_the_double_loop_on_tied_ends(ends, others):
    time, is_finished = ends
    u = np.concatenate([time, others])
    expected = [naive_survival(time, is_finished, v) for v in u]
    np.testing.assert_allclose(KaplanMeier().fit(time, is_finished).survival(u), expected, rtol=0, atol=1e-12)


def test_equals_scikit_survival_on_untied_ends(untied):
    time, is_finished = untied
    reference = CensoringDistributionEstimator().fit(_structured(time, is_finished))
    ours = KaplanMeier().fit(time, is_finished).survival(time[is_finished])
    np.testing.assert_allclose(ours, reference.predict_proba(time[is_finished]), rtol=0, atol=1e-12)


def test_is_the_left_limit_and_falls_only_after_a_cut():
    curve = KaplanMeier().fit([1.0, 2.0, 2.0, 3.0], [True, False, True, True])
    np.testing.assert_array_equal(
        curve.survival([0.5, 1.0, 2.0, np.nextafter(2.0, 3.0), 3.0, 9.0]), [1, 1, 1, 0.5, 0.5, 0.5]
    )


@pytest.mark.parametrize("shape", [(), (0,), (1,), (2, 3)])
def test_answers_in_the_shape_of_the_question(shape):
    assert KaplanMeier().fit([1.0], [True]).survival(np.full(shape, 0.5)).shape == shape


@pytest.mark.parametrize("wrap", [list, np.array, pd.Series, pa.array])
def test_takes_lists_numpy_pandas_and_arrow(wrap):
    curve = KaplanMeier().fit(wrap([1.0, 2.0, 3.0]), wrap([False, False, True]))
    np.testing.assert_allclose(curve.survival(wrap([1.0, 2.0, 3.0])), [1.0, 2 / 3, 1 / 3])


@pytest.mark.parametrize(
    ("time", "is_finished", "message"),
    [
        ([1.0, 2.0], [True], "time has 2 rows and is_finished has 1"),
        ([], [], "time has no rows"),
        ([[1.0]], [True], r"time has shape \(1, 1\)"),
        ([1.0], [[True]], r"is_finished has shape \(1, 1\)"),
        (["soon"], [True], "time is not made of numbers"),
        ([1.0, 2.0], [1, 2], "is_finished, row 1: 2 is neither"),
        ([1.0, 2.0], [True, None], "is_finished, row 1: None is neither"),
        ([1.0, 2.0], ["finished", "cut"], "is_finished, row 0: 'finished' is neither"),
    ],
)
def test_refuses_what_is_no_list_of_ends(time, is_finished, message):
    with pytest.raises(ArgumentError, match=message):
        KaplanMeier().fit(time, is_finished)


def _structured(time, is_finished):
    return np.array(list(zip(is_finished, time, strict=True)), dtype=[("event", bool), ("time", float)])


def test_nobody_is_seen_beyond_the_last_end_when_all_are_cut():
    curve = KaplanMeier().fit([1.0, 2.0], [False, False])
    np.testing.assert_array_equal(curve.survival([1.0, 2.0, 2.1]), [1.0, 0.5, 0.0])
