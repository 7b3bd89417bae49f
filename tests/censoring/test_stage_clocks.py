"""Ĝ by trajectory, by stage and pooled: products over stages by a loop; and ticks that rounding has moved."""

import numpy as np
import pytest
from oracles import naive_survival

from halfseen.censoring import (
    CensoringSpec,
    Cox,
    KaplanMeier,
    KernelKaplanMeier,
    StageClocks,
    censoring_weights,
    stage_weights,
)
from halfseen.censoring.clocks import clock_tolerance_s, tied
from halfseen.errors import ArgumentError, PositivityError
from halfseen.learning import CensoredSVC, CensoredSVR


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
        ({"by": "clock"}, "by is 'clock'; give 'trajectory', 'stage' or 'pooled'"),
        ({"model": "weibull"}, "censoring is 'weibull'; give 'kaplan-meier', 'cox', 'kernel'"),
        ({"covariates": ["x"]}, r"covariates is \['x'\], but kaplan-meier uses none"),
    ],
)
def test_what_a_specification_cannot_mean_is_refused(options, message):
    with pytest.raises(ArgumentError, match=message):
        CensoringSpec(**options)


N = 400
RNG = np.random.default_rng(0)
FINISH, CUT = RNG.integers(1, 60, N), RNG.integers(1, 80, N)
TICKS, IS_FINISHED = np.minimum(FINISH, CUT), FINISH <= CUT
CLUTTER = RNG.random((N, 1))


def added(ticks, tick_s):
    return np.cumsum(np.full(100, tick_s))[ticks - 1]


def between_dates(ticks, rng):
    """Seconds since 1970 of the begin and the end, both read from decimals."""
    begin = rng.integers(0, 10**6, len(ticks))
    dates = [[float(f"{1.7e9 + k / 10:.1f}") for k in each] for each in (begin, begin + ticks)]
    return np.subtract(dates[1], dates[0])


def of_robots(ticks, rng):
    """Seconds since a robot was switched on, up to a week ago."""
    on_s = 6e5 * rng.random(len(ticks))
    return (on_s + 0.1 * ticks) - on_s


def half(rng, one, other):
    return np.where(rng.random(len(one)) < 0.5, one, other)


ROUNDED = {
    "added up": lambda k, rng: half(rng, added(k, 0.1), 0.1 * k),
    "thirtieths": lambda k, rng: half(rng, added(k, 1 / 30), k / 30),
    "milliseconds": lambda k, rng: half(rng, added(k, 0.001), k / 1000),
    "single precision": lambda k, rng: half(rng, np.float32(0.1) * k.astype(np.float32), 0.1 * k),
    "added up in single precision": lambda k, rng: half(rng, added(k, np.float32(0.1)), 0.1 * k),
    "dates": between_dates,
    "since switched on": of_robots,
}


@pytest.fixture(params=ROUNDED, scope="module")
def rounded(request):
    time = ROUNDED[request.param](TICKS, np.random.default_rng(1)).astype(np.float64)
    assert len(np.unique(time)) > len(np.unique(TICKS))
    return time


@pytest.fixture(scope="module")
def by_loop():
    """Weights by the loop on whole ticks."""
    survival = {tick: naive_survival(TICKS.tolist(), IS_FINISHED.tolist(), tick) for tick in set(TICKS.tolist())}
    return IS_FINISHED / [survival[tick] for tick in TICKS.tolist()]


def test_kaplan_meier(rounded, by_loop):
    np.testing.assert_allclose(censoring_weights(rounded, IS_FINISHED), by_loop, rtol=1e-12)


@pytest.mark.parametrize("model", [Cox(), Cox(ties="breslow"), KernelKaplanMeier(bandwidth=0.5)])
def test_models_with_covariates(rounded, model):
    mine, whole = (censoring_weights(t, IS_FINISHED, model, covariates=CLUTTER) for t in (rounded, TICKS))
    np.testing.assert_allclose(mine, whole, rtol=1e-9)


@pytest.mark.parametrize("name", ["single precision", "added up in single precision", "dates"])
def test_a_clock_of_few_ticks(name):
    rng = np.random.default_rng(5)
    ticks = rng.integers(1, 4, N)
    time = ROUNDED[name](ticks, rng).astype(np.float64)
    found, whole = (KaplanMeier().fit(t, IS_FINISHED).survival(t) for t in (time, ticks))
    np.testing.assert_allclose(found, whole, rtol=1e-12)


def test_a_time_asked_about_may_be_off_too(rounded):
    curve = KaplanMeier().fit(rounded, IS_FINISHED)
    off = rounded + curve.tolerance_s_ / 10.0 * np.random.default_rng(2).uniform(-1.0, 1.0, N)
    assert (off != rounded).any()
    whole = KaplanMeier().fit(TICKS, IS_FINISHED).survival(TICKS)
    np.testing.assert_allclose(curve.survival(off), whole, rtol=1e-12)


