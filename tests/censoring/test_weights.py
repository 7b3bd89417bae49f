"""Kaplan–Meier of the cuts and the weights made of it: against loops, at ties, and where no weight is to be had."""

import itertools
import warnings
from functools import cache

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st
from lifelines import KaplanMeierFitter
from oracles import naive_event_survival, naive_survival, redistribute_to_the_right, tied_ends
from sksurv import datasets
from sksurv.nonparametric import CensoringDistributionEstimator, kaplan_meier_estimator

from halfseen.censoring import Cox, KaplanMeier, KernelKaplanMeier, censoring_weights, stage_weights
from halfseen.errors import ArgumentError, PositivityError

SHORT = KaplanMeier().fit([1.0, 2.0], [True, False])


class Fixed:
    """A model whose survival does not depend on what it is fitted to."""

    def __init__(self, survival):
        self._survival = survival

    def fit(self, time, is_finished, covariates=None):
        return self

    def survival(self, u, covariates=None):
        assert covariates is None or len(u) == len(covariates)
        return self._survival(u, covariates)


LIAR = Fixed(lambda u, _: np.full(len(u), 1.5))
BY_COVARIATE = Fixed(lambda u, covariates: covariates[:, 0])


@given(tied_ends(), st.lists(st.integers(1, 80).map(lambda tick: tick / 10), max_size=5), st.floats(1.0, 5.0))
def test_curve_and_weights_equal_the_double_loops_on_tied_ends(ends, others, bound):
    time, is_finished = ends
    u = np.concatenate([time, others])
    expected = np.array([naive_survival(time, is_finished, v) for v in u])
    np.testing.assert_allclose(KaplanMeier().fit(time, is_finished).survival(u), expected, rtol=0, atol=1e-12)
    weights = censoring_weights(time, is_finished)
    np.testing.assert_allclose(weights[is_finished], 1.0 / expected[: len(time)][is_finished], rtol=1e-12)
    assert not weights[~is_finished].any()
    # They add up to one minus the curve of the ends, a bound is a minimum, and without cuts all weigh exactly one.
    for t in range(1, 7):
        expected = 1.0 - naive_event_survival(time, is_finished, t)
        assert weights[time <= t].sum() / len(time) == pytest.approx(expected, abs=1e-12)
    bounded = censoring_weights(time, is_finished, truncate_at=bound)
    np.testing.assert_allclose(bounded, np.minimum(weights, bound))
    np.testing.assert_array_equal(censoring_weights(time, np.ones(len(time), dtype=bool)), np.ones(len(time)))


@given(tied_ends(), st.integers(1, 4), st.integers(0, 2))
def test_stage_weights_are_the_inverse_curve_where_completed(ends, num_stages, num_padding):
    end_s, is_finished = ends
    clock = end_s[:, None] * np.arange(1, num_stages + 1) / num_stages
    clock[~is_finished, -1] = np.nan
    padded = np.pad(clock, ((0, 0), (0, num_padding)), constant_values=np.nan)
    expected = [[1.0 / naive_survival(end_s, is_finished, u) if u == u else 0.0 for u in row] for row in padded]
    np.testing.assert_allclose(stage_weights(padded, end_s, is_finished), expected, rtol=1e-12)


def test_equals_scikit_survival_on_untied_ends():
    rng = np.random.default_rng(3)
    own, cut = rng.exponential(10.0, 400), rng.exponential(15.0, 400)
    time, is_finished = np.minimum(own, cut), own <= cut
    ends = np.array(list(zip(is_finished, time, strict=True)), dtype=[("event", bool), ("time", float)])
    expected = CensoringDistributionEstimator().fit(ends).predict_proba(time[is_finished])
    ours = KaplanMeier().fit(time, is_finished).survival(time[is_finished])
    np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("time", "is_finished", "asked", "expected"),
    [
        # The left limit, which falls only after a cut.
        (
            [1.0, 2.0, 2.0, 3.0],
            [True, False, True, True],
            [0.5, 1.0, 2.0, 2.0 + 1e-9, 3.0, 9.0],
            [1, 1, 1, 0.5, 0.5, 0.5],
        ),
        # Nobody is seen beyond the last end when all are cut.
        ([1.0, 2.0], [False, False], [1.0, 2.0, 2.1], [1.0, 0.5, 0.0]),
    ],
)
def test_the_curve_by_hand(time, is_finished, asked, expected):
    np.testing.assert_array_equal(KaplanMeier().fit(time, is_finished).survival(asked), expected)


def test_it_takes_lists_numpy_pandas_and_arrow_and_answers_in_the_shape_of_the_question():
    for wrap in (list, np.array, pd.Series, pa.array):
        curve = KaplanMeier().fit(wrap([1.0, 2.0, 3.0]), wrap([False, False, True]))
        np.testing.assert_allclose(curve.survival(wrap([1.0, 2.0, 3.0])), [1.0, 2 / 3, 1 / 3])
    for shape in ((), (0,), (1,), (2, 3)):
        assert KaplanMeier().fit([1.0], [True]).survival(np.full(shape, 0.5)).shape == shape


