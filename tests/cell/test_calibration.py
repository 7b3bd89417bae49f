"""Laws from attempts and labels, and shares that held: beside naive likelihoods, and beside the truth of the data."""

from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import quad
from scipy.optimize import minimize
from scipy.special import expit
from scipy.stats import binomtest, norm

from attempt_logs import TRUTH as TRUTH_OF_LOGS
from attempt_logs import attempt_log
from halfseen.cell.calibration.attempts import clustered_share, trials, wilson
from halfseen.cell.calibration.figures import Count, counted
from halfseen.cell.calibration.fits import (
    CENTRES,
    SCALES,
    VIEWS,
    design,
    fit_grasping,
    fit_times,
    found_by,
    held_given_past,
    held_share,
    intervals,
)
from halfseen.perception.labels import FACING_SHARE
from halfseen.world.seeing import PersistentSeeing

TRUTH = np.array([2.0, -1.0, -1.5, -0.4, 0.3, np.log(0.8)])
OFFSETS = np.linspace(-10.0, 10.0, 4001)
"""Standard normal offsets of an object, so close that the sum over them is the integral to twelve digits."""
DENSITY = norm.pdf(OFFSETS) * (OFFSETS[1] - OFFSETS[0])


def row_of(facts):
    """1, hidden share and scaled facts of an attempt."""
    return np.array([1.0, facts["occlusion"], *((facts[name] - CENTRES[name]) / SCALES[name] for name in CENTRES)])


