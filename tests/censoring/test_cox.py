"""Cox's model of the cuts: beside lifelines, scikit-survival and loops, and what has no coefficients."""

import tracemalloc

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from lifelines import CoxPHFitter
from oracles import naive_cox
from scipy.optimize import linprog, minimize
from sksurv.linear_model import CoxPHSurvivalAnalysis

from halfseen.censoring import Cox, censoring_weights
from halfseen.errors import ArgumentError

TIES = pytest.mark.parametrize("ties", ["efron", "breslow"])
SEEDS = pytest.mark.parametrize("seed", range(3))


def drawn(seed, n=400, p=3, clock=None):
    """Trajectories whose covariates hasten or delay the cut; `clock` rounds their ends up, so that they tie."""
    rng = np.random.default_rng(seed)
    covariates = rng.normal(size=(n, p))
    own, cut = rng.exponential(1.0, n), rng.exponential(1.5 * np.exp(covariates @ np.linspace(-0.8, 0.6, p)))
    if clock is not None:
        own, cut = np.ceil(own / clock), np.ceil(cut / clock)
    return np.minimum(own, cut), own <= cut, covariates


def cuts_after_finishes(time, is_finished):
    """The same order of whole-numbered ends for a package that lets a finish at s still be at risk of a cut at s."""
    return np.where(is_finished, time, time + 0.5)


def structured(time, is_finished):
    return np.array(list(zip(~is_finished, time, strict=True)), dtype=[("event", bool), ("time", float)])


def scikit_survival(time, is_finished, covariates, ties):
    return CoxPHSurvivalAnalysis(ties=ties, tol=1e-15, n_iter=200).fit(covariates, structured(time, is_finished))


def lifelines(time, is_finished, covariates):
    frame = pd.DataFrame(covariates).assign(time=time, is_cut=~is_finished)
    return CoxPHFitter().fit(frame, "time", "is_cut", fit_options={"precision": 1e-12})


def test_ties_between_finish_and_cut_matter():
    time, is_finished, covariates = drawn(0, clock=0.3)
    wrong = scikit_survival(time, is_finished, covariates, "efron")
    assert np.abs(Cox().fit(time, is_finished, covariates).coefficients_ - wrong.coef_).max() > 1e-3


@pytest.mark.parametrize("clock", [None, 0.3])
def test_coefficients_standard_errors_and_likelihood_equal_lifelines(clock):
    time, is_finished, covariates = drawn(7, clock=clock)
    reference = lifelines(cuts_after_finishes(time, is_finished), is_finished, covariates)
    fitted = Cox().fit(cuts_after_finishes(time, is_finished), is_finished, covariates)
    np.testing.assert_allclose(fitted.coefficients_, reference.params_, rtol=0, atol=1e-8)
    np.testing.assert_allclose(fitted.standard_errors_, reference.standard_errors_, rtol=1e-6)
    assert fitted.log_likelihood_ == pytest.approx(reference.log_likelihood_, rel=1e-10)


@TIES
@SEEDS
@pytest.mark.parametrize("ridge", [0.0, 3.0])
def test_coefficients_maximise_the_loops_on_ties_of_both_kinds_whose_likelihood_and_baseline_they_have(
    ties, seed, ridge
):
    time, is_finished, covariates = drawn(seed, n=40, p=2, clock=0.4)
    fitted, scales = Cox(ties, ridge=ridge).fit(time, is_finished, covariates), covariates.std(axis=0)
    log_likelihood, steps = naive_cox(time, is_finished, covariates, fitted.coefficients_, ties)
    assert fitted.log_likelihood_ == pytest.approx(log_likelihood, rel=1e-12)
    np.testing.assert_array_equal(fitted.times_, list(steps))
    at_zero = fitted.cumulative_hazard_ * np.exp(-fitted.means_ @ fitted.coefficients_)
    np.testing.assert_allclose(at_zero, np.cumsum(list(steps.values())), rtol=1e-12)

    def loss(beta):
        return ridge / 2 * np.square(beta * scales).sum() - naive_cox(time, is_finished, covariates, beta, ties)[0]

    best = minimize(loss, np.zeros(2), tol=1e-10)
    np.testing.assert_allclose(fitted.coefficients_, best.x, rtol=0, atol=1e-5)