def test_twelve_outcomes_of_the_tie_example_give_exactly_one_and_two():
    own, cut = np.array(list(itertools.product([1.0, 2.0, 3.0], [1.0, 2.0, 3.0, 4.0]))).T
    time, is_finished = np.minimum(own, cut), own <= cut
    weights = censoring_weights(time, is_finished)
    assert (weights.mean(), (weights * own).mean()) == pytest.approx((1.0, 2.0), rel=1e-15)
    # The common version counts the cuts at the very moment of a completion.
    late = is_finished / KaplanMeier().fit(time, is_finished).survival(time + 1e-9)
    assert (late.mean(), (late * own).mean()) == pytest.approx((23 / 18, 22 / 9), rel=1e-15)


def test_a_stage_of_a_team_that_takes_no_time_weighs_one():
    clock = np.array([[0.0, 1.0], [0.0, np.nan]])
    weights = stage_weights(clock, np.array([1.0, 0.5]), np.array([True, False]))
    np.testing.assert_allclose(weights, [[1.0, 2.0], [1.0, 0.0]])


BOTH = [True, True]


@pytest.mark.parametrize(
    ("weigh", "error", "message"),
    [
        (
            lambda: censoring_weights([1.0, 3.0], BOTH, SHORT),
            PositivityError,
            r"trajectory 1: finished at 3 s.*shorten the horizon.*truncate_at",
        ),
        (
            lambda: stage_weights([[1.0, np.nan], [2.0, 2.5]], [1.0, 2.5], BOTH, SHORT, trajectory_ids=["a", "b"]),
            PositivityError,
            r"trajectory b, stage 2: completed at 2.5 s.*shorten the horizon.*truncate_at",
        ),
        (
            lambda: censoring_weights([1.0], [True], LIAR),
            ArgumentError,
            r"trajectory 0: the censoring model gives P\(C ≥ 1 s\) = 1.5",
        ),
        (
            lambda: censoring_weights([1.0, 2.0], BOTH, BY_COVARIATE, covariates=[[0.5]]),
            ArgumentError,
            "covariates has 1 rows for 2 trajectories",
        ),
        (
            lambda: censoring_weights([1.0, 2.0], BOTH, trajectory_ids=[7]),
            ArgumentError,
            r"trajectory_ids has shape \(1,\) for 2 trajectories",
        ),
        *(
            (lambda clock=clock: stage_weights(clock, [2.0, 2.0], BOTH), ArgumentError, message)
            for clock, message in (
                ([[1.0], [np.inf]], r"trajectory 1, stage 1: elapsed_s inf is not in \[0, 2.0\]"),
                ([[1.0], [-1.0]], "trajectory 1, stage 1: elapsed_s -1.0"),
                ([[1.0], [2.5]], "trajectory 1, stage 1: elapsed_s 2.5"),
                ([[1.0]], "elapsed_s has 1 rows and end_s has 2"),
                ([1.0, 2.0], r"elapsed_s has shape \(2,\)"),
                (np.ma.masked_array([[1.0], [1.0]], [[False], [True]]), "elapsed_s, row 1: masked"),
            )
        ),
        (
            lambda: KaplanMeier().fit([1.0], [True]).survival(np.array([1], "timedelta64[s]")),
            ArgumentError,
            "u holds timedelta64",
        ),
        (
            lambda: censoring_weights(
                [1.0, 2.0], BOTH, "cox", covariates=np.ma.masked_array([[1.0], [2.0]], [[0], [1]])
            ),
            ArgumentError,
            "covariates, row 1: masked",
        ),
        *(
            (lambda ends=ends: KaplanMeier().fit(*ends), ArgumentError, message)
            for ends, message in (
                (([1.0, 2.0], [True]), "time has 2 rows and is_finished has 1"),
                (([], []), "time has no rows"),
                (([[1.0]], [True]), r"time has shape \(1, 1\)"),
                (([1.0], [[True]]), r"is_finished has shape \(1, 1\)"),
                ((["soon"], [True]), "time is not numeric"),
                (([10**400], [True]), "time is not numeric"),
                (([1.0, 2.0], [1, 2]), "is_finished, row 1: 2 is neither"),
                (([1.0, 2.0], [True, None]), "is_finished, row 1: None is neither"),
                (([1.0, 2.0], ["finished", "cut"]), "is_finished, row 0: 'finished' is neither"),
                ((np.ma.masked_array([1.0, 2.0], [False, True]), BOTH), "time, row 1: masked; fill it in"),
                (([1.0, 2.0], np.ma.masked_array(BOTH, [False, True])), "is_finished, row 1: masked"),
                ((np.array([1, 2], "timedelta64[s]"), BOTH), r"time holds timedelta64\[s\], not real numbers; convert"),
                ((pd.to_datetime([1.0, 2.0], unit="s"), BOTH), "time holds datetime64"),
                ((np.array([1.0, 2.0j]), BOTH), "time holds complex128, not real numbers"),
            )
        ),
    ],
)
def test_what_gives_no_weight_is_refused(weigh, error, message):
    with pytest.raises(error, match=message):
        weigh()


