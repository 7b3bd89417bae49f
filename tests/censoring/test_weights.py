import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles import naive_event_survival, naive_survival, tied_ends

from halfseen.censoring import KaplanMeier, censoring_weights, stage_weights
from halfseen.errors import ArgumentError, PositivityError

SHORT = KaplanMeier().fit([1.0, 2.0], [True, False])


class Liar:
    """A model whose probabilities are none."""

    def fit(self, time, is_finished, covariates=None):
        return self

    def survival(self, u, covariates=None):
        return np.full(len(u), 1.5)


class ByCovariate:
    """A model in which the covariate is the probability of being watched."""

    def fit(self, time, is_finished, covariates=None):
        return self

    def survival(self, u, covariates=None):
        assert len(u) == len(covariates)
        return covariates[:, 0]


def right_continuous_weights(time, is_finished):
    """The common version, which counts the cuts at the very moment of a completion."""
    curve = KaplanMeier().fit(time, is_finished)
    return is_finished / curve.survival(np.nextafter(time, np.inf))


def test_twelve_outcomes_of_the_tie_example_give_exactly_one_and_two():
    own, cut = np.array(list(itertools.product([1.0, 2.0, 3.0], [1.0, 2.0, 3.0, 4.0]))).T
    time, is_finished = np.minimum(own, cut), own <= cut
    weights = censoring_weights(time, is_finished)
    assert weights.mean() == pytest.approx(1.0, rel=1e-15)
    assert (weights * own).mean() == pytest.approx(2.0, rel=1e-15)
    late = right_continuous_weights(time, is_finished)
    assert late.mean() == pytest.approx(23 / 18, rel=1e-15)
    assert (late * own).mean() == pytest.approx(22 / 9, rel=1e-15)


@given(tied_ends())
def test_weights_add_up_to_one_minus_kaplan_meier_on_tied_ends(ends):
    time, is_finished = ends
    weights = censoring_weights(time, is_finished)
    for t in range(1, 7):
        expected = 1.0 - naive_event_survival(time, is_finished, t)
        assert weights[time <= t].sum() / len(time) == pytest.approx(expected, abs=1e-12)


@given(tied_ends())
def test_equals_the_double_loop_and_is_zero_where_cut(ends):
    time, is_finished = ends
    expected = [d / naive_survival(time, is_finished, t) if d else 0.0 for t, d in zip(time, is_finished, strict=True)]
    np.testing.assert_allclose(censoring_weights(time, is_finished), expected, rtol=1e-12)


@given(tied_ends())
def test_no_cuts_weigh_exactly_one(ends):
    time, _ = ends
    np.testing.assert_array_equal(censoring_weights(time, np.ones(len(time), dtype=bool)), np.ones(len(time)))


def test_unseen_end_is_refused_with_path_and_time():
    with pytest.raises(PositivityError, match=r"path 1: finished at 3 s.*shorten the horizon.*truncate_at"):
        censoring_weights([1.0, 3.0], [True, True], SHORT)


def test_unseen_stage_is_refused_with_path_stage_and_time():
    with pytest.raises(PositivityError, match=r"path b, stage 2: completed at 2.5 s.*shorten the horizon.*truncate_at"):
        stage_weights([[1.0, np.nan], [2.0, 2.5]], [1.0, 2.5], [True, True], SHORT, path_ids=["a", "b"])


@given(tied_ends(), st.floats(1.0, 5.0))
def test_truncation_is_a_minimum(ends, bound):
    time, is_finished = ends
    free = censoring_weights(time, is_finished)
    np.testing.assert_allclose(censoring_weights(time, is_finished, truncate_at=bound), np.minimum(free, bound))


@given(tied_ends(), st.integers(1, 4), st.integers(0, 2))
def test_stage_weights_are_the_inverse_curve_where_completed(ends, num_stages, num_padding):
    end_s, is_finished = ends
    clock = end_s[:, None] * np.arange(1, num_stages + 1) / num_stages
    clock[~is_finished, -1] = np.nan
    padded = np.pad(clock, ((0, 0), (0, num_padding)), constant_values=np.nan)
    weights = stage_weights(padded, end_s, is_finished)
    expected = [[1.0 / naive_survival(end_s, is_finished, u) if u == u else 0.0 for u in row] for row in padded]
    np.testing.assert_allclose(weights, expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("clock", "message"),
    [
        ([[1.0], [np.inf]], r"path 1, stage 1: elapsed_s inf is not in \[0, 2.0\]"),
        ([[1.0], [-1.0]], "path 1, stage 1: elapsed_s -1.0"),
        ([[1.0], [2.5]], "path 1, stage 1: elapsed_s 2.5"),
        ([[1.0]], "elapsed_s has 1 rows and end_s has 2"),
        ([1.0, 2.0], r"elapsed_s has shape \(2,\)"),
    ],
)
def test_refuses_a_clock_that_leaves_the_path(clock, message):
    with pytest.raises(ArgumentError, match=message):
        stage_weights(clock, [2.0, 2.0], [True, True])


def test_refuses_probabilities_that_are_none():
    with pytest.raises(ArgumentError, match=r"path 0: the censoring model gives P\(C ≥ 1 s\) = 1.5"):
        censoring_weights([1.0], [True], Liar())


def test_covariates_follow_their_paths():
    covariates = [[0.5], [0.25], [0.1]]
    weights = censoring_weights([1.0, 2.0, 3.0], [True, False, True], ByCovariate(), covariates=covariates)
    np.testing.assert_allclose(weights, [2.0, 0.0, 10.0])
    clock = [[1.0, np.nan], [1.0, 2.0]]
    by_stage = stage_weights(clock, [1.0, 2.0], [True, True], ByCovariate(), covariates=covariates[:2])
    np.testing.assert_allclose(by_stage, [[2.0, 0.0], [4.0, 4.0]])


def test_refuses_covariates_and_names_of_other_paths():
    with pytest.raises(ArgumentError, match="covariates has 1 rows for 2 paths"):
        censoring_weights([1.0, 2.0], [True, True], ByCovariate(), covariates=[[0.5]])
    with pytest.raises(ArgumentError, match=r"path_ids has shape \(1,\) for 2 paths"):
        censoring_weights([1.0, 2.0], [True, True], path_ids=[7])


def test_a_stage_of_a_team_that_takes_no_time_weighs_one():
    clock = np.array([[0.0, 1.0], [0.0, np.nan]])
    weights = stage_weights(clock, np.array([1.0, 0.5]), np.array([True, False]))
    np.testing.assert_allclose(weights, [[1.0, 2.0], [1.0, 0.0]])
