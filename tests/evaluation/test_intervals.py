"""Intervals that allow for a bias of either sign, what undoes them, and values as shares and by the hour."""

from itertools import product

import numpy as np
import pytest
from enumerated_trial import CHANCE_B, StatePolicy, leaves, problem, specified, trial, truth
from scipy import stats
from scipy.optimize import linprog
from scipy.special import stdtr, stdtrit

from halfseen.evaluation import evaluate
from halfseen.evaluation.comparison import Contender, rate_of, share_of
from halfseen.evaluation.estimate import around
from halfseen.evaluation.problem import as_logged
from halfseen.evaluation.verdict import STRONGEST, shift, undone_at
from halfseen.learning import DoublyRobust
from halfseen.logs import Logs

TARGET = StatePolicy((0.1, 0.8))
BOUNDED = DoublyRobust("cox", by="pooled", truncate_at=3)
"""So low a bound that regressions often stand alone."""


@pytest.mark.parametrize("bias", [0.0, 0.2, 1.5])
def test_the_p_value_is_one_less_the_level_whose_interval_ends_at_0(bias):
    found = around(1.7, 0.6, 50, 12, 0.5, bias)
    assert around(1.7, 0.6, 50, 12, 1.0 - found.p_value, bias).low == pytest.approx(0.0, abs=1e-9)


def test_an_estimate_that_nothing_can_change_is_certain():
    found = [around(value, 0.0, 50, 12, 0.95, bias) for value, bias in ((0.0, 0.0), (0.1, 0.0), (0.1, 0.2))]
    assert [each.p_value for each in found] == [1.0, 0.0, 1.0]
    assert found[2].low == pytest.approx(-0.1)


def test_what_no_weight_corrects_is_what_the_shares_leave_which_is_nothing_where_nothing_was_cut():
    own = as_logged(problem(trial(3, num_trajectories=400, cut_rate=0.4), TARGET, BOUNDED, 5))
    given = own.nuisances[-1]
    trajectories, share, weights = own.trajectories, given.imputation.share, own.weights(given)
    mean = weights.standing.mean(axis=0)
    left = np.where(trajectories.is_begun, weights.weight / mean * (1.0 - share), 0.0)
    assert own.uncorrected_weight == pytest.approx(max(left.sum() / trajectories.num_trajectories, 0.0))
    uncut = trial(3, num_trajectories=200)
    assert problem(uncut, TARGET, BOUNDED, 5).uncorrected_weight == 0.0
    assert evaluate(TARGET, uncut, against="logging").doubly_robust.bias == 0.0


def test_what_two_policies_share_is_not_held_against_their_difference():
    """Half of the trajectories are cut, and a long stage nearly always: values may be biased, differences hardly."""
    logs = trial(4, num_trajectories=400, cut_rate=0.25)
    found = evaluate(StatePolicy((0.3, 0.7)), logs, against="logging", censoring=BOUNDED)
    # Weights by states share a little less with those of the log than products do.
    assert 0.0 < found.difference.bias < 0.3 * found.logging.bias


# How strong an unrecorded cause of cuts undoes a verdict
RNG = np.random.default_rng(0)
EXCESS = np.where(RNG.random((40, 3)) < 0.3, 0.0, RNG.exponential(size=(40, 3)))
ERROR = RNG.normal(size=(40, 3)).round(1)


@pytest.mark.parametrize("gamma", [1.0, 1.3, 2.0, 7.0])
def test_it_is_the_worst_of_all_weights_that_are_allowed_by_a_linear_programme(gamma):
    """Each weight within its bounds, the sum of each stage what it was."""
    total = 0.0
    for w, v in zip(EXCESS.T, ERROR.T, strict=True):
        bounds = [(-(1.0 - 1.0 / gamma) * each, (gamma - 1.0) * each) for each in w]
        total += linprog(v, A_eq=np.ones((1, len(v))), b_eq=[0.0], bounds=bounds).fun
    assert shift(EXCESS, ERROR, gamma) == pytest.approx(total / len(EXCESS), abs=1e-9)