# Real survival data: the event is the finish, censoring is the cut
LOADERS = {
    "aids": datasets.load_aids,
    "aids, death": lambda: datasets.load_aids(endpoint="death"),
    "breast cancer": datasets.load_breast_cancer,
    "flchain": datasets.load_flchain,
    "gbsg2": datasets.load_gbsg2,
    "veterans": datasets.load_veterans_lung_cancer,
    "whas500": datasets.load_whas500,
    "bmt": datasets.load_bmt,
    "cgvhd": datasets.load_cgvhd,
}
TIED = ("whas500", "gbsg2", "veterans", "flchain")
"""Sets in which finishes and cuts fall together."""

# Survival with and without maintenance chemotherapy in acute myelogenous leukaemia, Miller (1981): `aml` in R's
# survival package, the data of its `rttright` example. At 13 and at 45 weeks one patient died and another was censored.
AML_WEEKS = [9, 13, 13, 18, 23, 28, 31, 34, 45, 48, 161, 5, 5, 8, 8, 12, 16, 23, 27, 30, 33, 43, 45]
AML_DIED = [1, 1, 0, 1, 1, 0, 1, 1, 0, 1, 0, 1, 1, 1, 1, 1, 0, 1, 1, 1, 1, 1, 1]


@cache
def real(name):
    """Ends, whether finished, and covariates; times from 0 on are moved by 1, which changes no order."""
    if name == "aml":
        return np.array(AML_WEEKS, dtype=float), np.array(AML_DIED, dtype=bool), None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        covariates, y = LOADERS[name]()
    is_finished, time = (np.array(y[field]) for field in y.dtype.names)
    time = time.astype(float)
    return time + (1.0 if time.min() <= 0 else 0.0), is_finished.astype(bool), covariates


@pytest.mark.parametrize("name", LOADERS)
def test_weights_add_up_to_one_minus_kaplan_meier_of_two_packages(name):
    time, is_finished, _ = real(name)
    assert np.isin(time[is_finished], time[~is_finished]).any() or name not in TIED
    weights = censoring_weights(time, is_finished)
    times, survival = kaplan_meier_estimator(is_finished, time)
    seen_by = [weights[time <= t].sum() / len(time) for t in times]
    np.testing.assert_allclose(seen_by, 1.0 - survival, rtol=0, atol=1e-12)
    total = 1.0 - KaplanMeierFitter().fit(time, is_finished).survival_function_at_times(time.max()).iloc[0]
    assert weights.mean() == pytest.approx(total, abs=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [pytest.param("aids, death", marks=pytest.mark.slow), "gbsg2", "veterans", "whas500", "aml"]
)
def test_weights_equal_redistribution_to_the_right(name):
    time, is_finished, _ = real(name)
    mass = redistribute_to_the_right(time.tolist(), is_finished.tolist())
    # The last trajectories, if cut, have no heirs and keep their mass; they have no weight.
    expected = [float(m * len(time)) if finished else 0.0 for m, finished in zip(mass, is_finished, strict=True)]
    np.testing.assert_allclose(censoring_weights(time, is_finished), expected, rtol=1e-12)


def test_leukaemia_by_hand():
    """Weights in whole numbers: nobody leaves uncut before 13; the cut at 13 shares among the 15 that stay longer."""
    time, is_finished, _ = real("aml")
    weights = censoring_weights(time, is_finished)
    np.testing.assert_array_equal(weights[is_finished & (time <= 13)], 1.0)
    np.testing.assert_allclose(weights[is_finished & (time > 16) & (time <= 28)], 16 / 15 * 15 / 14, rtol=1e-14)
    assert weights[22] == pytest.approx(weights[21], rel=1e-14)


@pytest.mark.parametrize("name", ["aids", "whas500", "gbsg2"])
def test_models_with_covariates_fit_real_data_and_weigh_about_one(name):
    time, is_finished, covariates = real(name)
    numeric = covariates.select_dtypes("number")
    numeric = numeric.loc[:, numeric.nunique() > 2]
    inside = is_finished & (time <= np.quantile(time, 0.8))
    alike = censoring_weights(time, is_finished)[inside].sum()
    for model in (Cox(), KernelKaplanMeier()):
        weights = censoring_weights(time, is_finished, model, covariates=numeric)
        assert weights[inside].sum() == pytest.approx(alike, rel=0.15)
