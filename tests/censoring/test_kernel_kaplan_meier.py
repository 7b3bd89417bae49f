import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import naive_local_survival, tied_ends

from halfseen.censoring import KaplanMeier, KernelKaplanMeier, censoring_weights
from halfseen.censoring import kernel_kaplan_meier as local_curve_module
from halfseen.errors import PositivityError


def drawn(seed, n=60, p=2, clock=0.4):
    rng = np.random.default_rng(seed)
    covariates = rng.normal(size=(n, p)) * [1.0, 50.0][:p] + 7.0
    own = np.ceil(rng.exponential(1.0, n) / clock)
    cut = np.ceil(rng.exponential(np.exp(covariates[:, 0] - 7.0)) / clock)
    return np.minimum(own, cut), own <= cut, covariates


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("bandwidth", [0.4, 1.0, 3.0])
def test_equals_the_loops_on_ties_of_both_kinds(seed, bandwidth):
    time, is_finished, covariates = drawn(seed)
    scaled = (covariates - covariates.mean(axis=0)) / covariates.std(axis=0)
    ours = KernelKaplanMeier(bandwidth).fit(time, is_finished, covariates).survival(time, covariates)
    expected = [
        naive_local_survival(time, is_finished, scaled, u, z, bandwidth) for u, z in zip(time, scaled, strict=True)
    ]
    np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-12)


@given(tied_ends(min_size=2), st.sampled_from([np.inf, 1e12]), st.sampled_from(["gaussian", "epanechnikov"]))
def test_a_bandwidth_without_end_is_exactly_kaplan_meier(ends, bandwidth, kernel):
    time, is_finished = ends
    covariates = np.arange(len(time), dtype=float)[:, None]
    u = np.array([0.5, 1.0, 2.0, 2.5, 6.0, 9.0])
    local = KernelKaplanMeier(bandwidth, kernel).fit(time, is_finished, covariates)
    np.testing.assert_array_equal(local.survival(u, [[0.3]]), KaplanMeier().fit(time, is_finished).survival(u))


def test_a_narrow_bandwidth_is_kaplan_meier_of_each_group():
    time, is_finished, _ = drawn(0)
    group = np.arange(len(time)) % 2
    local = KernelKaplanMeier(0.05).fit(time, is_finished, group[:, None])
    for g in (0, 1):
        own = KaplanMeier().fit(time[group == g], is_finished[group == g])
        u = np.linspace(0.5, own.last_time_, 20)
        np.testing.assert_allclose(local.survival(u, [[float(g)]]), own.survival(u), rtol=0, atol=1e-14)


def test_epanechnikov_looks_no_further_than_its_bandwidth():
    time, is_finished = np.array([1.0, 2.0, 3.0, 4.0]), np.array([False, False, True, True])
    local = KernelKaplanMeier(1.0, "epanechnikov").fit(time, is_finished, [[0.0], [3.0], [0.1], [3.1]])
    # Near 0 are trajectories 0 (distance 0) and 2 (0.1/1.5008 standard deviations); trajectory 1 is out of reach.
    near = 1 - (0.1 / np.std([0.0, 3.0, 0.1, 3.1])) ** 2
    np.testing.assert_allclose(local.survival([3.0], [[0.0]]), [near / (1 + near)], rtol=1e-12)


def test_a_question_out_of_reach_is_refused_by_row_and_time():
    time, is_finished, covariates = drawn(1, p=1)
    local = KernelKaplanMeier(0.3).fit(time, is_finished, covariates)
    with pytest.raises(
        PositivityError, match=r"covariates, row 1: no trajectory near it.*before 4 s.*larger bandwidth"
    ):
        local.survival([4.0, 4.0], [[7.0], [1000.0]])
    # Before the first cut there is nothing to estimate.
    np.testing.assert_array_equal(local.survival(local.times_[:1], [[1000.0]]), [1.0])


def test_a_trajectory_always_reaches_itself():
    time, is_finished, covariates = drawn(2)
    weights = censoring_weights(time, is_finished, KernelKaplanMeier(1e-9), covariates=covariates)
    np.testing.assert_array_equal(weights, is_finished.astype(float))