def drawn_trials(num_objects, seed, tries=3, cut_rate=0.02):
    """Attempts by the model itself, cut at random; objects of one table are cut together."""
    rng = np.random.default_rng(seed)
    rows = []
    for number in range(num_objects):
        facts = {"is_lying": float(rng.random() < 0.3), "width_m": rng.normal(0.075, 0.015), "room_m": 0.05}
        facts["room_m"] = float(rng.uniform(0.0, 0.1))
        offset, successes, failures = np.exp(TRUTH[-1]) * rng.normal(), 0, 0
        for _ in range(tries):
            facts["occlusion"] = float(rng.uniform(0.0, 0.8))
            held = bool(rng.random() < expit(TRUTH[:-1] @ row_of(facts) + offset))
            attempt_s = float(np.exp(rng.normal(2.0 if held else 1.5, 0.1)))
            time_s, cut_s = attempt_s + 5.0, rng.exponential(1 / cut_rate)
            rows.append(
                {"trajectory": number // 6, "object": number, **facts, "successes": successes, "failures": failures}
                | {"succeeded": held, "attempt_s": attempt_s}
                | {"time_s": min(time_s, cut_s), "is_finished": time_s <= cut_s}
            )
            if time_s > cut_s:
                rows[-1] |= {"succeeded": None, "attempt_s": np.nan}
                break
            successes, failures = successes + held, failures + (not held)
    return pd.DataFrame(rows)


def log_odds(theta, rows):
    """Of attempts (rows), by the offset of their object (columns)."""
    return np.array([row_of(row) @ theta[:-1] for row in rows])[:, None] + np.exp(theta[-1]) * OFFSETS


def likelihood(theta, rows):
    """Of the outcomes of attempts at one object, by its offset."""
    sign = np.array([1.0 if row["succeeded"] else -1.0 for row in rows])
    return np.prod(expit(sign[:, None] * log_odds(theta, rows)), axis=0) if rows else np.ones(len(OFFSETS))


def test_the_regression_is_the_maximum_of_its_likelihood():
    tried = drawn_trials(30, 0, cut_rate=1e-9)
    of_object = [rows.to_dict("records") for _, rows in tried.groupby("object")]

    def objective(theta):
        """Minus the penalised log-likelihood, object by object; nothing was cut."""
        prior = norm.logpdf(theta, [0, 0, 0, 0, 0, np.log(0.5)], [5, 5, 5, 2, 2, 1]).sum()
        return -sum(np.log(likelihood(theta, rows) @ DENSITY) for rows in of_object) - prior

    found = fit_grasping(tried, "none").estimate
    best, rng = objective(found), np.random.default_rng(1)
    for _ in range(12):
        assert objective(found + 0.05 * rng.normal(size=6)) > best - 1e-6


def test_the_next_attempt_is_predicted_as_by_integrals_over_the_offset():
    tried = trials(attempt_log(12, num_objects=2, cut_rate=0.005), 12)
    assert not tried["is_finished"].all()
    rows = tried.to_dict("records")
    for theta in (TRUTH_OF_LOGS, TRUTH_OF_LOGS * np.array([0.2, 1.0, 1.0, 1.0, 1.0, -2.0])):
        said = held_given_past(theta, tried)
        for number in range(0, len(tried), 3):
            now = rows[number]
            past = [row for row in rows if row["object"] == now["object"] and row["stage"] < now["stage"]]
            posterior = likelihood(theta, past) * DENSITY
            expected = posterior @ expit(log_odds(theta, [now])[0]) / posterior.sum()
            assert said[number] == pytest.approx(expected, abs=2e-4)


def test_order_is_irrelevant_later_attempts_tell_nothing_and_a_first_one_knows_no_offset():
    tried = trials(attempt_log(10), 12)
    said = held_given_past(TRUTH_OF_LOGS, tried)
    order, early = np.random.default_rng(0).permutation(len(tried)), (tried["stage"] <= 3).to_numpy()
    for rows in (order, np.flatnonzero(early)):
        np.testing.assert_allclose(held_given_past(TRUTH_OF_LOGS, tried.iloc[rows]), said[rows], rtol=1e-12)
    firsts = tried[(tried["successes"] == 0) & (tried["failures"] == 0)]
    alone = held_share(TRUTH_OF_LOGS, design(firsts))
    np.testing.assert_allclose(held_given_past(TRUTH_OF_LOGS, firsts), alone, rtol=1e-12)


@pytest.mark.slow
def test_the_truth_lies_within_its_intervals_as_often_as_they_say():
    z = []
    for seed in range(24):
        fit = fit_grasping(drawn_trials(500, 100 + seed, cut_rate=0.02))
        z.append((fit.estimate - TRUTH) / fit.standard_error)
    inside = (np.abs(z) < 1.96).mean(axis=0)
    print("share of intervals that hold the truth:", inside.round(2))
    assert (inside > 0.79).all()


def test_an_attempt_of_weight_two_counts_as_two_and_a_cut_one_as_none():
    tried = drawn_trials(40, 2, cut_rate=0.05)
    decided = tried[tried["is_finished"]]
    with_cuts = fit_grasping(tried, "none").estimate
    np.testing.assert_allclose(with_cuts, fit_grasping(decided, "none").estimate, atol=1e-6)
    assert fit_grasping(tried).num_cut == (~tried["is_finished"]).sum()


def test_times_are_those_of_attempts_that_hold_and_that_miss_weighted_where_long_ones_are_cut_more_often():
    few_cuts = fit_times(drawn_trials(2000, 3))
    assert (few_cuts.log_held_s, few_cuts.log_missed_s) == pytest.approx((2.0, 1.5), abs=0.02)
    assert few_cuts.log_std == pytest.approx(0.1, abs=0.01)
    assert few_cuts.rest_s == pytest.approx(5.0, abs=1e-6)
    tried = drawn_trials(3000, 4, cut_rate=0.08)
    share_held = 0.86
    assert np.log(tried[tried["is_finished"]]["attempt_s"]).mean() < share_held * 2.0 + (1 - share_held) * 1.5
    assert fit_times(tried).log_held_s == pytest.approx(2.0, abs=0.02)


def labels(*message):
    """One object's labels: hidden share, held or not, what it looked like."""
    return dict(
        zip(("glance_occlusions", "glance_held", "glance_dirty"), map(list, zip(*message, strict=True)), strict=True)
    )


def test_a_label_that_shows_nothing_new_is_no_news():
    rows = pd.DataFrame(
        [
            labels((0.5, False, False), (0.5, False, True), (0.2, False, False)),
            labels((0.5, False, False), (0.0, False, True), (0.0, True, False)),
            labels((0.0, False, True)),
            labels((0.6, False, False), (0.0, True, True)),
        ]
    )
    most, half, least = (pytest.approx(share * FACING_SHARE) for share in (0.8, 0.5, 0.4))
    facing = pytest.approx(FACING_SHARE)
    assert intervals(rows) == [(most, np.inf), (half, facing), (0.0, facing), (least, 1.0)]


def naive_found_by(message):
    """Maximise the likelihood of the masses by a general optimiser."""
    low, high = (np.array(ends) for ends in zip(*message, strict=True))
    knots = np.array(list(pairwise([0.0, *VIEWS])))

    def curve(mass, share):
        pieces = (share[:, None] - knots[:, 0]) / (knots[:, 1] - knots[:, 0])
        return np.clip(pieces, 0.0, 1.0) @ mass[:-1]

    def chances(logits):
        mass = np.exp(logits - logits.max())
        return mass / mass.sum()

    def negative(logits):
        mass = chances(logits)
        each = np.where(np.isinf(high), 1.0, curve(mass, np.minimum(high, 1.0))) - curve(mass, low)
        return -np.log(np.maximum(each, 1e-300)).sum()

    best = min((minimize(negative, start, method="BFGS") for start in np.eye(6)), key=lambda one: one.fun)
    return np.cumsum(chances(best.x)[:-1])


def test_curves_are_the_most_likely_ones():
    rng, result = np.random.default_rng(5), []
    for _ in range(60):
        share = rng.choice([rng.uniform(0, FACING_SHARE), rng.uniform(FACING_SHARE, 1.0), np.inf])
        views = np.sort(rng.uniform(0.0, FACING_SHARE, 3))
        views = [0.0, *views, *([1.0] if rng.random() < 0.5 else [])]
        reached = [view for view in views if view >= share]
        result.append((max(v for v in views if v < share), reached[0]) if reached else (views[-1], np.inf))
    np.testing.assert_allclose(found_by(result), naive_found_by(result), atol=0.01)
    assert np.all(np.diff([0.0, *found_by(result)]) >= 0)


def test_objects_are_counted_at_their_first_label_and_when_they_are_held():
    seeing = PersistentSeeing(FACING_SHARE, (0.5 * FACING_SHARE, FACING_SHARE, 1.0), (0.3, 0.5, 0.9), (0.0, 0.1, 0.2))
    full, hidden = (0.0, False), (0.8, False)
    rows = [labels((*full, False), (0.0, True, True)), labels((*full, True))]
    rows += [labels((*hidden, True), (0.0, True, False)), labels((*hidden, False))]
    little, facing = (pytest.approx(share * FACING_SHARE) for share in (0.2, 1.0))
    assert counted(pd.DataFrame(rows), seeing) == [Count(little, 1, 2), Count(facing, 1, 2), Count(1.0, 2, 2)]


def test_a_share_has_the_interval_of_as_many_attempts_as_its_tables_allow():
    rng = np.random.default_rng(1)
    tables = rng.integers(0, 9, 80)
    held, predicted, weight = rng.random(80) < 0.5 + 0.06 * tables, rng.uniform(0.6, 0.9, 80), rng.uniform(1.0, 2.0, 80)
    mean, said = (np.average(each, weights=weight) for each in (held, predicted))
    residuals = weight * (held - predicted - (mean - said))
    of_tables = [sum(residuals[k] for k in range(80) if tables[k] == table) for table in range(9)]
    size = mean * (1 - mean) / (9 / 8 * sum(each**2 for each in of_tables) / sum(weight) ** 2)
    assert size < 80
    share = clustered_share(held, predicted, weight, tables)
    assert (share.held, share.predicted) == pytest.approx((mean, said))
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
    share, none = (clustered_share(np.full(100, held), said, weight, tables) for held in (True, False))
    assert (share.held, share.high) == (1.0, 1.0)
    assert share.low == pytest.approx(wilson(1.0, 5.0)[0])
    assert (none.held, none.low, none.high) == pytest.approx((0.0, 0.0, 1.0 - share.low))


@pytest.mark.slow
def test_intervals_hold_the_truth_where_attempts_of_a_table_are_alike():
    rng, inside = np.random.default_rng(2), []
    truth, tables = quad(lambda z: expit(2.5 + z) * norm.pdf(z), -8, 8)[0], np.repeat(np.arange(100), 6)
    for _ in range(400):
        held = rng.random(600) < expit(2.5 + rng.normal(0.0, 1.0, 100))[tables]
        share = clustered_share(held, np.zeros(600), np.ones(600), tables)
        inside.append(share.low < truth < share.high)
    print("held the truth:", np.mean(inside))
    assert np.mean(inside) > 0.92
