"""Times in a unit, in single precision, or in rows of another order."""

from datetime import UTC, datetime

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

from halfseen.censoring import (
    CensoringSpec,
    Cox,
    KaplanMeier,
    KernelKaplanMeier,
    StageClocks,
    censoring_weights,
    positivity_report,
    stage_weights,
    weight_diagnostics,
)
from halfseen.learning import CensoredSVC, CensoredSVR, survival_array
from refusals import refused, refused_type

FINISHED = [False, True, False, True]
TIMES_IN_A_UNIT = {
    "list": [np.timedelta64(k, "ms") for k in (3, 5, 7, 9)],
    "dates": [np.datetime64(k, "s") for k in (3, 5, 7, 9)],
    "arrow": pa.array([3, 5, 7, 9], pa.duration("us")),
    "arrow dates": pa.array([3, 5, 7, 9], pa.timestamp("us")),
    "chunks": pa.chunked_array([pa.array([3, 5, 7, 9], pa.duration("us"))]),
}


@pytest.mark.parametrize("name", TIMES_IN_A_UNIT)
def test_times_in_a_unit_of_their_own_are_no_seconds(name):
    times = TIMES_IN_A_UNIT[name]
    with refused("time holds (timedelta|datetime)64.*, not real numbers; convert it, times to seconds"):
        KaplanMeier().fit(times, FINISHED)
    with refused("u holds (timedelta|datetime)64.*, not real numbers"):
        KaplanMeier().fit([1.0, 2.0], [False, True]).survival(times)


@pytest.mark.parametrize("kind", ["duration[ms][pyarrow]", "timestamp[us][pyarrow]"])
@pytest.mark.parametrize("model", [Cox(ridge=1.0), KernelKaplanMeier(bandwidth=1.0)])
def test_a_covariate_in_a_unit_of_its_own_is_no_number(model, kind):
    since = pd.DataFrame({"since": pd.Series(pd.array([1, 2, 4, 3], dtype="int64[pyarrow]")).astype(kind)})
    with refused(r"covariates, since holds (duration|timestamp)\[.*, not real numbers; convert"):
        model.fit([3.0, 5.0, 7.0, 9.0], FINISHED, since)


def test_a_list_that_is_ragged_or_of_dates_of_python_is_refused_as_before():
    for times in ([[1.0], [1.0, 2.0]], [datetime(2026, 1, day, tzinfo=UTC) for day in (1, 2)]):
        with refused("time is not numeric"):
            KaplanMeier().fit(times, [False, True])


@pytest.mark.parametrize(
    "single", [np.float32, lambda t: pd.Series(t, dtype="Float32"), lambda t: pd.Series(t, dtype="float32")]
)
@pytest.mark.parametrize("model", [KaplanMeier(), Cox(ridge=1.0), KernelKaplanMeier(bandwidth=1.0)])
def test_the_fit_or_the_question_may_be_in_single_precision(model, single):
    """Of 0.1, 0.2, …, some are larger in single precision and some smaller: no cut precedes itself."""
    ticks = np.arange(1, 21)
    is_finished, z = ticks % 3 == 0, np.sin(ticks)[:, None]
    more = (z,) if model.uses_covariates else ()
    whole = model.unfitted().fit(ticks, is_finished, *more).survival(ticks, *more)
    for fitted, asked in ((np.float64, single), (single, np.float64), (single, single)):
        found = model.unfitted().fit(fitted(0.1 * ticks), is_finished, *more).survival(asked(0.1 * ticks), *more)
        np.testing.assert_allclose(found, whole, rtol=1e-12)


@pytest.mark.parametrize("is_fitted", [False, True])
def test_weights_of_clocks_in_two_precisions(is_fitted):
    """Ends in the one and stages in the other: a trajectory is not cut before it completed its stage."""
    ticks, is_finished = np.array([2.0, 5.0, 8.0]), np.array([False, False, True])
    elapsed = np.array([[np.nan], [2.0], [8.0]])
    whole, of_ends = stage_weights(elapsed, ticks, is_finished), censoring_weights(ticks, is_finished)
    model = KaplanMeier().fit(0.1 * ticks, is_finished) if is_fitted else None
    for one, other in ((np.float32, np.float64), (np.float64, np.float32), (np.float32, np.float32)):
        found = stage_weights(one(0.1 * elapsed), other(0.1 * ticks), is_finished, model)
        np.testing.assert_allclose(found, whole, rtol=1e-12)
        np.testing.assert_allclose(censoring_weights(one(0.1 * ticks), is_finished, model), of_ends, rtol=1e-12)