def test_the_interval_ends_at_zero_where_it_says_and_what_no_weight_touches_no_cause_undoes():
    open_, above, below = (around(value, 0.1, 40, 39, 0.95) for value in (0.1, 0.5, -0.5))
    gamma = undone_at(above, EXCESS, ERROR)
    assert above.low + shift(EXCESS, ERROR, gamma) == pytest.approx(0.0, abs=1e-9)
    assert undone_at(below, EXCESS, -ERROR) == pytest.approx(gamma)
    assert undone_at(open_, EXCESS, ERROR) == 1.0
    assert undone_at(above, EXCESS, np.ones_like(ERROR)) == undone_at(above, 0.0 * EXCESS, ERROR) == STRONGEST


def test_a_hidden_cause_of_that_strength_shifts_the_mean_by_no_more():
    """A hidden z doubles and halves the odds of being cut, and moves the outcome; weights know but their mean."""
    rng = np.random.default_rng(1)
    z, strength = rng.integers(0, 2, 400_000), 2.0
    outcome = rng.normal(size=len(z)) + z
    odds = np.where(z == 1, strength, 1.0 / strength)
    is_seen = rng.random(len(z)) < 1.0 / (1.0 + odds)
    weight = np.where(is_seen, 1.0 / is_seen.mean(), 0.0)
    excess = np.where(is_seen, weight - 1.0, 0.0)[:, None]
    marginal = (1.0 - is_seen.mean()) / is_seen.mean()
    gamma = max(odds.max() / marginal, marginal / odds.min())
    bias = outcome.mean() - np.mean(weight * outcome)
    assert bias > 0.1
    assert bias < -shift(excess, -outcome[:, None], gamma)
    assert bias > -shift(excess, -outcome[:, None], 1.1)


# Shares of what is earned today, and what is earned in an hour
def hourly(logs, **options):
    return evaluate(TARGET, logs, **(specified() | options), is_hourly=True, against="logging")


def test_the_logging_policy_on_uncut_logs_earns_sums_by_sums():
    logs = trial(1)
    found = hourly(logs).per_hour
    earned, took_s = logs.stages["reward"].sum(), logs.end_s.sum()
    assert found.why_unknown is None
    assert found.logging.per_hour.value == pytest.approx(3600.0 * earned / took_s, rel=1e-12)
    assert found.logging.duration_s.value == pytest.approx(logs.end_s.mean(), rel=1e-12)
    by_trajectory = logs.stages.groupby("trajectory")["reward"].sum().to_numpy()
    misses = by_trajectory - earned / took_s * logs.end_s
    error = 3600.0 * np.std(misses, ddof=1) / np.sqrt(logs.num_trajectories) / logs.end_s.mean()
    by_trajectories = error * stats.t.ppf(0.975, logs.num_trajectories - 1.0)
    # The interval is the wider one of that by trajectories and that of the jackknife.
    reach = found.logging.per_hour.high - found.logging.per_hour.value
    assert by_trajectories * (1.0 - 1e-9) <= reach < 2.5 * by_trajectories


def true_duration_s(chance_b):
    """A stage lasts 2 s in the mean in state 0, and 3 s in state 1."""
    second_s = 2.5
    return sum(
        0.5 * chance * (2.0 + state + (0.0 if leaves(state, action) else second_s))
        for state in (0, 1)
        for action, chance in enumerate((1.0 - chance_b[state], chance_b[state]))
    )


@pytest.mark.slow
@pytest.mark.parametrize("censoring", ["kaplan-meier", None])
def test_rates_and_shares_of_a_cut_log_hold_the_truth(censoring):
    chances = {"policy": TARGET.chance_b, "logging": tuple(CHANCE_B)}
    rate = {name: 3600.0 * truth(chance) / true_duration_s(chance) for name, chance in chances.items()}
    share = truth(TARGET.chance_b) / truth(tuple(CHANCE_B))
    held = {"policy": 0, "logging": 0, "share": 0}
    for seed in range(24):
        logs = trial(seed, num_trajectories=300, cut_rate=0.08)
        found = evaluate(TARGET, logs, **(specified() | {"censoring": censoring}), is_hourly=True)
        for name in chances:
            estimate = getattr(found.per_hour, name).per_hour
            held[name] += estimate.low <= rate[name] <= estimate.high
            assert estimate.value == pytest.approx(rate[name], rel=0.5)
        held["share"] += found.share.low <= share <= found.share.high
    # Of 24 intervals at 95 %, fewer than 20 hold with a chance of 1 %.
    assert min(held.values()) >= 20