def clocks_of(steps, scale):
    """Two stages a trajectory; `scale` puts whole ticks on the clock."""
    ends = np.cumsum(steps, axis=1)
    is_cut = RNG_STAGES.random(len(steps)) < 0.3
    is_second = ~is_cut | (np.arange(len(steps)) % 2 == 0)
    elapsed = np.stack([scale(ends[:, 0]), scale(ends[:, 1])], axis=1)
    elapsed[is_cut, 1] = np.nan
    elapsed[~is_second, 0] = np.nan
    end_s = np.where(is_cut & ~is_second, scale(ends[:, 0]), scale(ends[:, 1]))
    is_begun = np.stack([np.ones(len(steps), dtype=bool), is_second], axis=1)
    nothing = np.zeros((*is_begun.shape, 0))
    return StageClocks(np.arange(len(steps)), elapsed, end_s, ~is_cut, is_begun, nothing, ())


RNG_STAGES = np.random.default_rng(3)
STEPS = RNG_STAGES.integers(1, 9, (N, 2))


@pytest.mark.parametrize("by", ["trajectory", "stage", "pooled"])
@pytest.mark.parametrize("name", ["added up", "dates", "since switched on", "single precision"])
def test_clocks_of_stages(by, name):
    found = []
    for scale in (np.float64, lambda k: ROUNDED[name](k, np.random.default_rng(k.sum())).astype(np.float64)):
        RNG_STAGES.bit_generator.state = np.random.default_rng(4).bit_generator.state
        clocks = clocks_of(STEPS, scale)
        found.append(CensoringSpec(by=by, truncate_at=50.0).fit_cuts(clocks).weights(clocks))
    np.testing.assert_allclose(found[1], found[0], rtol=1e-9)


def test_a_last_stage_may_end_a_rounding_after_its_trajectory():
    clock, end_s = [[0.1, 0.1 + 0.2], [0.1, np.nan], [0.1, 0.4]], [0.3, 0.3, 0.4]
    whole = stage_weights([[1.0, 3.0], [1.0, np.nan], [1.0, 4.0]], [3.0, 3.0, 4.0], [True, False, True])
    np.testing.assert_allclose(stage_weights(clock, end_s, [True, False, True]), whole)


@pytest.mark.slow
def test_the_event_by_tau(rounded):
    tick_s = rounded[TICKS == 10].min() / 10
    some = slice(0, 40)
    for kind, more in ((CensoredSVC, {"calibrate": False}), (CensoredSVR, {})):
        machine = kind(tau=15 * tick_s, reg=0.1, **more)
        whole = machine.__class__(**machine.get_params() | {"tau": 15.0})
        mine = machine.fit(CLUTTER[some], (rounded[some], IS_FINISHED[some]))
        whole.fit(CLUTTER[some], (TICKS[some].astype(float), IS_FINISHED[some]))
        np.testing.assert_allclose(mine.weights_, whole.weights_, rtol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_times_that_fall_anywhere_stay_apart(seed):
    time = np.random.default_rng(seed).exponential(10.0, 3000)
    assert clock_tolerance_s(time) < 1e-10
    np.testing.assert_array_equal(tied(time)[0], time)


def test_ticks_among_times_that_fall_anywhere():
    """Operators cut at any time; what ends by itself does so at a tick."""
    rng = np.random.default_rng(5)
    time = between_dates(TICKS, rng)
    anywhere = ~IS_FINISHED & (rng.random(N) < 0.3)
    time[anywhere] += 0.05 * rng.random(anywhere.sum())
    exact = np.where(anywhere, time, 0.1 * TICKS)
    np.testing.assert_allclose(censoring_weights(time, IS_FINISHED), censoring_weights(exact, IS_FINISHED), rtol=1e-12)


@pytest.mark.parametrize(
    "time", [[1.0, 1.000001, 5.0], [1.0, 2.0, 2.0, 3.0], [3.0], [3.0, 3.0], [1e-6, 2e-6, 3e-6], [1.0, 2.0, 1e8]]
)
def test_times_that_differ_stay_apart(time):
    time = np.array(time)
    np.testing.assert_array_equal(tied(time)[0], time)


def test_trajectories_that_all_take_as_long():
    time = np.array([0.3, 0.1 + 0.2, 0.3, 0.1 + 0.2])
    assert censoring_weights(time, [False, True, True, False]).max() == 1.0


def test_a_time_asked_about_may_be_added_up_where_no_time_of_the_fit_was():
    fits = (
        KaplanMeier().fit([0.3, 0.7], [False, True]),
        Cox(ridge=1.0).fit([0.3, 0.7], [False, True], [[0.0], [1.0]]),
        KernelKaplanMeier(bandwidth=1.0).fit([0.3, 0.7], [False, True], [[0.0], [1.0]]),
    )
    for curve in fits:
        known = [[0.0]] if curve.uses_covariates else None
        assert curve.survival([0.1 + 0.2], known) == [1.0]
        assert curve.survival([0.3001], known) < 1.0