@TIES
def test_survival_equals_the_loops_and_is_the_left_limit(ties):
    time, is_finished, covariates = drawn(4, n=60, p=2, clock=0.4)
    fitted = Cox(ties).fit(time, is_finished, covariates)
    _, steps = naive_cox(time, is_finished, covariates, fitted.coefficients_, ties)
    u = np.arange(0.5, 8.5, 0.5)
    for z in covariates[:5]:
        risk = np.exp(z @ fitted.coefficients_)
        expected = [np.exp(-risk * sum(step for s, step in steps.items() if s < v)) for v in u]
        np.testing.assert_allclose(fitted.survival(u, [z]), expected, rtol=1e-12)
    first = fitted.times_[0]
    assert fitted.survival([first], covariates[:1]) == 1.0
    assert fitted.survival([first + 1e-9], covariates[:1]) < 1.0


def test_survival_equals_scikit_survivals_just_before_each_end():
    time, is_finished, covariates = drawn(5)
    reference = scikit_survival(time, is_finished, covariates, "breslow").predict_survival_function(covariates)
    before = np.maximum(np.nextafter(time, 0.0), time.min())
    expected = [1.0 if t == time.min() else curve(b) for curve, b, t in zip(reference, before, time, strict=True)]
    ours = Cox("breslow").fit(time, is_finished, covariates).survival(time, covariates)
    np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-10)


def test_units_and_origin_of_a_covariate_change_nothing():
    time, is_finished, covariates = drawn(6)
    plain = Cox().fit(time, is_finished, covariates)
    moved = covariates * [1e-6, 1.0, 1e6] + [100.0, 1e4, -1e9]
    fitted = Cox().fit(time, is_finished, moved)
    np.testing.assert_allclose(fitted.coefficients_ * [1e-6, 1.0, 1e6], plain.coefficients_, rtol=1e-6)
    np.testing.assert_allclose(fitted.survival(time, moved), plain.survival(time, covariates), rtol=0, atol=1e-7)


def test_weights_recover_a_mean_where_cuts_depend_on_what_delays_the_finish():
    rng = np.random.default_rng(0)
    clutter = rng.binomial(1, 0.5, 40_000).astype(float)
    own, cut = rng.uniform(1.0, 2.0 + 2 * clutter), rng.exponential(4.0 * np.exp(-1.0 * clutter))
    time, is_finished = np.minimum(own, cut), own <= cut
    by_cox = censoring_weights(time, is_finished, "cox", covariates=clutter[:, None])
    alike = censoring_weights(time, is_finished)
    means = [np.average(time, weights=weights) for weights in (by_cox, alike)]
    # A finish is at 1.5 s or at 2.5 s, each half of the time.
    assert means[0] == pytest.approx(2.0, abs=0.03)
    assert abs(means[1] - 2.0) > 0.1


def test_a_far_off_row_has_survival_zero_or_one_and_never_nan():
    time, is_finished, covariates = drawn(3, p=1)
    fitted = Cox().fit(time, is_finished, covariates)
    extreme = fitted.survival([time.min() / 2, time.max(), time.max()], [[1e9], [1e9], [-1e9]])
    np.testing.assert_array_equal(extreme, [1.0, 0.0, 1.0])


@pytest.mark.parametrize("wrap", [pd.DataFrame, lambda table: pa.table(table)])
def test_a_table_keeps_its_names_and_its_order_is_irrelevant(wrap):
    time, is_finished, covariates = drawn(3, p=2)
    table = {"clutter": covariates[:, 0], "speed": covariates[:, 1]}
    turned = {name: table[name] for name in ["speed", "clutter"]}
    fitted = Cox().fit(time, is_finished, wrap(table))
    assert fitted.covariates_ == ["clutter", "speed"]
    np.testing.assert_array_equal(fitted.survival(time, wrap(turned)), fitted.survival(time, covariates))
    with pytest.raises(ArgumentError, match="covariates lacks 'speed'; give the columns of the fit: clutter, speed"):
        fitted.survival(time, wrap({"clutter": covariates[:, 0]}))
    with pytest.raises(ArgumentError, match="covariates has 'age', unknown to the fit"):
        fitted.survival(time, wrap(table | {"age": covariates[:, 0]}))


def test_a_large_fit_needs_no_matrix_for_each_trajectory():
    time, is_finished, covariates = drawn(0, n=10_000, p=20)
    tracemalloc.start()
    Cox().fit(time, is_finished, covariates)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 15 * covariates.nbytes


@TIES
@SEEDS
@pytest.mark.parametrize(
    ("clock", "all_cut"),
    [(None, False), (0.3, False), (None, True)],
    ids=["untied", "tied, once cuts stand after finishes", "all cut"],
)
def test_coefficients_equal_scikit_survivals(ties, seed, clock, all_cut):
    time, is_finished, covariates = drawn(seed, clock=clock)
    is_finished &= not all_cut
    end = time if clock is None else cuts_after_finishes(time, is_finished)
    reference = scikit_survival(end, is_finished, covariates, ties)
    fitted = Cox(ties).fit(time, is_finished, covariates)
    np.testing.assert_allclose(fitted.coefficients_, reference.coef_, rtol=0, atol=1e-10)
    assert fitted.num_cut_ == (~is_finished).sum()


