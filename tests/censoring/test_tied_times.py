"""Ticks that rounding has moved: every model, every clock, and the event by τ, as with whole ticks."""

import numpy as np
import pytest

from halfseen.censoring import Cox, KaplanMeier, KernelKaplanMeier, censoring_weights, stage_weights
from halfseen.censoring.clocks import StageClocks, clock_tolerance_s, tied
from halfseen.censoring.cut_model import CensoringSpec
from halfseen.learning import CensoredSVC, CensoredSVR

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


def naive_weights(ticks, is_finished):
    """Product limit on whole ticks, one loop."""
    weights = np.zeros(len(ticks))
    for i in np.flatnonzero(is_finished):
        survival = 1.0
        for s in range(1, ticks[i]):
            watched = (ticks > s).sum() + ((ticks == s) & ~is_finished).sum()
            survival *= 1.0 - ((ticks == s) & ~is_finished).sum() / watched if watched else 1.0
        weights[i] = 1.0 / survival
    return weights


def test_kaplan_meier(rounded):
    weights = censoring_weights(rounded, IS_FINISHED)
    np.testing.assert_allclose(weights, naive_weights(TICKS, IS_FINISHED), rtol=1e-12)


@pytest.mark.parametrize("model", [Cox(), Cox(ties="breslow"), KernelKaplanMeier(bandwidth=0.5)])
def test_models_with_covariates(rounded, model):
    mine, whole = (censoring_weights(t, IS_FINISHED, model, covariates=CLUTTER) for t in (rounded, TICKS))
    np.testing.assert_allclose(mine, whole, rtol=1e-9)


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


def test_the_event_by_tau(rounded):
    tick_s = rounded[TICKS == 10].min() / 10
    some = slice(0, 40)
    for machine in (CensoredSVC(tau=15 * tick_s), CensoredSVR(tau=15 * tick_s)):
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
