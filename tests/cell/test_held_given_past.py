"""The regression as a predictor: beside adaptive quadrature, and shares beside a naive loop and an exact interval."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import expit
from scipy.stats import binomtest, norm

from attempt_logs import TRUTH, attempt_log
from halfseen.cell.calibration.clustered_share import clustered_share, wilson
from halfseen.cell.calibration.grasp_fit import CENTRES, SCALES, design
from halfseen.cell.calibration.held_given_past import held_given_past, held_share
from halfseen.cell.calibration.trials import trials


def naive(theta, trials, number):
    """One attempt's probability, by two adaptive integrals over its object's offset."""
    row = trials.iloc[number]
    past = trials[(trials["object"] == row["object"]) & (trials["stage"] < row["stage"])]

    def log_odds(of, z):
        x = [1.0, of["occlusion"], *((of[name] - CENTRES[name]) / SCALES[name] for name in CENTRES)]
        return np.dot(theta[:-1], x) + np.exp(theta[-1]) * z

    def seen(z):
        told = [expit((1 if each["succeeded"] else -1) * log_odds(each, z)) for _, each in past.iterrows()]
        return float(np.prod(told)) * norm.pdf(z)

    held = quad(lambda z: seen(z) * expit(log_odds(row, z)), -10, 10, epsabs=1e-13, epsrel=1e-11)[0]
    return held / quad(seen, -10, 10, epsabs=1e-13, epsrel=1e-11)[0]


def test_the_next_attempt_is_predicted_as_by_integrals_over_the_offset():
    tried = trials(attempt_log(12, num_objects=2, cut_rate=0.005), 12)
    assert not tried["is_finished"].all()
    for theta in (TRUTH, TRUTH * np.array([0.2, 1.0, 1.0, 1.0, 1.0, -2.0])):
        said = held_given_past(theta, tried)
        for number in range(0, len(tried), 3):
            assert said[number] == pytest.approx(naive(theta, tried, number), abs=2e-4)


def test_the_order_of_rows_is_irrelevant_and_later_attempts_tell_nothing():
    tried = trials(attempt_log(10), 12)
    said = held_given_past(TRUTH, tried)
    order = np.random.default_rng(0).permutation(len(tried))
    np.testing.assert_allclose(held_given_past(TRUTH, tried.iloc[order]), said[order], rtol=1e-12)
    early = tried["stage"] <= 3
    np.testing.assert_allclose(held_given_past(TRUTH, tried[early]), said[early.to_numpy()], rtol=1e-12)


def naive_variance(held, predicted, weight, tables):
    share = np.average(held, weights=weight) - np.average(predicted, weights=weight)
    names, total = sorted(set(tables)), 0.0
    for name in names:
        residual = 0.0
        for k in range(len(held)):
            if tables[k] == name:
                residual += weight[k] * (held[k] - predicted[k] - share)
        total += residual**2
    return len(names) / (len(names) - 1) * total / sum(weight) ** 2


def test_a_share_has_the_interval_of_as_many_attempts_as_its_tables_allow():
    rng = np.random.default_rng(1)
    tables = rng.integers(0, 9, 80)
    held, predicted, weight = rng.random(80) < 0.5 + 0.06 * tables, rng.uniform(0.6, 0.9, 80), rng.uniform(1.0, 2.0, 80)
    share = clustered_share(held, predicted, weight, tables)
    mean = np.average(held, weights=weight)
    size = mean * (1 - mean) / naive_variance(held, predicted, weight, tables)
    assert size < 80
    assert (share.held, share.predicted) == pytest.approx((mean, np.average(predicted, weights=weight)))
    assert (share.low, share.high) == pytest.approx(wilson(mean, size))
    assert (share.num_attempts, share.num_tables) == (80, 9)


@pytest.mark.parametrize(("num_held", "num"), [(0, 7), (7, 7), (3, 20), (97, 100)])
def test_intervals_of_independent_attempts_are_those_of_wilson(num_held, num):
    known = binomtest(num_held, num).proportion_ci(method="wilson")
    assert wilson(num_held / num, float(num)) == pytest.approx((known.low, known.high), abs=1e-12)


def test_where_all_held_a_share_is_known_no_better_than_from_one_attempt_a_table():
    tables = np.repeat(np.arange(5), 20)
    # Of such weights the sum differs in its last digit from the sum over those that held.
    weight, said = np.random.default_rng(0).uniform(1.0, 2.0, 100), np.full(100, 0.9)
    share = clustered_share(np.ones(100, dtype=bool), said, weight, tables)
    assert (share.held, share.high) == (1.0, 1.0)
    assert share.low == pytest.approx(wilson(1.0, 5.0)[0])
    none = clustered_share(np.zeros(100, dtype=bool), said, weight, tables)
    assert (none.held, none.low, none.high) == pytest.approx((0.0, 0.0, 1.0 - share.low))


@pytest.mark.slow
def test_intervals_hold_the_truth_where_attempts_of_a_table_are_alike():
    rng, inside = np.random.default_rng(2), []
    for _ in range(400):
        of_table = expit(2.5 + rng.normal(0.0, 1.0, 100))
        tables = np.repeat(np.arange(100), 6)
        held = rng.random(600) < of_table[tables]
        share = clustered_share(held, np.zeros(600), np.ones(600), tables)
        truth = quad(lambda z: expit(2.5 + z) * norm.pdf(z), -8, 8)[0]
        inside.append(share.low < truth < share.high)
    print("held the truth:", np.mean(inside))
    assert np.mean(inside) > 0.92


def test_a_first_attempt_knows_no_offset():
    tried = trials(attempt_log(10), 12)
    firsts = tried[(tried["successes"] == 0) & (tried["failures"] == 0)]
    np.testing.assert_allclose(held_given_past(TRUTH, firsts), held_share(TRUTH, design(firsts)), rtol=1e-12)