def earning(values, name="today"):
    return Contender(name, values, effective_sample_size=float(len(values)))


def test_shares_are_paired_and_nothing_is_a_share_of_what_may_be_nothing():
    luck = np.random.default_rng(0).normal(size=80)
    today = earning(5.0 + luck)
    found, same = share_of(earning(1.2 * (5.0 + luck)), today, 0.95), share_of(today, today, 0.95)
    assert (found.value, found.standard_error) == pytest.approx((1.2, 0.0), abs=1e-12)
    assert (same.value, same.standard_error) == (1.0, 0.0)
    ours = earning(np.linspace(1.0, 2.0, 40))
    for mean in (0.05, -3.0):
        today = earning(np.linspace(-1.0, 1.0, 40) + mean)
        assert (share_of(ours, today, 0.95), rate_of(ours, today, 0.95)) == (None, None)
    assert share_of(Contender("unknown"), ours, 0.95) is None


def test_shares_stand_beside_each_value():
    found = evaluate(TARGET, trial(0, cut_rate=0.1), against="logging", **specified())
    assert found.share.value == pytest.approx(found.doubly_robust.value / found.logging.value, rel=1e-12)
    assert found.comparisons[0].share.value == 1.0
    assert found.per_hour is None


@pytest.mark.parametrize(
    ("of_stage", "why"),
    [
        (lambda stages: stages["stage"].astype(float), "count stages"),
        (lambda stages: 1e-7 * stages["stage"], "take no time"),
    ],
)
def test_a_clock_that_tells_nothing_is_said_to(of_stage, why):
    logs = trial(1)
    stages = logs.stages.assign(elapsed_s=of_stage(logs.stages))
    ends = logs.trajectories.assign(end_s=stages.groupby("trajectory")["elapsed_s"].last().to_numpy())
    found = hourly(Logs(stages, ends)).per_hour
    assert why in found.why_unknown
    assert (found.policy, found.logging) == (None, None)


@pytest.mark.parametrize("scale", [1.0, 1.0 / 86400.0])
def test_rewards_that_are_times_have_no_rate(scale):
    logs = trial(1)
    before = logs.stages.groupby("trajectory")["elapsed_s"].shift(fill_value=0.0)
    times = Logs(logs.stages.assign(reward=scale * (logs.stages["elapsed_s"] - before)), logs.trajectories)
    assert "is its duration" in hourly(times).per_hour.why_unknown


# Student's t
@pytest.mark.parametrize(("freedom", "level"), [*product([1, 2, 9, 30, 1e5], [0.05, 0.8, 0.95, 0.999999])])
def test_reach_of_an_interval_is_the_quantile_of_scipy(freedom, level):
    np.testing.assert_allclose(
        around(0.0, 1.0, 5.0, freedom, level).high, stdtrit(freedom, (1.0 + level) / 2.0), rtol=1e-9
    )


@pytest.mark.parametrize(("freedom", "level", "bias"), [*product([1, 9, 1e5], [0.05, 0.95], [1e-9, 0.1, 8.0])])
def test_reach_with_a_bias_holds_the_truth_as_often_as_the_level_says(freedom, level, bias):
    found = around(0.0, 1.0, 5.0, freedom, level, bias)
    reach = found.high
    np.testing.assert_allclose(stdtr(freedom, bias - reach) + stdtr(freedom, -bias - reach), 1.0 - level, rtol=1e-9)
    assert -found.low == reach <= stdtrit(freedom, (1.0 + level) / 2.0) + bias + 1e-9


@pytest.mark.parametrize("error", [1e-17, 1e-300, 5e-324])
def test_a_bias_that_dwarfs_the_standard_error_is_the_reach(error):
    assert around(0.0, error, 5.0, 9.0, 0.95, bias=3.0).high == pytest.approx(3.0, rel=1e-12)