ENDS = pd.Series([3.0, 5.0, 7.0, 9.0], index=["a", "b", "c", "d"])
IS_FINISHED, CLUTTER = pd.Series(FINISHED, index=ENDS.index), pd.DataFrame({"z": [1.0, 2.0, 4.0, 3.0]}, ENDS.index)
TURNED = ["b", "a", "c", "d"]


@pytest.mark.parametrize(
    ("asks", "message"),
    [
        (
            lambda: KaplanMeier().fit(ENDS, IS_FINISHED[TURNED]),
            "is_finished, row 0: its label is 'b', but that of time",
        ),
        (lambda: Cox(ridge=1.0).fit(ENDS, IS_FINISHED, CLUTTER.loc[TURNED]), "covariates, row 0: its label is 'b'"),
        (lambda: KernelKaplanMeier().fit(ENDS, FINISHED, CLUTTER.loc[TURNED]), "covariates, row 0: its label is 'b'"),
        (lambda: censoring_weights(ENDS[TURNED], IS_FINISHED), r"is_finished.loc\[time.index\]"),
        (lambda: stage_weights(ENDS[TURNED].to_frame(), ENDS, FINISHED), "elapsed_s, row 0: its label is 'b'"),
        (lambda: positivity_report(ENDS, IS_FINISHED[TURNED]), "is_finished, row 0: its label is 'b'"),
        (lambda: positivity_report(ENDS, FINISHED, target=ENDS[TURNED]), "target, row 0: its label is 'b'"),
        (lambda: survival_array(ENDS, IS_FINISHED[TURNED]), "is_finished, row 0: its label is 'b'"),
        (lambda: CensoredSVR().fit(CLUTTER, ENDS[TURNED]), "y, row 0: its label is 'b', but that of X is 'a'"),
        (lambda: CensoredSVR().fit(CLUTTER, ENDS, ENDS[TURNED]), "sample_weight, row 0: its label is 'b'"),
        (lambda: CensoredSVC(tau=6.0).fit(CLUTTER, (ENDS[TURNED], FINISHED)), "y, row 0: its label is 'b'"),
    ],
)
def test_rows_of_pandas_in_another_order_are_not_mixed_up(asks, message):
    with refused(message):
        asks()


def test_a_covariate_that_differs_by_rounding_alone_is_constant():
    """0.1 + 0.2 is not 0.3, and says nothing of cuts."""
    ticks = np.arange(1.0, 13.0)
    is_finished, rounded = ticks % 3 == 0, np.where(ticks % 4 < 2, 0.3, 0.1 + 0.2)
    for model in (Cox(), KernelKaplanMeier(bandwidth=1.0)):
        with refused("covariates, column 0: 0.3 in every row"):
            model.fit(ticks, is_finished, rounded[:, None])
    clocks = StageClocks.of_ends(ticks, is_finished)
    states = np.stack([np.sin(ticks), rounded], axis=1)[:, None]
    clocks = clocks._replace(covariates=states, covariate_names=("x", "rounded"))
    assert CensoringSpec("cox").fit_cuts(clocks).fitted[0].columns.tolist() == [0]


def test_rows_of_pandas_with_other_labels_are_matched_by_place():
    for labels in (range(4), ["a", "a", "b", "c"], ["p", "q", "r", "s"]):
        found = Cox(ridge=1.0).fit(ENDS, IS_FINISHED.set_axis(labels), CLUTTER.set_axis(labels))
        assert found.coefficients_ == Cox(ridge=1.0).fit(ENDS, IS_FINISHED, CLUTTER).coefficients_


@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_times_without_bounds(kind):
    curve = KaplanMeier().fit([1.0, 2.0], [False, True])
    np.testing.assert_array_equal(curve.survival(np.array([-np.inf, np.inf], kind)), [1.0, 0.5])


@pytest.mark.parametrize("u", ["abc", ["1", "x"], [[1.0], [1.0, 2.0]]])
def test_a_time_that_is_none_is_refused_in_a_line(u):
    with refused_type("u is not numeric"):
        KaplanMeier().fit([1.0, 2.0], [False, True]).survival(u)


def test_masked_weights_are_no_weights():
    with refused("weights, row 1: masked; fill it in"):
        weight_diagnostics(np.ma.masked_array([1.0, 30.0], mask=[False, True]))


def test_a_single_weight_and_a_bound_in_words():
    assert weight_diagnostics(np.array(2.0)).largest_at == ()
    with refused_type("truncate_at is '2'; weights are at least 1"):
        censoring_weights(ENDS, FINISHED, truncate_at="2")