def test_one_row_of_covariates_answers_for_all_times_and_one_per_row_for_a_clock():
    time, is_finished, covariates = drawn(3)
    fitted = Cox().fit(time, is_finished, covariates)
    assert fitted.survival(np.array(0.7), covariates[:1]).shape == ()
    clock = np.stack([time / 2, time], axis=1)
    both = fitted.survival(clock, covariates)
    np.testing.assert_array_equal(both[:, 1], fitted.survival(time, covariates))
    np.testing.assert_array_equal(
        fitted.survival(time, covariates[:1])[3], fitted.survival(time[3:4], covariates[:1])[0]
    )


def hardly_cut():
    z = np.array([[0.3, 1.0], [0.1, -1.0], [0.9, 0.2], [0.2, 0.6], [0.4, -0.3], [0.6, 0.1]])
    return np.arange(1.0, 7.0), np.arange(6) > 0, z


def of_chance(seed=1, n=300, p=1):
    rng = np.random.default_rng(seed)
    return rng.exponential(size=n), rng.random(n) < 0.5, rng.normal(size=(n, p))


def collinear():
    time, is_finished, x = of_chance(0, 200, 3)
    table = {"a": x[:, 0], "b": x[:, 1], "c": x[:, 2], "sum": x[:, 0] + 2 * x[:, 1]}
    return time, is_finished, pd.DataFrame(table)


def separated(column):
    """A second covariate that foretells who is cut."""
    time, is_finished, x = of_chance()
    rare = np.zeros(300)
    rare[np.flatnonzero(is_finished & (time > 0.5))[:3]] = 1.0
    of_kind = {"only one group is cut": ~is_finished, "a rare group is never cut": rare, "the next is foretold": -time}
    return time, is_finished, np.column_stack([x, of_kind[column]])


def long_gone():
    """A covariate that varies only among trajectories that are gone when the first is cut."""
    time, _, z = hardly_cut()
    is_finished = np.array([True, True, False, True, False, False])
    return time, is_finished, np.column_stack([z[:, 0], [1.0, 0, 0, 0, 0, 0]])


WITHOUT_END = r"covariates, column 1: its coefficient diverges.*ridge > 0"


@TIES
@pytest.mark.parametrize(
    ("data", "message"),
    [
        (hardly_cut(), "1 trajectory was cut, too few for 2 covariates"),
        (collinear(), r"covariates a, b, sum are collinear.*leave one out"),
        (long_gone(), "column 1: equal for all trajectories at risk at every cut"),
        (separated("only one group is cut"), WITHOUT_END),
        (separated("a rare group is never cut"), WITHOUT_END),
        (separated("the next is foretold"), WITHOUT_END),
    ],
)
def test_refuses_what_has_no_coefficients_unless_penalised(data, message, ties):
    with pytest.raises(ArgumentError, match=message):
        Cox(ties).fit(*data)
    assert np.isfinite(Cox(ties, ridge=1.0).fit(*data).coefficients_).all()


def is_separated(time, is_finished, covariates):
    """Whether some direction puts every cut trajectory first among those watched, by linear programming."""
    leads = [
        covariates[i] - covariates[j]
        for i in np.flatnonzero(~is_finished)
        for j in range(len(time))
        if j != i and (time[j] > time[i] or (time[j] == time[i] and not is_finished[j]))
    ]
    if not leads:
        return False
    best = linprog(-np.sum(leads, axis=0), A_ub=-np.array(leads), b_ub=np.zeros(len(leads)), bounds=(-1, 1))
    return -best.fun > 1e-9


@TIES
@pytest.mark.slow
def test_refuses_exactly_those_whose_likelihood_has_no_maximum(ties):
    rng = np.random.default_rng(0)
    found = {True: 0, False: 0}
    for _ in range(300):
        n, p = rng.integers(6, 20), rng.integers(1, 3)
        time, is_finished = rng.integers(1, 12, n).astype(float), rng.random(n) < 0.7
        covariates = rng.integers(0, 3, (n, p)).astype(float) if rng.random() < 0.5 else rng.normal(size=(n, p))
        try:
            Cox(ties).fit(time, is_finished, covariates)
            refused = False
        except ArgumentError as error:
            if "its coefficient diverges" not in str(error):
                continue
            refused = True
        assert refused == is_separated(time, is_finished, covariates)
        found[refused] += 1
    assert min(found.values()) > 20