@settings(deadline=None)
@given(st.integers(1, 200))
def test_blocks_change_nothing(block_size):
    time, is_finished, covariates = drawn(3)
    local = KernelKaplanMeier(0.5).fit(time, is_finished, covariates)
    whole = local.survival(time, covariates)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(local_curve_module, "BLOCK_SIZE", block_size)
        np.testing.assert_array_equal(local.survival(time, covariates), whole)


def cut_by_group(n, effect, seed=0):
    rng = np.random.default_rng(seed)
    z = rng.normal(size=(n, 1))
    own, cut = rng.exponential(2.0, n), rng.exponential(np.exp(effect * z[:, 0]))
    return np.minimum(own, cut), own <= cut, z


def test_cross_validation_looks_closer_where_covariates_matter_and_away_where_not():
    blind = KernelKaplanMeier().fit(*cut_by_group(600, 0.0))
    keen = KernelKaplanMeier().fit(*cut_by_group(600, 2.0))
    assert blind.bandwidth_ >= 1.8
    assert keen.bandwidth_ <= 0.56
    assert keen.cv_scores_[keen.bandwidth_] == max(keen.cv_scores_.values())


def test_cross_validated_bandwidth_is_near_the_best_against_the_truth():
    time, is_finished, z = cut_by_group(800, 1.0)
    truth = np.exp(-time * np.exp(-z[:, 0]))

    def error(bandwidth):
        return np.square(KernelKaplanMeier(bandwidth).fit(time, is_finished, z).survival(time, z) - truth).mean()

    fitted = KernelKaplanMeier().fit(time, is_finished, z)
    errors = {width: error(width) for width in fitted.cv_scores_}
    assert errors[fitted.bandwidth_] <= 1.5 * min(errors.values())
    assert max(errors.values()) > 3 * errors[fitted.bandwidth_]


def test_seed_decides_the_folds_and_the_global_one_does_not():
    data = cut_by_group(200, 1.0)
    scores = []
    for seed, random_state in [(1, 0), (2, 0), (1, 3)]:
        np.random.seed(seed)  # noqa: NPY002
        scores.append(KernelKaplanMeier(random_state=random_state).fit(*data).cv_scores_)
    assert scores[0] == scores[1] != scores[2]


def test_weights_recover_a_mean_that_a_line_cannot():
    """Cuts come sooner in the middle, and finishes later: no log-linear hazard says so."""
    rng = np.random.default_rng(0)
    z = rng.uniform(-1.0, 1.0, (2000, 1))
    is_middle = np.abs(z[:, 0]) < 0.5
    own, cut = rng.uniform(1.0, np.where(is_middle, 4.0, 2.0)), rng.exponential(np.where(is_middle, 2.5, 10.0))
    time, is_finished = np.minimum(own, cut), own <= cut
    means = {
        model: np.average(time, weights=censoring_weights(time, is_finished, model, covariates=z))
        for model in ("kernel", "cox")
    }
    # A finish is at 1.5 s or at 2.5 s, each half of the time.
    assert means["kernel"] == pytest.approx(2.0, abs=0.06)
    assert abs(means["cox"] - 2.0) > 0.1


def test_memory_stays_bounded():
    time, is_finished, covariates = drawn(0, n=3000)
    local = KernelKaplanMeier(0.5).fit(time, is_finished, covariates)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(local_curve_module, "BLOCK_SIZE", 100_000)
        tracemalloc.start()
        local.survival(time, covariates)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    # All questions by all trajectories would take 72 MB.
    assert peak < 10e6


def test_equal_questions_and_a_clock_answer_like_one_by_one():
    time, is_finished, covariates = drawn(4)
    local = KernelKaplanMeier(0.5).fit(time, is_finished, covariates)
    rows = np.array([5, 5, 0, 5, 9])
    singly = [local.survival(time[i : i + 1], covariates[r : r + 1])[0] for i, r in enumerate(rows)]
    np.testing.assert_array_equal(local.survival(time[:5], covariates[rows]), singly)
    clock = np.stack([time / 2, time], axis=1)
    np.testing.assert_array_equal(local.survival(clock, covariates)[:, 1], local.survival(time, covariates))
