"""Ĝ by trajectory, by stage and pooled, on arrays: products over stages by a loop, and what is refused."""

import numpy as np
import pytest
from oracles import naive_survival

from halfseen.censoring import CensoringSpec, Cox, KaplanMeier, StageClocks, stage_weights
from halfseen.errors import ArgumentError, PositivityError


@pytest.fixture(scope="module")
def clocks():
    """Trajectories of one or two stages of whole seconds, cut at a whole second: ties abound."""
    rng = np.random.default_rng(0)
    num_trajectories = 200
    clock = rng.integers(1, 4, size=(num_trajectories, 2)).cumsum(axis=1)
    exists = np.arange(2) < rng.integers(1, 3, size=num_trajectories)[:, None]
    own_end, cut_s = np.where(exists, clock, 0).max(axis=1), rng.integers(2, 10, size=num_trajectories) - 1.0
    is_completed = exists & (clock <= cut_s[:, None])
    begun_at = np.pad(clock[:, :1], ((0, 0), (1, 0)))
    return StageClocks(
        trajectory_ids=np.arange(num_trajectories),
        elapsed_s=np.where(is_completed, clock, np.nan),
        end_s=np.minimum(own_end, cut_s),
        is_finished=own_end <= cut_s,
        is_begun=exists & (begun_at <= cut_s[:, None]) & (np.arange(2) <= is_completed.sum(axis=1)[:, None]),
        covariates=rng.normal(size=(num_trajectories, 2, 2)),
        covariate_names=("x", "z"),
    )


def ages(clocks):
    """Path, stage, how long the stage was watched [s], and whether it was completed."""
    rows = []
    for trajectory, stage in zip(*np.nonzero(clocks.is_begun), strict=True):
        began = clocks.elapsed_s[trajectory, stage - 1] if stage else 0.0
        is_completed = not np.isnan(clocks.elapsed_s[trajectory, stage])
        until = clocks.elapsed_s[trajectory, stage] if is_completed else clocks.end_s[trajectory]
        # A stage that is cut as it begins is watched for no time at all.
        rows.append((trajectory, stage, max(until - began, 1e-9), is_completed))
    return rows


@pytest.mark.parametrize("by", ["stage", "pooled"])
def test_weights_are_products_over_stages_by_a_loop(clocks, by):
    rows, weights, survival = ages(clocks), np.zeros((200, 2)), {}
    assert {age for *_, age, done in rows if done} & {age for *_, age, done in rows if not done}, "there are ties"
    for trajectory, stage, age, is_completed in rows:
        others = [row[2:] for row in rows if by == "pooled" or row[1] == stage]
        if is_completed:
            survival[trajectory] = survival.get(trajectory, 1.0) * naive_survival(*zip(*others, strict=True), age)
            weights[trajectory, stage] = 1.0 / survival[trajectory]
    np.testing.assert_allclose(CensoringSpec(by=by).fit_cuts(clocks).weights(clocks), weights, rtol=1e-12)


def test_by_trajectory_it_is_the_trajectories_own_clock(clocks):
    expected = stage_weights(clocks.elapsed_s, clocks.end_s, clocks.is_finished)
    np.testing.assert_array_equal(CensoringSpec().fit_cuts(clocks).weights(clocks), expected)


def test_a_fitted_model_is_taken_as_it_is(clocks):
    age, is_completed = (np.array(column) for column in list(zip(*ages(clocks), strict=True))[2:])
    fitted = CensoringSpec(KaplanMeier().fit(age, is_completed), by="pooled").fit_cuts(clocks)
    expected = CensoringSpec(by="pooled").fit_cuts(clocks).weights(clocks)
    np.testing.assert_allclose(fitted.weights(clocks), expected, rtol=1e-12)


def test_begun_weights_are_those_of_the_stage_before(clocks):
    model = CensoringSpec(by="stage").fit_cuts(clocks)
    begun, came_on = model.begun_weights(clocks), clocks.is_begun[:, 1]
    assert set(begun[:, 0]) == {1.0}
    np.testing.assert_array_equal(begun[:, 1] > 0, came_on)
    np.testing.assert_array_equal(begun[came_on, 1], model.weights(clocks)[came_on, 0])


@pytest.mark.parametrize("by", ["trajectory", "pooled"])
def test_survival_within_a_stage_falls_from_one_to_what_its_weight_says(clocks, by):
    model = CensoringSpec(Cox(ridge=0.1), by=by).fit_cuts(clocks)
    steps = np.linspace(0.0, 1.0, 5) * clocks.watched_s[..., None]
    within = model.survival(clocks, steps, clocks.is_begun)
    assert (within[..., 0] == 1.0).all()
    assert (np.diff(within, axis=-1) <= 1e-12).all()
    seen = clocks.is_completed
    np.testing.assert_allclose(within[seen][:, -1], model.begun_weights(clocks)[seen] / model.weights(clocks)[seen])


def test_a_stage_that_nothing_outlived_is_not_identified(clocks):
    gone = KaplanMeier().fit([0.5, 1.5], [True, False])
    with pytest.raises(
        PositivityError, match=r"trajectory \d+, stage 1: completed \d s after it began, where the censoring"
    ):
        CensoringSpec(gone, by="stage").fit_cuts(clocks).weights(clocks)
    truncated = CensoringSpec(gone, by="stage", truncate_at=3.0).fit_cuts(clocks)
    assert truncated.weights(clocks).max() == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"by": "clock"}, "by is 'clock'; it is 'trajectory', 'stage' or 'pooled'"),
        ({"model": "weibull"}, "censoring is 'weibull'; it is 'kaplan-meier', 'cox', 'kernel'"),
        ({"covariates": ["x"]}, r"covariates is \['x'\], but kaplan-meier uses none"),
    ],
)
def test_what_a_specification_cannot_mean_is_refused(options, message):
    with pytest.raises(ArgumentError, match=message):
        CensoringSpec(**options)
